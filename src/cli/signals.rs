//! What a signal that ends the program does: it says so, and how to go on.

use super::output::say;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// Ends the program at an interrupt, a termination or a hang-up: what is stored stays, what is at work is begun anew from its last
/// checkpoint by the next run. The exit status is 128 and the number of the signal.
pub fn stop_on_signals() {
    let Ok(mut signals) = Signals::new([SIGINT, SIGTERM, SIGHUP]) else { return };
    std::thread::spawn(move || {
        if let Some(signal) = signals.forever().next() {
            say!("\nstopped; run again to go on");
            std::process::exit(128 + signal);
        }
    });
}
