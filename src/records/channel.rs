//! One channel of a record file: what its file says of it, and its samples.

use jiff::civil::DateTime;

/// Where a channel points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Orientation {
    /// Horizontal, degrees clockwise from north, 0 ≤ azimuth < 360.
    AzimuthDeg(f64),
    /// Up or down.
    Vertical,
    /// The file does not say.
    Unknown,
}

impl Orientation {
    /// Horizontal towards this azimuth in degrees, 360 being north.
    pub fn azimuth(deg: f64) -> Self {
        Self::AzimuthDeg(deg.rem_euclid(360.0))
    }
}

/// One channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// Name of its file, without folders.
    pub file: String,
    /// What the file calls it: a column, a number, a code; the name of the file where it holds no more than one.
    pub name: String,
    /// What else the file says of it, for people.
    pub about: String,
    /// Where it points.
    pub orientation: Orientation,
    /// Depth, m.
    pub depth_m: Option<f64>,
    /// Time of the first sample, UTC.
    pub start: Option<DateTime>,
    /// Time step, s.
    pub dt_s: f64,
    /// Acceleration, m/s².
    pub acceleration_m_s2: Vec<f64>,
    /// What is odd about it.
    pub remarks: Vec<String>,
}

impl Channel {
    /// The channel of a file that holds one, of which nothing else is known.
    pub fn alone(file: &str, dt_s: f64, acceleration_m_s2: Vec<f64>) -> Self {
        Self {
            file: file.into(),
            name: file.into(),
            about: String::new(),
            orientation: Orientation::Unknown,
            depth_m: None,
            start: None,
            dt_s,
            acceleration_m_s2,
            remarks: Vec::new(),
        }
    }

    /// How a manifest can name it: `file`, or `file:name`.
    pub fn path(&self) -> String {
        if self.name == self.file { self.file.clone() } else { format!("{}:{}", self.file, self.name) }
    }

    /// Its path with what the file says of it.
    pub fn described(&self) -> String {
        let orientation = match self.orientation {
            Orientation::AzimuthDeg(deg) => format!("{deg:.0}°"),
            Orientation::Vertical => "vertical".into(),
            Orientation::Unknown => String::new(),
        };
        let depth = self.depth_m.map(|depth_m| format!("{depth_m} m deep")).unwrap_or_default();
        let said: Vec<String> =
            [orientation, depth, self.about.clone()].into_iter().filter(|text| !text.is_empty()).collect();
        if said.is_empty() { format!("`{}`", self.path()) } else { format!("`{}` ({})", self.path(), said.join(", ")) }
    }
}
