//! Measured records: one file format a file, registered in [`FORMATS`]; all values in m/s² once read.
//!
//! An event that lacks one component is kept and the gap listed; an event of which nothing is found is an error.

pub mod csv;
pub mod kiknet;
mod load;
mod noise;
mod record;
mod remarks;
mod settings;

pub use load::{Missing, Records, load};
pub use noise::{Noise, add_noise};
pub use record::{Record, Sensor};
pub use remarks::remarks;
pub use settings::{DeclaredNoise, RecordSettings, Split};

use crate::error::Result;
use crate::registry::Entry;
use crate::units::AccelerationUnit;
use std::path::{Path, PathBuf};

/// The record formats that can be read.
pub const FORMATS: &[Entry<dyn Format>] = &[csv::ENTRY, kiknet::ENTRY];

/// One component of one event, as asked of a format.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Folder of the files.
    pub dir: &'a Path,
    /// Event name as typed in the manifest.
    pub event: &'a str,
    /// Component name as typed in the manifest.
    pub component: &'a str,
    /// Unit declared in the manifest; none where the files say it.
    pub unit: Option<AccelerationUnit>,
    /// Name of the input sensor.
    pub input: &'a str,
    /// Names of the output sensors, in the order wanted.
    pub outputs: &'a [String],
}

/// A file format of measured records.
///
/// Implementations name file, line, value and remedy in their errors; the caller adds event and component.
pub trait Format: Send + Sync {
    /// The files that hold this component of this event, whether or not they exist.
    fn files(&self, request: &Request) -> Vec<PathBuf>;

    /// Reads this component of this event; called only when all of [`Format::files`] exist.
    ///
    /// # Errors
    /// When a file cannot be read or its content is not a sound record.
    fn read(&self, request: &Request) -> Result<Record>;
}
