//! What a signal that ends the program does: it says so, and how to go on.

use super::output::say;
use crate::pipeline::{active_jobs, cancel_jobs};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;

/// How long the last word may take where whoever reads does not.
const LAST_WORD: Duration = Duration::from_millis(300);

static CAN_GO_ON: AtomicBool = AtomicBool::new(false);
static CANCELS_JOBS: AtomicBool = AtomicBool::new(false);

/// Says that jobs on a cluster are to end with this process.
pub(super) fn cancels_jobs() {
    CANCELS_JOBS.store(true, Ordering::Relaxed);
}

/// Whether jobs that are at work are to be cancelled: as was said before, or as whoever interrupts says now.
fn is_to_cancel(signal: i32, jobs: &[String]) -> bool {
    if CANCELS_JOBS.load(Ordering::Relaxed) {
        return true;
    }
    if signal != SIGINT || !std::io::stdin().is_terminal() {
        return false;
    }
    say!("\nCancel job {} on the cluster? [y/N]", jobs.join(", "));
    let mut answer = String::new();
    let _ = std::io::stdin().read_line(&mut answer);
    ["y", "yes"].contains(&answer.trim().to_lowercase().as_str())
}

/// Says that what this process does goes on where it was when it is started again.
pub(super) fn goes_on_when_run_again() {
    CAN_GO_ON.store(true, Ordering::Relaxed);
}

/// Ends the program at an interrupt, a termination or a hang-up, unless it was started to ignore that: what is stored stays, what is at
/// work is begun anew from its last checkpoint by the next run. The exit status is 128 and the number of the signal.
pub fn stop_on_signals() {
    let all = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| !is_ignored(*signal));
    let Ok(mut signals) = Signals::new(all) else { return };
    std::thread::spawn(move || {
        if let Some(signal) = signals.forever().next() {
            let jobs = active_jobs();
            if !jobs.is_empty() {
                if is_to_cancel(signal, &jobs) {
                    cancel_jobs();
                } else {
                    say!("\njob {} goes on; the next run waits for it", jobs.join(", "));
                }
            }
            let (said, heard) = mpsc::channel();
            std::thread::spawn(move || {
                let how = if CAN_GO_ON.load(Ordering::Relaxed) { "; run again to go on" } else { "" };
                say!("\nstopped{how}");
                let _ = said.send(());
            });
            let _ = heard.recv_timeout(LAST_WORD);
            std::process::exit(128 + signal);
        }
    });
}

/// Whether the process was started with this signal ignored, as `nohup` does; not known, and so no, where there is no `/proc`.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask & (1 << (signal - 1)) != 0
}
