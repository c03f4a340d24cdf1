//! Carries a plan out: stages that are ready run side by side; a failure stops what depends on it and nothing else.

use super::decide::{Planner, Resolved};
use super::executor::{Permits, ShardRun, ShardTask, Slurm, guarded};
use super::files::remove_dir;
use super::lock::{Agreement, Lease};
use super::reporter::StageProgress;
use super::site::EARLIER;
use super::store::Published;
use super::{Action, Decision, Event, Graph, Lock, Options, Reason, Reporter, Site, State, Task};
use crate::error::{Error, Result};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Whether to do it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Decide only; nothing is written.
    Plan,
    /// Decide and do.
    Run,
}

/// A stage that failed.
#[derive(Debug)]
pub struct Failure {
    /// Name of the stage.
    pub stage: String,
    /// Why, with the stage as place.
    pub error: Error,
}

/// What a run did.
#[derive(Debug)]
pub struct Summary {
    /// What was decided at first, in the order of the graph.
    pub decisions: Vec<Decision>,
    /// Stages that were computed, as they finished.
    pub computed: Vec<String>,
    /// Stages that failed.
    pub failures: Vec<Failure>,
    /// Stages that were not begun because of a failure.
    pub skipped: Vec<String>,
}

/// Decides what to do with every stage of `graph` for `site` and, if `mode` says so, does it.
///
/// # Errors
/// When the plan is impossible (see [`Error::exit_status`]) or the run directory cannot be written. A stage that fails is no
/// error of the run: see [`Summary::failures`].
pub fn run(site: &Site<'_>, graph: &Graph, options: &Options, mode: Mode, reporter: &dyn Reporter) -> Result<Summary> {
    // Before anything is decided: what a plan takes for stored is to stay.
    let waiting = || reporter.event(&Event::Waits { stage: "run", owner: None });
    let lease = (mode == Mode::Run).then(|| Lease::shared(&site.store().lease_path(), waiting));
    let planner = Planner::new(site, graph, options)?;
    let (decisions, resolved) = planner.plan()?;
    reporter.event(&Event::Planned(&decisions));
    let mut summary = Summary { decisions, computed: Vec::new(), failures: Vec::new(), skipped: Vec::new() };
    if mode == Mode::Plan {
        return Ok(summary);
    }
    let mut progress = Vec::new();
    for (index, decision) in summary.decisions.iter().enumerate() {
        progress.push(match (decision.action, &resolved[index]) {
            (Action::Run | Action::Wait, _) => Stand::Open,
            (Action::Cached, Some(known)) => {
                settle(&planner, index, known)?;
                Stand::Done
            }
            _ => Stand::Left,
        });
    }
    let n_open = progress.iter().filter(|p| **p == Stand::Open).count();
    // Where there is nothing to do, a folder that cannot be written will do.
    let _lease = match lease {
        Some(Err(error)) if n_open > 0 => return Err(error),
        other => other,
    };
    let _agreed = if n_open > 0 { Some(agree(site, graph)?) } else { None };
    let crew = Crew {
        planner: &planner,
        reporter,
        permits: Permits::new(options.jobs),
        slurm: options.slurm.as_ref(),
        decisions: summary.decisions.clone(),
        board: Mutex::new(Board { stand: progress, resolved, summary: &mut summary }),
        moved: Condvar::new(),
        looked_into: Mutex::default(),
    };
    std::thread::scope(|scope| {
        for _ in 0..options.jobs.clamp(1, n_open.max(1)).min(n_open) {
            scope.spawn(|| crew.work());
        }
    });
    crew.set_aside()?;
    Ok(summary)
}

/// A share in the folder of the site for runs with these settings: with others they would publish over one another.
fn agree(site: &Site<'_>, graph: &Graph) -> Result<Agreement> {
    let (path, settings) = site.settings(graph)?;
    Agreement::on(&path, &settings)?.ok_or_else(|| {
        let what =
            format!("a run of site `{}` with other settings is at work in `{}`", site.name, site.run_dir.display());
        Error::new(what).hint("wait for it, or give one of the two another `name` in its manifest")
    })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stand {
    /// To be done.
    Open,
    Running,
    Done,
    /// Failed, or skipped because of a failure.
    Broken,
    /// Not asked for and not stored.
    Left,
}

struct Board<'a> {
    stand: Vec<Stand>,
    resolved: Vec<Option<Resolved>>,
    summary: &'a mut Summary,
}

struct Crew<'a> {
    planner: &'a Planner<'a>,
    reporter: &'a dyn Reporter,
    permits: Permits,
    slurm: Option<&'a Slurm>,
    decisions: Vec<Decision>,
    board: Mutex<Board<'a>>,
    moved: Condvar,
    /// Stages whose outputs were found to be as written.
    looked_into: Mutex<BTreeSet<usize>>,
}

