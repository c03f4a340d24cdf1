//! StationXML: sensitivity, azimuth, dip and depth of the channels of miniSEED files.
//!
//! Source: FDSN StationXML schema 1.2.

use super::Source;
use super::channel::Orientation;
use crate::error::{Error, Result};
use std::collections::BTreeMap;

/// Degrees from the vertical within which a channel is vertical, and from the horizontal within which it is horizontal.
const DIP_DEG: f64 = 5.0;

/// What a file says of a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    sensitivity: f64,
    unit: String,
    /// Where it points.
    pub orientation: Orientation,
    /// Its depth, m.
    pub depth_m: Option<f64>,
}

impl Response {
    /// Counts of 1 m/s².
    ///
    /// # Errors
    /// When the channel is no accelerometer.
    pub fn counts_per_m_s2(&self) -> Result<f64> {
        let factor = match self.unit.to_uppercase().as_str() {
            "M/S**2" | "M/S^2" | "M/S2" | "M/(S**2)" | "M/S/S" => 1.0,
            "CM/S**2" | "CM/S^2" | "CM/S2" | "GAL" => 100.0,
            "G" => 1.0 / crate::units::G_M_S2,
            other => {
                return Err(Error::new(format!("its sensitivity is per `{other}`, it records no acceleration"))
                    .hint("take the accelerometer of the station, often `HN?` or `EN?`"));
            }
        };
        Ok(self.sensitivity * factor)
    }
}

/// Channels by code.
pub type Responses = BTreeMap<String, Response>;

/// The channels of the StationXML files `sources`; the last epoch of each.
///
/// # Errors
/// When a file cannot be read, or a number in it is none.
pub fn read<'a>(sources: impl Iterator<Item = &'a Source>) -> Result<Responses> {
    let mut found = Responses::new();
    for source in sources {
        let bytes = source.bytes()?;
        add(&String::from_utf8_lossy(&bytes), &mut found).map_err(|e| e.at(format!("`{}`", source.shown())))?;
    }
    Ok(found)
}

fn add(text: &str, found: &mut Responses) -> Result<()> {
    let unsound = |e: roxmltree::Error| Error::new("the file is no XML").cause(e).hint("download it again");
    let document = roxmltree::Document::parse(text.trim_start_matches('\u{feff}')).map_err(unsound)?;
    let children = |node: roxmltree::Node<'_, '_>, name: &'static str| {
        node.children().filter(move |child| child.tag_name().name() == name).map(|child| child.id()).collect::<Vec<_>>()
    };
    let node = |id| document.get_node(id).unwrap_or_else(|| document.root());
    let code = |node: roxmltree::Node<'_, '_>, name: &str| node.attribute(name).unwrap_or("").trim().to_string();
    for network in children(document.root_element(), "Network").into_iter().map(node) {
        for station in children(network, "Station").into_iter().map(node) {
            for channel in children(station, "Channel").into_iter().map(node) {
                let name = [
                    code(network, "code"),
                    code(station, "code"),
                    code(channel, "locationCode"),
                    code(channel, "code"),
                ];
                let name = name.join(".");
                if let Some(response) = response(channel).map_err(|e| e.at(format!("channel `{name}`")))? {
                    found.insert(name, response);
                }
            }
        }
    }
    Ok(())
}

/// What is said of one channel; none where it has no sensitivity.
fn response(channel: roxmltree::Node<'_, '_>) -> Result<Option<Response>> {
    let child = |node: roxmltree::Node<'_, '_>, path: &[&str]| -> Option<String> {
        let mut text = node;
        for name in path {
            text = text.children().find(|c| c.tag_name().name() == *name)?;
        }
        text.text().map(|text| text.trim().to_string())
    };
    let number = |path: &[&str]| -> Result<Option<f64>> {
        let Some(text) = child(channel, path) else { return Ok(None) };
        let value = text.parse::<f64>().ok().filter(|v| v.is_finite());
        value.map(Some).ok_or_else(|| Error::new(format!("`{}` must be a number, got `{text}`", path.join("/"))))
    };
    let sensitivity = ["Response", "InstrumentSensitivity"];
    let [gain, unit] = [&["Value"][..], &["InputUnits", "Name"]].map(|rest| [&sensitivity[..], rest].concat());
    let (Some(value), Some(unit)) = (number(&gain)?, child(channel, &unit)) else { return Ok(None) };
    if value == 0.0 {
        return Err(Error::new("`InstrumentSensitivity` is 0").hint("it is the number of counts of one unit"));
    }
    let orientation = match (number(&["Azimuth"])?, number(&["Dip"])?) {
        (_, Some(dip)) if dip.abs() > 90.0 - DIP_DEG => Orientation::Vertical,
        (Some(azimuth), dip) if dip.unwrap_or(0.0).abs() < DIP_DEG => Orientation::azimuth(azimuth),
        _ => Orientation::Unknown,
    };
    Ok(Some(Response { sensitivity: value, unit, orientation, depth_m: number(&["Depth"])? }))
}
