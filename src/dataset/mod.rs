//! Trajectories on disk (MCAP), their index and splits, decimation and normalisation.

mod coarse;
mod depth_profile;
mod index;
mod message;
mod normalisation;
mod observation;
mod reader;
mod sampler;
mod writer;

pub use coarse::{Coarse, pick_channels};
pub use depth_profile::{DepthProfile, ElementHistory};
pub use index::{Index, IndexCase, IndexSensor, Outcome};
pub use normalisation::{Accumulator, Normalisation};
pub use observation::{Observation, observation_matrix};
pub use reader::{Trajectory, read_trajectory};
pub use sampler::{Sampler, all_sensor_histories, sensor_histories};
pub use writer::{Header, Sample, TrajectoryWriter};