impl<'a> Crew<'a> {
    fn board(&self) -> MutexGuard<'_, Board<'a>> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes stages as they become ready until none is open.
    fn work(&self) {
        let mut board = self.board();
        loop {
            self.skip_what_cannot_run(&mut board);
            let nodes = self.planner.graph.nodes();
            let is_done = |d: usize| board.stand[d] == Stand::Done;
            let is_ready =
                |i: &usize| board.stand[*i] == Stand::Open && nodes[*i].dependencies().into_iter().all(is_done);
            let Some(index) = (0..nodes.len()).find(is_ready) else {
                if !(board.stand.contains(&Stand::Open) && board.stand.contains(&Stand::Running)) {
                    self.moved.notify_all();
                    return;
                }
                board = self.moved.wait(board).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            board.stand[index] = Stand::Running;
            let inputs = board.resolved.clone();
            drop(board);
            let result = guarded(|| self.carry_out(index, &inputs));
            board = self.board();
            let name = &nodes[index].name;
            match result {
                Ok((known, is_computed)) => {
                    board.resolved[index] = Some(known);
                    board.stand[index] = Stand::Done;
                    if is_computed {
                        board.summary.computed.push(name.clone());
                    }
                }
                Err(error) => {
                    let error = error.at(format!("stage `{name}`"));
                    self.reporter.event(&Event::Failed { stage: name, error: &error });
                    board.stand[index] = Stand::Broken;
                    board.summary.failures.push(Failure { stage: name.clone(), error });
                }
            }
            self.moved.notify_all();
        }
    }

    /// Moves what was published of stages that are not done aside, so that nobody takes it for what failed.
    fn set_aside(&self) -> Result<()> {
        let board = self.board();
        for (index, node) in self.planner.graph.nodes().iter().enumerate() {
            if board.stand[index] != Stand::Broken {
                continue;
            }
            for (_, name) in &node.publishes {
                if self.planner.site.set_aside(name)? {
                    let text = format!("`{name}` of an earlier run moved to `{EARLIER}`");
                    self.reporter.event(&Event::Warning { stage: &node.name, text: &text });
                }
            }
        }
        Ok(())
    }

    fn skip_what_cannot_run(&self, board: &mut Board<'_>) {
        let nodes = self.planner.graph.nodes();
        for (index, node) in nodes.iter().enumerate() {
            let broken = node.dependencies().into_iter().find(|d| board.stand[*d] == Stand::Broken);
            if let (Stand::Open, Some(broken)) = (board.stand[index], broken) {
                board.stand[index] = Stand::Broken;
                board.summary.skipped.push(node.name.clone());
                self.reporter.event(&Event::Skipped { stage: &node.name, because: &nodes[broken].name });
            }
        }
    }

    /// Computes one stage, or finds that it need not be; says whether it was.
    fn carry_out(&self, index: usize, inputs: &[Option<Resolved>]) -> Result<(Resolved, bool)> {
        let planner = self.planner;
        let (known, decision) = match &inputs[index] {
            Some(known) => (known.clone(), self.decisions[index].clone()),
            None => {
                let known = planner.resolve(index, inputs)?.ok_or_else(|| Error::new("an input has no output"))?;
                let decision = planner.decide(index, &known);
                self.reporter.event(&Event::Decided(&decision));
                (known, decision)
            }
        };
        let is_computed = decision.action != Action::Cached && {
            self.mend_inputs(index, inputs)?;
            self.compute(index, &known, &decision, inputs)?
        };
        settle(planner, index, &known)?;
        Ok((known, is_computed))
    }

    /// Computes again what a stage is about to read and has other content than was written.
    fn mend_inputs(&self, index: usize, inputs: &[Option<Resolved>]) -> Result<()> {
        for input in self.planner.graph.nodes()[index].dependencies() {
            let Some(known) = &inputs[input] else { continue };
            if self.looked_into().contains(&input) {
                continue;
            }
            if let State::Damaged(why) = self.planner.content(input, &known.address) {
                let decision = Decision { reasons: vec![Reason::Damaged(why)], ..self.decisions[input].clone() };
                self.mend_inputs(input, inputs)?;
                self.compute(input, known, &decision, inputs)?;
            }
            self.looked_into().insert(input);
        }
        Ok(())
    }

    fn looked_into(&self) -> MutexGuard<'_, BTreeSet<usize>> {
        self.looked_into.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn compute(
        &self,
        index: usize,
        known: &Resolved,
        decision: &Decision,
        inputs: &[Option<Resolved>],
    ) -> Result<bool> {
        let (planner, store) = (self.planner, &self.planner.store);
        let node = &planner.graph.nodes()[index];
        let stage = node.name.as_str();
        let is_forced = planner.is_forced(index);
        let _lock = Lock::acquire(&store.lock_path(&known.address), |owner| {
            self.reporter.event(&Event::Waits { stage, owner: owner.as_ref() });
        })?;
        let state = planner.content(index, &known.address);
        let was_sound = matches!(state, State::Sound(_));
        if was_sound && !is_forced {
            self.reporter.event(&Event::Note { stage, text: "was computed meanwhile by another run" });
            return Ok(false);
        }
        for reason in &decision.reasons {
            if let Reason::Damaged(_) = reason {
                self.reporter.event(&Event::Warning { stage, text: &format!("{reason}; it is computed again") });
            }
        }
        self.reporter.event(&Event::Started { stage, last_s: decision.last_s });
        let progress = StageProgress::new(stage, self.reporter);
        let draft = store.draft(&known.address)?;
        let task = Task {
            slurm: self.slurm,
            ..task(
                planner,
                index,
                known,
                inputs,
                Surroundings { output_dir: draft.dir.clone(), permits: &self.permits, is_forced, progress: &progress },
            )
        };
        let start = Instant::now();
        if let Err(error) = guarded(|| node.stage.run(&task)) {
            remove_dir(&task.output_dir)?;
            return Err(error);
        }
        let seconds = start.elapsed().as_secs_f64();
        let records = task.records.into_inner().unwrap_or_else(PoisonError::into_inner);
        let records = records.into_iter().flatten().collect();
        if store.publish(&known.parts, records, seconds)? == Published::Replaced && was_sound {
            let text = "gave other bytes than before from the same inputs; should its version be bumped?";
            self.reporter.event(&Event::Warning { stage, text });
        }
        remove_dir(&task.checkpoint_dir)?;
        self.reporter.event(&Event::Finished { stage, seconds });
        Ok(true)
    }
}

/// What a stage is given beside what the plan knows of it.
struct Surroundings<'a> {
    output_dir: PathBuf,
    permits: &'a Permits,
    is_forced: bool,
    progress: &'a StageProgress<'a>,
}

