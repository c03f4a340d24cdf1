//! The only unit conversions of the program: inside, everything is SI.

use crate::error::{Error, Result};

/// Standard acceleration of gravity, m/s².
pub const G_M_S2: f64 = 9.806_65;

/// Kilopascal in pascal.
pub const KPA: f64 = 1e3;

/// Gigapascal in pascal.
pub const GPA: f64 = 1e9;

/// Unit of a measured acceleration, as typed in a manifest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
pub enum AccelerationUnit {
    /// Standard gravity.
    #[serde(rename = "g")]
    Gravity,
    /// 1 gal = 0.01 m/s².
    #[serde(rename = "gal")]
    Gal,
    /// m/s².
    #[serde(rename = "m/s2")]
    MetrePerSecondSquared,
}

impl std::fmt::Display for AccelerationUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl AccelerationUnit {
    const ALL: [Self; 3] = [Self::Gravity, Self::Gal, Self::MetrePerSecondSquared];

    /// As typed in a manifest.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gravity => "g",
            Self::Gal => "gal",
            Self::MetrePerSecondSquared => "m/s2",
        }
    }

    /// The unit of this name, in any case.
    ///
    /// # Errors
    /// When there is none.
    pub fn named(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|unit| unit.name().eq_ignore_ascii_case(name));
        let unknown = || Error::new(format!("the unit `{name}` is not known")).hint("it must be `g`, `gal` or `m/s2`");
        found.ok_or_else(unknown)
    }

    /// How many m/s² one unit is.
    pub fn m_s2(self) -> f64 {
        match self {
            Self::Gravity => G_M_S2,
            Self::Gal => 0.01,
            Self::MetrePerSecondSquared => 1.0,
        }
    }
}
