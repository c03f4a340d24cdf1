//! What a site has stored and how its stages stand, without doing anything, for commands that read results: one plan for all questions.

use super::decide::{Planner, Resolved};
use super::executor::standing;
use super::store::Outputs;
use super::{Action, Address, Decision, Graph, Lock, Options, OutsideFile, Owner, Reason, Site, State};
use crate::error::{Error, Result};
use serde::Serialize;
use std::path::PathBuf;

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

/// What a site has stored as this is made. What a run or a collection does later is not seen: whoever keeps it holds a lease.
pub struct Results<'a> {
    planner: Planner<'a>,
    decisions: Vec<Decision>,
    resolved: Vec<Option<Resolved>>,
}

impl<'a> Results<'a> {
    /// Of all stages of `graph` for `site`.
    ///
    /// # Errors
    /// When outside files cannot be read.
    pub fn of(site: &'a Site<'a>, graph: &'a Graph) -> Result<Self> {
        let planner = Planner::new(site, graph, &Options::default())?;
        let (decisions, resolved) = planner.plan()?;
        Ok(Self { planner, decisions, resolved })
    }

    /// Folder of the stored output of one stage.
    ///
    /// # Errors
    /// When there is no such stage, or its output is not stored or is damaged.
    pub fn output(&self, stage: &str) -> Result<PathBuf> {
        Ok(self.planner.store.dir(self.stored(stage)?))
    }

    /// Files from outside that one stage read.
    ///
    /// # Errors
    /// As [`Results::output`].
    pub fn outside_files(&self, stage: &str) -> Result<Vec<OutsideFile>> {
        Ok(self.planner.store.parts(self.stored(stage)?).map(|parts| parts.files).unwrap_or_default())
    }

    /// Paths of what one stage has stored: its own files, then those of its items in their order.
    ///
    /// # Errors
    /// As [`Results::output`].
    pub fn files(&self, stage: &str) -> Result<Vec<PathBuf>> {
        let read = |address: &Address| {
            let folder = self.planner.store.dir(address);
            Outputs::read(&folder).map(|outputs| (folder, outputs))
        };
        let own = read(self.stored(stage)?)?;
        let addresses = own.1.items.iter().filter_map(|item| Address::parse(&item.entry));
        let items = addresses.map(|address| read(&address)).collect::<Result<Vec<_>>>()?;
        let all = std::iter::once(own).chain(items);
        Ok(all
            .flat_map(|(folder, outputs)| outputs.files.into_iter().map(move |file| folder.join(file.name)))
            .collect())
    }

    /// Where the output of one stage is stored.
    fn stored(&self, stage: &str) -> Result<&Address> {
        let index = match self.planner.graph.select(stage)?.into_iter().collect::<Vec<_>>().as_slice() {
            [one] => *one,
            _ => {
                let what = format!("stage `{stage}` has several instances");
                return Err(Error::new(what).hint("name one: `stage.instance`"));
            }
        };
        match (&self.decisions[index].action, &self.resolved[index]) {
            (Action::Cached, Some(known)) => match self.planner.content(index, &known.address) {
                State::Damaged(why) => Err(Error::new(format!("the output of `{stage}` is damaged: {why}"))
                    .hint(format!("`flare-pipe run` with `--only {stage} --force {stage}` computes it again"))),
                _ => Ok(&known.address),
            },
            _ => {
                let why = self.decisions[index].reason();
                Err(Error::new(format!("the output of `{stage}` is not up to date: {why}"))
                    .hint(format!("`flare-pipe run` computes it, and with `--until {stage}` what it needs alone")))
            }
        }
    }

    /// How all stages stand, in the order of the graph.
    pub fn status(&self) -> Vec<StageStatus> {
        self.decisions.iter().map(|decision| self.stand(decision)).collect()
    }

    fn stand(&self, decision: &Decision) -> StageStatus {
        let (store, entry) = (&self.planner.store, decision.entry.as_ref());
        let (stored, awaited) = match decision.action {
            Action::Cached => (entry, None),
            _ => (None, entry),
        };
        let owner = awaited.and_then(|e| Lock::holder(&store.lock_path(e)));
        let state = match decision.reasons.first() {
            _ if decision.action == Action::Cached => "cached",
            _ if owner.is_some() => "running",
            Some(Reason::WaitsFor(_)) => "waits",
            Some(Reason::Damaged(_)) => "damaged",
            Some(Reason::NeverRun) => "never_run",
            _ => "outdated",
        };
        let timing = stored.and_then(|e| store.timing(e));
        StageStatus {
            state,
            seconds: timing.as_ref().map(|t| t.seconds),
            host: timing.as_ref().map(|t| t.host.clone()).filter(|host| !host.is_empty()),
            done_unix_s: timing.as_ref().map(|t| t.done_unix_s).filter(|done| *done > 0),
            bytes: stored.and_then(|e| store.outputs(e)).map(|o| store.bytes(&o)),
            owner,
            shards: awaited.and_then(|e| standing(&store.shards_dir(e))),
            stage: decision.stage.clone(),
            kind: decision.kind,
            reasons: decision.reasons.clone(),
            entry: decision.entry.clone(),
        }
    }
}
