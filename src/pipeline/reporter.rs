//! What a run tells of itself, to whoever listens: a terminal, a log, nobody.

use super::{Decision, Owner};
use crate::error::Error;
use crate::progress::{Progress, Quiet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// One thing that happened.
#[derive(Debug)]
pub enum Event<'a> {
    /// What will be done, before anything is.
    Planned(&'a [Decision]),
    /// A stage whose key depended on an output is now decided.
    Decided(&'a Decision),
    /// A stage begins.
    Started {
        /// Its name.
        stage: &'a str,
        /// Wall time of the output that this site used last.
        last_s: Option<f64>,
    },
    /// A stage waits for another process that computes the same.
    Waits {
        /// Its name.
        stage: &'a str,
        /// That process, where it is known.
        owner: Option<&'a Owner>,
    },
    /// `done` of `total` steps of `what` are done; `done` is 0 when they are announced.
    Progress {
        /// Name of the stage.
        stage: &'a str,
        /// What is counted.
        what: &'a str,
        /// Steps done.
        done: u64,
        /// Steps in all.
        total: u64,
    },
    /// A remark.
    Note {
        /// Name of the stage.
        stage: &'a str,
        /// One line.
        text: &'a str,
    },
    /// Something people should look at that does not stop the stage.
    Warning {
        /// Name of the stage.
        stage: &'a str,
        /// One line.
        text: &'a str,
    },
    /// A stage is done and its output stored.
    Finished {
        /// Its name.
        stage: &'a str,
        /// Wall time.
        seconds: f64,
    },
    /// A stage could not do its work.
    Failed {
        /// Its name.
        stage: &'a str,
        /// Why.
        error: &'a Error,
    },
    /// A stage was not begun because one it depends on failed.
    Skipped {
        /// Its name.
        stage: &'a str,
        /// The stage that failed or was skipped.
        because: &'a str,
    },
}

/// Listens to a run, from several threads.
pub trait Reporter: Sync {
    /// Something happened.
    fn event(&self, event: &Event<'_>);
}

impl Reporter for Quiet {
    fn event(&self, _: &Event<'_>) {}
}

/// Passes the progress of one stage on to the listener of the run.
pub(super) struct StageProgress<'a> {
    stage: &'a str,
    reporter: &'a dyn Reporter,
    what: Mutex<String>,
    done: AtomicU64,
    total: AtomicU64,
}

impl<'a> StageProgress<'a> {
    pub(super) fn new(stage: &'a str, reporter: &'a dyn Reporter) -> Self {
        Self { stage, reporter, what: Mutex::default(), done: AtomicU64::new(0), total: AtomicU64::new(0) }
    }

    fn tell(&self, done: u64) {
        let what = self.what.lock().unwrap_or_else(PoisonError::into_inner);
        let total = self.total.load(Ordering::Relaxed);
        self.reporter.event(&Event::Progress { stage: self.stage, what: &what, done, total });
    }
}

impl Progress for StageProgress<'_> {
    fn start(&self, what: &str, total: u64) {
        *self.what.lock().unwrap_or_else(PoisonError::into_inner) = what.to_string();
        self.total.store(total, Ordering::Relaxed);
        self.done.store(0, Ordering::Relaxed);
        self.tell(0);
    }

    fn advance(&self, steps: u64) {
        let done = self.done.fetch_add(steps, Ordering::Relaxed) + steps;
        self.tell(done);
    }

    fn note(&self, text: &str) {
        self.reporter.event(&Event::Note { stage: self.stage, text });
    }

    fn warn(&self, text: &str) {
        self.reporter.event(&Event::Warning { stage: self.stage, text });
    }
}
