//! What is done to records before anyone gets them: noise cut with the rest above some frequency, and nothing from before the event.

use crate::error::{Error, Result};
use crate::numerics::filter::low_pass_zero_phase;
use crate::numerics::integrate::cumulative;
use crate::records::Record;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Processing of the noisy records (truth section `[processing]`); nothing by default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Processing {
    /// Corner of a low-pass without phase on what was recorded, noise included, Hz; none where absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub low_pass_hz: Option<f64>,
    /// Records start where the input has brought this share of its energy, in the component where that comes first: 0 keeps them whole.
    pub cut_energy_share: f64,
}

impl Processing {
    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Refuses values out of range.
    ///
    /// # Errors
    /// When the corner is not in 1…45 Hz or the share not in 0…0.2.
    pub fn check(&self) -> Result<()> {
        let range = |name: &str, value: f64, low: f64, high: f64, unit: &str| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(Error::new(format!("`processing.{name}` must be in {low}…{high}{unit}, got {value}")).usage())
        };
        range("low_pass_hz", self.low_pass_hz.unwrap_or(20.0), 1.0, 45.0, " Hz")?;
        range("cut_energy_share", self.cut_energy_share, 0.0, 0.2, "")
    }

    /// The records of the components of one event, processed alike.
    pub(super) fn apply(&self, records: Vec<Record>) -> Vec<Record> {
        let first_s = records.iter().map(|r| energy_time_s(r, self.cut_energy_share)).fold(f64::INFINITY, f64::min);
        let processed = |mut record: Record| {
            if let Some(corner_hz) = self.low_pass_hz {
                for sensor in std::iter::once(&mut record.input).chain(&mut record.outputs) {
                    sensor.acceleration_m_s2 = low_pass_zero_phase(&sensor.acceleration_m_s2, record.dt_s, corner_hz);
                }
            }
            if self.cut_energy_share > 0.0 { record.window(first_s, record.duration_s()) } else { record }
        };
        records.into_iter().map(processed).collect()
    }
}

/// When the input has brought `share` of its energy, s.
fn energy_time_s(record: &Record, share: f64) -> f64 {
    let squared: Vec<f64> = record.input.acceleration_m_s2.iter().map(|v| v * v).collect();
    let energy = cumulative(&squared, record.dt_s);
    let level = share * energy.last().copied().unwrap_or(0.0);
    energy.partition_point(|e| *e < level) as f64 * record.dt_s
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::{Noise, Sensor, add_noise};

    fn record(component: &str, starts_s: f64) -> Record {
        let wave = |i: usize| {
            let t = i as f64 * 0.01 - starts_s;
            if t > 0.0 { (12.0 * t).sin() * (-(t / 3.0)).exp() } else { 0.0 }
        };
        let sensor = |name: &str| Sensor { name: name.into(), acceleration_m_s2: (0..3000).map(wave).collect() };
        let (event, component, input, outputs) = ("E".into(), component.into(), sensor("base"), vec![sensor("top")]);
        let mut record = Record { event, component, dt_s: 0.01, input, outputs };
        add_noise(&mut record, &Noise { rms_share: 0.02, floor_m_s2: 0.0 }, 5);
        record
    }

    #[test]
    fn noise_is_cut_and_what_came_before_is_gone_alike_in_both_components() {
        let raw = vec![record("EW", 6.0), record("NS", 6.3)];
        let processing = Processing { low_pass_hz: Some(20.0), cut_energy_share: 1e-3 };
        let got = processing.apply(raw.clone());
        let removed = raw[0].n_step() - got[0].n_step();
        assert!((500..640).contains(&removed), "{removed}");
        assert_eq!(got[0].n_step(), got[1].n_step());
        // Whole, so that the cut itself, a step from nothing, is not seen.
        let whole = Processing { cut_energy_share: 0.0, ..processing }.apply(raw.clone());
        let (f_hz, spectrum) = crate::numerics::spectrum::spectrum(&whole[0].outputs[0].acceleration_m_s2, 0.01);
        let power = |low: f64, high: f64| {
            let inside = f_hz.iter().zip(&spectrum).filter(|(f, _)| **f >= low && **f < high);
            inside.map(|(_, v)| v.norm_sqr()).sum::<f64>()
        };
        assert!(power(35.0, 45.0) < 1e-2 * power(10.0, 15.0), "{} {}", power(35.0, 45.0), power(10.0, 15.0));
        assert_eq!(Processing::default().apply(raw.clone()), raw, "no processing changes no bit");
    }

    #[test]
    fn values_out_of_range_are_refused() {
        let says = |p: Processing| p.check().unwrap_err().to_string();
        assert!(says(Processing { low_pass_hz: Some(80.0), ..Processing::default() }).contains("1…45 Hz, got 80"));
        assert!(says(Processing { cut_energy_share: -0.1, ..Processing::default() }).contains("0…0.2, got -0.1"));
        assert!(Processing::default().check().is_ok() && Processing::default().is_none());
    }
}
