//! What people see of a run on stderr, and what the log keeps.

use super::output::say;
use crate::pipeline::{Action, Decision, Event, Reporter};
use console::Style;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// Characters of a remark beside a bar.
const REMARK: usize = 100;

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

/// Prints a run for people; bars and colour only on a terminal. Everything goes to the log through `tracing` as well.
pub struct Terminal {
    bars: MultiProgress,
    by_stage: Mutex<HashMap<String, Bar>>,
    /// Stages of the pipeline, and those that are done.
    count: Mutex<[usize; 2]>,
    is_terminal: bool,
    verbosity: Verbosity,
}

/// The bar of one stage.
struct Bar {
    bar: ProgressBar,
    /// Wall time that is expected, s.
    last_s: Option<f64>,
}

impl Terminal {
    /// A reporter for stderr.
    pub fn new(verbosity: Verbosity) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let (by_stage, count) = (Mutex::default(), Mutex::default());
        Self { bars: MultiProgress::new(), by_stage, count, is_terminal, verbosity }
    }

    fn say(&self, at: Verbosity, line: &str) {
        if self.verbosity < at {
            return;
        }
        if self.is_terminal {
            self.bars.suspend(|| say!("{line}"));
        } else {
            say!("{line}");
        }
    }

    /// `[12/31]`, the stage among all being done next.
    fn number(&self) -> String {
        let [all, done] = *self.count.lock().unwrap_or_else(PoisonError::into_inner);
        format!("[{:>w$}/{all}]", (done + 1).min(all), w = all.to_string().len())
    }

    fn one_done(&self) {
        self.count.lock().unwrap_or_else(PoisonError::into_inner)[1] += 1;
    }

    fn painted(&self, style: &Style, text: &str) -> String {
        if self.is_terminal { style.apply_to(text).to_string() } else { text.to_string() }
    }

    /// Shows that a stage is at work.
    fn open(&self, stage: &str, last_s: Option<f64>) {
        if !self.is_terminal || self.verbosity < Verbosity::Normal {
            return;
        }
        let bar = self.bars.add(ProgressBar::new_spinner());
        bar.set_style(style(false, last_s));
        bar.set_prefix(stage.to_string());
        bar.enable_steady_tick(Duration::from_millis(200));
        self.by_stage.lock().unwrap_or_else(PoisonError::into_inner).insert(stage.to_string(), Bar { bar, last_s });
    }

    fn progress(&self, stage: &str, what: &str, done: u64, total: u64) {
        if !self.is_terminal || self.verbosity < Verbosity::Normal {
            return;
        }
        let bars = self.by_stage.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(Bar { bar, last_s }) = bars.get(stage) else { return };
        // What is counted anew again and again is no share of the whole.
        let is_counted = total > 1 && done <= total;
        bar.set_style(style(is_counted, *last_s));
        bar.set_length(total);
        bar.set_message(what.to_string());
        bar.set_position(done);
    }

    fn remark(&self, stage: &str, text: &str) {
        let bars = self.by_stage.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(Bar { bar, .. }) = bars.get(stage) {
            bar.set_message(text.chars().take(REMARK).collect::<String>());
        }
    }

    fn close(&self, stage: &str) {
        let bar = self.by_stage.lock().unwrap_or_else(PoisonError::into_inner).remove(stage);
        if let Some(Bar { bar, .. }) = bar {
            bar.finish_and_clear();
        }
    }
}

/// A bar that is counted, or one that only tells the time.
fn style(is_counted: bool, last_s: Option<f64>) -> ProgressStyle {
    let about = last_s.map_or(String::new(), |s| format!(" of about {}", clock(s)));
    let template = if is_counted {
        format!("{{prefix:22}} {{bar:24}} {{pos}}/{{len}} {{msg}}, {{elapsed}}{about}")
    } else {
        format!("{{prefix:22}} {{spinner}} {{elapsed}}{about} {{wide_msg}}")
    };
    ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// Wall time for people: `0.4 s`, `38 s`, `2:10`, `1:02:05`.
pub fn clock(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..60 => format!("{whole} s"),
        60..3600 => format!("{}:{:02}", whole / 60, whole % 60),
        _ => format!("{}:{:02}:{:02}", whole / 3600, whole / 60 % 60, whole % 60),
    }
}

impl Reporter for Terminal {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Planned(decisions) => {
                let n_cached = decisions.iter().filter(|d| d.action == Action::Cached).count();
                *self.count.lock().unwrap_or_else(PoisonError::into_inner) = [decisions.len(), n_cached];
                for decision in *decisions {
                    if decision.action != Action::Cached {
                        tracing::info!(stage = %decision.stage, reason = %decision.reason(), "planned");
                    }
                    self.say(Verbosity::Verbose, &plan_line(decision));
                }
                let n = decisions.len();
                self.say(Verbosity::Normal, &format!("{n} stages, {n_cached} of them in the cache"));
            }
            Event::Decided(decision) => {
                if decision.action == Action::Cached {
                    self.one_done();
                }
                self.say(Verbosity::Verbose, &plan_line(decision));
            }
            Event::Started { stage, last_s } => {
                tracing::info!(stage, "started");
                let about = last_s.map_or(String::new(), |s| format!(", about {}", clock(s)));
                self.say(Verbosity::Normal, &format!("{} {stage}{about}", self.number()));
                self.open(stage, *last_s);
            }
            Event::Waits { stage, owner } => {
                let whom = owner.map_or("another process".into(), |o| format!("process {} on `{}`", o.pid, o.host));
                tracing::info!(stage, whom, "waits");
                self.say(Verbosity::Normal, &format!("{stage}: waits for {whom}, which computes it"));
            }
            Event::Progress { stage, what, done, total } => self.progress(stage, what, *done, *total),
            Event::Note { stage, text } => {
                tracing::info!(stage, text);
                self.remark(stage, text);
                self.say(Verbosity::Verbose, &format!("{stage}: {text}"));
            }
            Event::Warning { stage, text } => {
                tracing::warn!(stage, text);
                let warning = self.painted(&Style::new().yellow().bold(), "warning:");
                self.say(Verbosity::Normal, &format!("{warning} {stage}: {text}"));
            }
            Event::Finished { stage, seconds } => {
                tracing::info!(stage, seconds, "finished");
                self.close(stage);
                let done = self.painted(&Style::new().green(), "done");
                self.say(Verbosity::Normal, &format!("{} {stage}: {done} in {}", self.number(), clock(*seconds)));
                self.one_done();
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
    let last_s = decision.last_s.filter(|_| matches!(decision.action, Action::Run | Action::Wait));
    let about = last_s.map(|s| format!("about {}", clock(s)));
    let reason = about.into_iter().chain(Some(reason)).filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ");
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_told_as_people_tell_them() {
        assert_eq!([0.42, 38.2, 130.0, 3725.4].map(clock), ["0.4 s", "38 s", "2:10", "1:02:05"]);
    }
}