fn task<'a>(
    planner: &'a Planner<'a>,
    index: usize,
    known: &'a Resolved,
    inputs: &[Option<Resolved>],
    around: Surroundings<'a>,
) -> Task<'a> {
    let (node, store) = (&planner.graph.nodes()[index], &planner.store);
    let played = |links: &Vec<super::Link>| {
        let path = |node: usize| inputs[node].as_ref().map(|input| store.dir(&input.address));
        links.iter().filter_map(|link| Some((link.instance.clone(), path(link.node)?))).collect()
    };
    Task {
        name: &node.name,
        instance: node.instance.as_deref(),
        parameters: known.parameters.clone(),
        manifest_dir: planner.site.manifest_dir,
        inputs: node.inputs.iter().map(|(role, links)| (role.clone(), played(links))).collect(),
        output_dir: around.output_dir,
        checkpoint_dir: store.checkpoint_dir(&known.address),
        store,
        permits: around.permits,
        is_forced: around.is_forced,
        progress: around.progress,
        slurm: None,
        address: &known.address,
        shard: None,
        records: Mutex::default(),
    }
}

/// Computes one shard of the ensemble of a stage, and nothing else of it.
///
/// # Errors
/// When what the stage reads is not stored, it has no such items, or the machine fails; that the model has no result for an item is none.
pub fn compute_shard(
    site: &Site<'_>,
    graph: &Graph,
    task: ShardTask,
    options: &Options,
    reporter: &dyn Reporter,
) -> Result<()> {
    let ShardTask { stage, is_forced, shard } = task;
    let stage = stage.as_str();
    let _lease = Lease::shared(&site.store().lease_path(), || reporter.event(&Event::Waits { stage, owner: None }))?;
    let planner = Planner::new(site, graph, options)?;
    let (_, resolved) = planner.plan()?;
    let index = graph.select(stage)?.into_iter().next().unwrap_or_default();
    let unknown = || Error::new(format!("what stage `{stage}` reads is not stored"));
    let known = resolved[index].as_ref().ok_or_else(unknown)?;
    for input in graph.nodes()[index].dependencies() {
        let address = &resolved[input].as_ref().ok_or_else(unknown)?.address;
        if !matches!(planner.content(input, address), State::Sound(_)) {
            return Err(unknown().at(format!("`{address}`")));
        }
    }
    let scratch = tempfile::tempdir().map_err(|e| Error::new("there is no folder for what is not kept").cause(e))?;
    let (progress, permits) = (StageProgress::new(stage, reporter), Permits::new(options.jobs));
    let around =
        Surroundings { output_dir: scratch.path().to_path_buf(), permits: &permits, is_forced, progress: &progress };
    let own = ShardRun { shard, is_done: AtomicBool::new(false) };
    let task = Task { shard: Some(&own), ..self::task(&planner, index, known, &resolved, around) };
    let ended = guarded(|| graph.nodes()[index].stage.run(&task));
    if own.is_done.load(Ordering::Relaxed) {
        return Ok(());
    }
    ended.and_then(|()| Err(Error::new(format!("stage `{stage}` has no `{}` items", own.shard.kind))))
}

/// Makes a stored output the one of the site: remembered, its files published. Writes nothing that is so already.
fn settle(planner: &Planner<'_>, index: usize, known: &Resolved) -> Result<()> {
    let node = &planner.graph.nodes()[index];
    planner.site.publish(node, &planner.store.dir(&known.address))?;
    planner.memory.remember(&node.name, &known.address)
}
