//! `flare-pipe completions`: completions for a shell.

use super::Arguments;
use crate::error::Result;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

/// Which shell.
#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// Shell to print completions for
    shell: Shell,
}

/// Prints the completions.
///
/// # Errors
/// None today.
pub fn completions(arguments: &CompletionsArguments) -> Result<()> {
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "flare-pipe", &mut std::io::stdout());
    Ok(())
}
