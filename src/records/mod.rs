//! Measured records: one file format a file, registered in [`FORMATS`]; all values in m/s² once read.
//!
//! A [`Folder`] lists files, also of archives; a [`Format`] makes [`Channel`]s of one; [`load()`] finds those of each sensor and component and
//! brings them to one time axis and one azimuth. An event that lacks one component is kept and the gap listed; an event of which nothing is
//! found is an error.

mod align;
mod at2;
mod channel;
mod cosmos;
mod csmip;
pub mod csv;
mod folder;
pub mod kiknet;
mod load;
mod mcap;
mod miniseed;
mod noise;
mod record;
mod remarks;
mod settings;
mod smc;
mod stationxml;
mod text;

pub use channel::{Channel, Orientation};
pub use folder::{Folder, Source};
pub use load::{Missing, Origin, Records, channels, files, load};
pub use mcap::visit as visit_mcap;
pub use noise::{Noise, add_noise};
pub use record::{Record, Sensor};
pub use remarks::remarks;
pub use settings::{DeclaredNoise, RecordSettings, Split};

use crate::error::{Error, Result};
use crate::registry::Entry;
use crate::units::AccelerationUnit;
use stationxml::Responses;

/// The record formats that can be read.
pub const FORMATS: &[Entry<dyn Format>] =
    &[csv::ENTRY, kiknet::ENTRY, cosmos::ENTRY, csmip::ENTRY, at2::ENTRY, smc::ENTRY, miniseed::ENTRY, mcap::ENTRY];

/// `records.format` of a folder whose files are told by their content.
pub const ANY: &str = "any";

/// A sensor's component of an event, for which a channel is looked for.
#[derive(Debug, Clone, Copy)]
pub struct Role<'a> {
    /// Event name as typed in the manifest.
    pub event: &'a str,
    /// Component name as typed in the manifest.
    pub component: &'a str,
    /// Name of the sensor.
    pub sensor: &'a str,
    /// Whether it is the input.
    pub is_input: bool,
    /// Number of output sensors.
    pub n_output: usize,
}

/// The channel that a format's names give a role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Usual {
    /// Name of the file.
    pub file: String,
    /// Name of the channel in it.
    pub channel: String,
}

/// How a file is read.
pub struct Reading<'a> {
    unit: Option<AccelerationUnit>,
    /// Whether a channel of this name may be asked for.
    is_wanted: &'a dyn Fn(&str) -> bool,
    /// What the files say that [`Format::is_companion`] names; read once, when first asked for.
    responses: &'a dyn Fn() -> Result<&'a Responses>,
}

impl Reading<'_> {
    /// The unit: what the file states, or else what is declared.
    ///
    /// # Errors
    /// When both are there and differ, or neither is.
    pub fn unit(&self, stated: Option<AccelerationUnit>) -> Result<AccelerationUnit> {
        unit(self.unit, stated)
    }
}

/// The unit: what a file states, or else what is declared.
fn unit(declared: Option<AccelerationUnit>, stated: Option<AccelerationUnit>) -> Result<AccelerationUnit> {
    match (declared, stated) {
        (Some(declared), Some(stated)) if declared != stated => {
            let what = format!("the file says that it is in {stated}, but {declared} is declared");
            Err(Error::new(what).hint(format!("leave `records.unit` out, or set `records.unit = \"{stated}\"`")))
        }
        (declared, stated) => declared.or(stated).ok_or_else(|| {
            let hint = "set `records.unit` to `g`, `gal` or `m/s2`, or write `# unit: gal` above the header of a CSV";
            Error::new("nothing says in what unit the accelerations are").hint(hint).usage()
        }),
    }
}

/// A file format of measured records.
///
/// Implementations name line, value and remedy in their errors; the caller adds file, event and component.
pub trait Format: Send + Sync {
    /// Whether a file of this name that begins with `head` (4 KiB or all of it) is of this format.
    fn recognises(&self, name: &str, head: &[u8]) -> bool;

    /// Whether a file of this name says more about the channels of others.
    fn is_companion(&self, _name: &str) -> bool {
        false
    }

    /// What the names of the files of an event begin with.
    fn stem(&self, event: &str) -> String {
        event.into()
    }

    /// The channel of a role by the names of the format; none where they do not say it and `[records.channels]` has to.
    ///
    /// # Errors
    /// When a station of this format does not have such a sensor.
    fn usual(&self, _role: &Role) -> Result<Option<Usual>> {
        Ok(None)
    }

    /// The accelerations in a file.
    ///
    /// # Errors
    /// When its content is not sound.
    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>>;
}
