//! `--jobs`: how much is computed at once.

use crate::error::{Error, Result};
use clap::Args;

/// Most threads: more than the cores of any machine, and as many as one can start without harm.
const MOST: usize = 1024;

/// How much is computed at once.
#[derive(Debug, Args)]
pub struct JobsArgument {
    /// Stages, trajectories and twins computed at once, and threads in all [default: one a core]
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
}

impl JobsArgument {
    /// The number, `otherwise` where none was given.
    ///
    /// # Errors
    /// When it is out of range.
    pub fn or(&self, otherwise: usize) -> Result<usize> {
        match self.jobs {
            Some(jobs) if !(1..=MOST).contains(&jobs) => {
                Err(Error::new(format!("`--jobs` must be in 1…{MOST}, got {jobs}"))
                    .hint("more threads than the machine has cores gain nothing")
                    .usage())
            }
            jobs => Ok(jobs.unwrap_or(otherwise)),
        }
    }
}

/// Threads of the process. Only the first call sets them; results do not depend on how many there are.
pub fn start_threads(jobs: usize) {
    let _ = rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global();
}
