//! Who computes the items of an ensemble.

mod local;
mod slurm;

pub(super) use local::{Ensemble, Permits, ShardRun, guarded};
pub use slurm::{Shard, ShardTask, Slurm, SlurmSettings, active_jobs, cancel_jobs, shard_of};
pub(super) use slurm::{Submission, standing};
