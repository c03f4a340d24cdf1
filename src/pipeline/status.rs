//! How the stages of a site stand, without doing anything.

use super::decide::Planner;
use super::executor::standing;
use super::{Action, Address, Graph, Lock, Options, Owner, Reason, Site};
use crate::error::Result;
use serde::Serialize;

/// How one stage stands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageStatus {
    /// Name in the pipeline.
    pub stage: String,
    /// Kind of stage.
    pub kind: &'static str,
    /// `cached`, `running`, `damaged`, `never_run`, `outdated` or `waits`.
    pub state: &'static str,
    /// Why it would be computed.
    pub reasons: Vec<Reason>,
    /// Where its output lies or will lie.
    pub entry: Option<Address>,
    /// Wall time of its computation.
    pub seconds: Option<f64>,
    /// Machine that computed it.
    pub host: Option<String>,
    /// When it was done, seconds since 1970-01-01 UTC.
    pub done_unix_s: Option<u64>,
    /// Size of its output with items.
    pub bytes: Option<u64>,
    /// Who is computing it.
    pub owner: Option<Owner>,
    /// How far its items are on a cluster.
    pub shards: Option<String>,
}

/// How all stages stand, in the order of the graph.
///
/// # Errors
/// When outside files cannot be read.
pub fn status(site: &Site<'_>, graph: &Graph) -> Result<Vec<StageStatus>> {
    let planner = Planner::new(site, graph, &Options::default())?;
    let (decisions, _) = planner.plan()?;
    let store = &planner.store;
    let stand = |decision: super::Decision| {
        let entry = decision.entry.as_ref();
        let is_cached = decision.action == Action::Cached;
        let owner = entry.filter(|_| !is_cached).and_then(|e| Lock::holder(&store.lock_path(e)));
        let state = match decision.reasons.first() {
            _ if is_cached => "cached",
            _ if owner.is_some() => "running",
            Some(Reason::WaitsFor(_)) => "waits",
            Some(Reason::Damaged(_)) => "damaged",
            Some(Reason::NeverRun) => "never_run",
            _ => "outdated",
        };
        let timing = entry.filter(|_| is_cached).and_then(|e| store.timing(e));
        StageStatus {
            state,
            seconds: timing.as_ref().map(|t| t.seconds),
            host: timing.as_ref().map(|t| t.host.clone()).filter(|host| !host.is_empty()),
            done_unix_s: timing.as_ref().map(|t| t.done_unix_s).filter(|done| *done > 0),
            bytes: entry.filter(|_| is_cached).and_then(|e| store.outputs(e)).map(|o| store.bytes(&o)),
            owner,
            shards: entry.filter(|_| !is_cached).and_then(|e| standing(&store.shards_dir(e))),
            stage: decision.stage,
            kind: decision.kind,
            reasons: decision.reasons,
            entry: decision.entry,
        }
    };
    Ok(decisions.into_iter().map(stand).collect())
}
