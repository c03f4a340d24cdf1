//! What people see of a run on stderr, and what the log keeps.

use crate::pipeline::{Action, Decision, Event, Reporter};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// How much is said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verbosity {
    /// Failures only.
    Quiet,
    /// Stages, warnings, progress.
    Normal,
    /// Remarks too.
    Verbose,
}

/// Prints a run for people; bars only on a terminal. Everything goes to the log through `tracing` as well.
pub struct Terminal {
    bars: MultiProgress,
    by_stage: Mutex<HashMap<String, ProgressBar>>,
    is_terminal: bool,
    verbosity: Verbosity,
}

impl Terminal {
    /// A reporter for stderr.
    pub fn new(verbosity: Verbosity) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        Self { bars: MultiProgress::new(), by_stage: Mutex::new(HashMap::new()), is_terminal, verbosity }
    }

    fn say(&self, at: Verbosity, line: &str) {
        if self.verbosity < at {
            return;
        }
        if self.is_terminal {
            self.bars.suspend(|| eprintln!("{line}"));
        } else {
            eprintln!("{line}");
        }
    }

    fn progress(&self, stage: &str, what: &str, done: u64, total: u64) {
        if !self.is_terminal || self.verbosity < Verbosity::Normal {
            return;
        }
        let mut bars = self.by_stage.lock().unwrap_or_else(PoisonError::into_inner);
        let bar = bars.entry(stage.to_string()).or_insert_with(|| {
            let bar = self.bars.add(ProgressBar::new(total));
            let template = "{prefix:22} {bar:32} {pos}/{len} {msg}  {per_sec}, {eta} left";
            bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar.set_prefix(stage.to_string());
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        bar.set_length(total);
        bar.set_message(what.to_string());
        bar.set_position(done);
    }

    fn close(&self, stage: &str) {
        let bar = self.by_stage.lock().unwrap_or_else(PoisonError::into_inner).remove(stage);
        if let Some(bar) = bar {
            bar.finish_and_clear();
        }
    }
}

impl Reporter for Terminal {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Planned(decisions) => {
                for decision in *decisions {
                    if decision.action != Action::Cached {
                        tracing::info!(stage = %decision.stage, reason = %decision.reason(), "planned");
                    }
                    self.say(Verbosity::Normal, &plan_line(decision));
                }
            }
            Event::Decided(decision) => self.say(Verbosity::Verbose, &plan_line(decision)),
            Event::Started { stage } => {
                tracing::info!(stage, "started");
                self.say(Verbosity::Normal, &format!("{stage}: started"));
            }
            Event::Progress { stage, what, done, total } => self.progress(stage, what, *done, *total),
            Event::Note { stage, text } => {
                tracing::info!(stage, text);
                self.say(Verbosity::Verbose, &format!("{stage}: {text}"));
            }
            Event::Warning { stage, text } => {
                tracing::warn!(stage, text);
                self.say(Verbosity::Normal, &format!("warning: {stage}: {text}"));
            }
            Event::Finished { stage, seconds } => {
                tracing::info!(stage, seconds, "finished");
                self.close(stage);
                self.say(Verbosity::Normal, &format!("{stage}: done in {seconds:.1} s"));
            }
            Event::Failed { stage, error } => {
                tracing::error!(stage, error = %error, "failed");
                self.close(stage);
            }
            Event::Skipped { stage, because } => {
                tracing::warn!(stage, because, "skipped");
                self.say(Verbosity::Normal, &format!("{stage}: not begun, because `{because}` is not done"));
            }
        }
    }
}

/// One line of the plan.
pub fn plan_line(decision: &Decision) -> String {
    let action = match decision.action {
        Action::Cached => "cached",
        Action::Run => "run",
        Action::Wait => "run",
        _ => "left",
    };
    let reason = decision.reason();
    if reason.is_empty() {
        format!("{:22} {action}", decision.stage)
    } else {
        format!("{:22} {action:6}  {reason}", decision.stage)
    }
}

/// Sends `tracing` to a log file that is made when there is something to say, so that a fully cached run writes nothing.
pub fn log_to(path: PathBuf) {
    let subscriber = tracing_subscriber::fmt()
        .with_ansi(false)
        .with_target(false)
        .with_max_level(tracing::Level::INFO)
        .with_writer(LazyFile { path, file: OnceLock::new() })
        .finish();
    // A second call in one process (tests) keeps the first log.
    let _ = tracing::subscriber::set_global_default(subscriber);
}

struct LazyFile {
    path: PathBuf,
    file: OnceLock<Option<File>>,
}

impl<'a> tracing_subscriber::fmt::MakeWriter<'a> for LazyFile {
    type Writer = Box<dyn Write + 'a>;

    fn make_writer(&'a self) -> Self::Writer {
        let file = self.file.get_or_init(|| {
            std::fs::create_dir_all(self.path.parent()?).ok()?;
            OpenOptions::new().create(true).append(true).open(&self.path).ok()
        });
        match file {
            Some(file) => Box::new(file),
            None => Box::new(std::io::sink()),
        }
    }
}
