//! The command line of `flare-pipe`: parse, do, render the error once, exit 0 (done), 1 (a stage failed) or 2 (usage).

use clap::Parser;
use flare_pipe::cli::{Arguments, dispatch};
use std::process::ExitCode;

fn main() -> ExitCode {
    match dispatch(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_status())
        }
    }
}
