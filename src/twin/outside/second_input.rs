//! A second, unrecorded shaking that reaches every sensor: traffic, a structure, another event.

use super::{Outside, own_motion, ranges};
use crate::effects::{Channels, Recording};
use crate::error::Result;
use crate::metrics::rms;
use crate::registry::{self, Entry};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Outside> = Entry {
    name: "second_input",
    about: "a second, unrecorded shaking that reaches the output sensors",
    build: |table| Ok(Box::new(registry::params::<SecondInput>(table)?.checked()?)),
    schema: || schemars::schema_for!(SecondInput),
};

/// Adds a motion of its own to the output sensors, 30 % weaker at the base than at the surface.
///
/// ```text
/// y(z, t) = x(z, t) + s · rms(x) (1 − 0.3 z/H) v(t)/rms(v)              (1)
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SecondInput {
    /// RMS s of the second motion over that of the first, at the surface.
    share: f64,
}

impl SecondInput {
    fn checked(self) -> Result<Self> {
        ranges(&[("share", self.share, 0.0, 10.0, "")])?;
        Ok(self)
    }
}

impl Outside for SecondInput {
    fn add(&self, recording: &Recording<'_>, _: f64, seed: u64, motions: &mut [Channels]) -> Result<()> {
        for (c, component) in recording.components.iter().enumerate() {
            let n = motions[0][c].len();
            let own = own_motion(recording, seed, &format!("second input {component}"), n, [0.3, 9.0]);
            let largest = motions[1..].iter().map(|s| rms(&s[c])).fold(0.0, f64::max);
            let scale = self.share * largest / rms(&own).max(f64::MIN_POSITIVE);
            for (channels, depth_m) in motions.iter_mut().zip(recording.depths_m).skip(1) {
                let here = scale * (1.0 - 0.3 * depth_m / recording.depths_m[0]); // (1)
                channels[c].iter_mut().zip(&own).for_each(|(x, v)| *x += here * v);
            }
        }
        Ok(())
    }
}
