//! Cached, resumable stages on a directed acyclic graph; knows nothing of soil.
//!
//! A [`Recipe`] (a file of `pipelines/`) names stages and who reads whose output; a [`Graph`] is that recipe unfolded over one
//! manifest; [`run()`] decides for every stage whether its output is in the [`Store`] and computes what is not. The key of an
//! output is a hash of everything that can change it and of nothing else ([`Parts`]), so a rerun can be explained part by
//! part. Outputs appear by fsync and rename under a lock per key: a killed run loses the work in flight, nothing more.

mod change;
mod decide;
mod executor;
mod files;
mod gc;
mod graph;
mod key;
mod lock;
mod parameters;
mod recipe;
mod reporter;
mod results;
mod run;
mod site;
mod stage;
mod store;
mod task;
#[cfg(test)]
mod toy;
mod unfold;
mod verify;
#[cfg(test)]
mod whole_runs;

pub use change::Change;
pub use decide::{Action, Decision, Options, Reason};
pub use executor::{Shard, ShardTask, Slurm, SlurmSettings, active_jobs, cancel_jobs, shard_of};
pub use files::write_if_changed;
pub use gc::{Unused, remove, unused};
pub use graph::{Graph, Link, Node};
pub use key::{Address, Key, OutsideFile, Parts, content_hash};
pub use lock::{Lease, Lock, Owner};
pub use recipe::{Recipe, RecipeStage};
pub use reporter::{Event, Reporter};
pub use results::{Results, StageStatus};
pub use run::{Failure, Mode, Summary, compute_shard, run};
pub use site::Site;
pub use stage::Stage;
pub use store::{ItemRecord, OutputFile, Outputs, State, Store, Timing};
pub use task::{Item, ItemKind, ItemOutcome, Task};
pub use verify::{Damage, Verification, discard, verify_all, verify_site};
