//! What a training is given beside cases and settings.

use crate::numerics::spill::Spill;
use crate::progress::Progress;
use std::path::Path;

/// Where a training keeps its state and what is made of its cases, and whom it tells.
pub struct Training<'a> {
    /// Folder from which an interrupted training goes on, with the same bytes as one that was never interrupted.
    pub checkpoint_dir: Option<&'a Path>,
    /// Keeps what is made of the cases.
    pub spill: Spill,
    /// Whom it tells.
    pub progress: &'a dyn Progress,
}

impl<'a> Training<'a> {
    /// One that keeps everything in memory and goes on from nothing.
    pub fn in_memory(progress: &'a dyn Progress) -> Self {
        Self { checkpoint_dir: None, spill: Spill::none(), progress }
    }
}
