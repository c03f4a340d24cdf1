//! The command line of `flare-pipe`: parse, do, render the error once, exit 0 (done), 1 (a stage failed), 2 (usage) or 128 and the
//! number of the signal that stopped it.

use clap::Parser;
use flare_pipe::Error;
use flare_pipe::cli::{Arguments, dispatch, stop_on_signals, tell};
use std::process::ExitCode;

fn main() -> ExitCode {
    stop_on_signals();
    let arguments = Arguments::try_parse().unwrap_or_else(|error| {
        if error.use_stderr() && std::env::args().any(|argument| argument == "--json") {
            let error = Error::new(error.to_string().trim().trim_start_matches("error: ")).usage();
            tell(&error, true);
            std::process::exit(error.exit_status().into());
        }
        error.exit()
    });
    let json = arguments.json();
    match dispatch(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tell(&error, json);
            ExitCode::from(error.exit_status())
        }
    }
}
