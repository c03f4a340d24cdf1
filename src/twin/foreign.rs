//! Truths that this program would not write: another law or other curves, another damping, another mesh, processed records.
//!
//! A matrix draws them for its foreign cells. What they differ in is no effect of the catalogue and lies within what a site investigation
//! leaves open: where nothing else holds, the diagnosis should name nothing.

use super::{Processing, Truth};
use crate::effects::Array;
use crate::error::{Error, Result};
use rand::{Rng, RngExt};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use toml::{Table, Value};

/// Damping of the truth column as a Rayleigh damping of its own, in place of what its laws ask for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OwnDamping {
    /// Damping ratio at both frequencies.
    pub ratio: f64,
    /// The two frequencies, Hz: between them damping is less, beyond them more.
    pub at_hz: [f64; 2],
}

impl OwnDamping {
    /// Coefficients of mass and stiffness.
    pub fn rayleigh(&self) -> crate::column::Rayleigh {
        crate::column::Rayleigh::of_ratio(self.ratio, self.at_hz.map(|f| std::f64::consts::TAU * f))
    }

    /// Refuses values out of range.
    ///
    /// # Errors
    /// When the ratio is not in 0…0.3 or the frequencies do not rise within 0.05…50 Hz.
    pub fn check(&self) -> Result<()> {
        let Self { ratio, at_hz: [low, high] } = *self;
        if !(0.0..=0.3).contains(&ratio) {
            return Err(Error::new(format!("`damping.ratio` must be in 0…0.3, got {ratio}")).usage());
        }
        if !(low >= 0.05 && low < high && high <= 50.0) {
            let what = format!("`damping.at_hz` must be two rising frequencies in 0.05…50 Hz, got [{low}, {high}]");
            return Err(Error::new(what).usage());
        }
        Ok(())
    }
}

/// What foreign truths are drawn from (matrix section `[foreign]`). Everywhere `[a, b]` is a range to draw from evenly, a number itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Foreign {
    /// Elements of the truth column per declared element.
    pub mesh_factor: usize,
    /// Largest time step of the truth column, s.
    pub max_step_s: f64,
    /// Law parameters by law name, laid over the declared ones; with a `kind` in place of them.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, serde_json::Map<String, serde_json::Value>>")]
    pub law: BTreeMap<String, Table>,
    /// Damping of its own; that of the laws where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<ForeignDamping>,
    /// Processing of the records.
    #[serde(default)]
    pub processing: Processing,
}

/// Ranges of a truth's own damping.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForeignDamping {
    /// Damping ratio.
    pub ratio: [f64; 2],
    /// Lower frequency, Hz.
    pub low_hz: [f64; 2],
    /// Upper frequency, Hz.
    pub high_hz: [f64; 2],
}

impl Foreign {
    /// `truth`, made foreign.
    pub(super) fn of(&self, truth: &Truth, random: &mut impl Rng) -> Truth {
        let mut law = truth.law.clone();
        for (name, table) in &self.law {
            law.entry(name.clone()).or_default().extend(drawn(table, random));
        }
        let damping = self.damping.map(|ranges| OwnDamping {
            ratio: within(ranges.ratio, random),
            at_hz: [within(ranges.low_hz, random), within(ranges.high_hz, random)],
        });
        let (mesh_factor, max_step_s, processing) = (self.mesh_factor, self.max_step_s, self.processing);
        Truth { law, damping, mesh_factor, max_step_s, processing, ..truth.clone() }
    }

    /// The array of its truths: where these have a damping of their own, laws have none.
    pub(super) fn array(&self, declared: &Array) -> Array {
        let mut array = declared.clone();
        for layer in array.profile.layers.iter_mut().filter(|_| self.damping.is_some()) {
            Arc::make_mut(&mut layer.law).insert("damping_ratio".into(), 0.0.into());
        }
        array
    }

    /// The ends of all ranges as truths, so that what cannot be drawn is refused before anything runs.
    pub(super) fn extremes(&self, truth: &Truth) -> [Truth; 2] {
        [0, 1].map(|end| {
            let mut law = truth.law.clone();
            for (name, table) in &self.law {
                let ends = table.iter().map(|(key, value)| {
                    (key.clone(), range(value).map_or_else(|| value.clone(), |r| Value::Float(r[end])))
                });
                law.entry(name.clone()).or_default().extend(ends);
            }
            let damping =
                self.damping.map(|r| OwnDamping { ratio: r.ratio[end], at_hz: [r.low_hz[end], r.high_hz[end]] });
            let (mesh_factor, max_step_s, processing) = (self.mesh_factor, self.max_step_s, self.processing);
            Truth { law, damping, mesh_factor, max_step_s, processing, ..truth.clone() }
        })
    }
}

/// `table` with every range `[a, b]` of numbers drawn.
pub(super) fn drawn(table: &Table, random: &mut impl Rng) -> Table {
    let mut value = |v: &Value| range(v).map_or_else(|| v.clone(), |ends| Value::Float(within(ends, random)));
    table.iter().map(|(key, v)| (key.clone(), value(v))).collect()
}

fn within([low, high]: [f64; 2], random: &mut impl Rng) -> f64 {
    low + (high - low) * random.random::<f64>()
}

/// The ends of a range: two numbers in brackets.
fn range(value: &Value) -> Option<[f64; 2]> {
    let number = |v: &Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    match value.as_array().map(Vec::as_slice) {
        Some([low, high]) => Some([number(low)?, number(high)?]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn own_damping_is_the_ratio_at_both_frequencies_and_less_between() {
        let own = OwnDamping { ratio: 0.02, at_hz: [1.0, 10.0] };
        let rayleigh = own.rayleigh();
        let ratio = |f: f64| {
            let omega = std::f64::consts::TAU * f;
            0.5 * (rayleigh.alpha_1_s / omega + rayleigh.beta_s * omega)
        };
        assert!((ratio(1.0) - 0.02).abs() < 1e-12 && (ratio(10.0) - 0.02).abs() < 1e-12 && ratio(3.0) < 0.015);
        let refused = |own: OwnDamping| own.check().unwrap_err().to_string();
        assert!(refused(OwnDamping { ratio: 0.5, ..own }).contains("0…0.3, got 0.5"));
        assert!(refused(OwnDamping { at_hz: [5.0, 2.0], ..own }).contains("rising"));
    }

    #[test]
    fn ranges_are_drawn_and_numbers_kept() {
        let table: Table =
            toml::from_str("kind = 'second_input'\nshare = [0.3, 0.6]\nother = 2.0\nwhole = [1, 3]").unwrap();
        let mut random = random::stream(1, "foreign");
        let draws: Vec<Table> = (0..50).map(|_| drawn(&table, &mut random)).collect();
        for d in &draws {
            assert!((0.3..=0.6).contains(&d["share"].as_float().unwrap()) && d["other"].as_float() == Some(2.0));
            assert!(
                (1.0..=3.0).contains(&d["whole"].as_float().unwrap()) && d["kind"].as_str() == Some("second_input")
            );
        }
        assert!(draws[0]["share"] != draws[1]["share"]);
    }
}
