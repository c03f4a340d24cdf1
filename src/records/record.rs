//! One component of one recorded event: input and output histories on a common uniform time axis.

use crate::error::{Error, Result};
use crate::numerics::resample;
use crate::units::G_M_S2;

/// Largest believable peak acceleration, m/s² (10 g).
const MAX_PEAK_M_S2: f64 = 10.0 * G_M_S2;
/// Smallest believable peak of an input worth reading, m/s² (2·10⁻⁵ g).
const MIN_PEAK_M_S2: f64 = 2e-5 * G_M_S2;

/// History of one sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Name as in the manifest.
    pub name: String,
    /// Absolute horizontal acceleration, m/s².
    pub acceleration_m_s2: Vec<f64>,
}

/// One component of one event; all histories have the same length and start at the same time.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Event name.
    pub event: String,
    /// Component name.
    pub component: String,
    /// Time step, s.
    pub dt_s: f64,
    /// The input sensor (base of the column).
    pub input: Sensor,
    /// The output sensors, in the order of the manifest.
    pub outputs: Vec<Sensor>,
}

impl Record {
    /// Number of samples.
    pub fn n_step(&self) -> usize {
        self.input.acceleration_m_s2.len()
    }

    /// Time of the last sample, s.
    pub fn duration_s(&self) -> f64 {
        self.n_step().saturating_sub(1) as f64 * self.dt_s
    }

    /// Peak absolute input acceleration, m/s².
    pub fn input_pga_m_s2(&self) -> f64 {
        peak(&self.input.acceleration_m_s2)
    }

    /// The record at another time step, band-limited to the lower of the two Nyquist frequencies.
    #[must_use]
    pub fn resampled(&self, dt_s: f64) -> Self {
        self.map(dt_s, |x| resample::resample_band_limited(x, self.dt_s, dt_s))
    }

    /// The samples from `start_s` on, `duration_s` long, or to the end if that comes first.
    #[must_use]
    pub fn window(&self, start_s: f64, duration_s: f64) -> Self {
        let n = self.n_step();
        let first = ((start_s / self.dt_s).round().max(0.0) as usize).min(n);
        let last = (first + (duration_s / self.dt_s).round().max(0.0) as usize + 1).min(n);
        self.map(self.dt_s, |x| x[first..last].to_vec())
    }

    fn map(&self, dt_s: f64, change: impl Fn(&[f64]) -> Vec<f64>) -> Self {
        let changed = |s: &Sensor| Sensor { name: s.name.clone(), acceleration_m_s2: change(&s.acceleration_m_s2) };
        Self {
            event: self.event.clone(),
            component: self.component.clone(),
            dt_s,
            input: changed(&self.input),
            outputs: self.outputs.iter().map(changed).collect(),
        }
    }

    /// Input first, then the outputs.
    pub fn sensors(&self) -> impl Iterator<Item = &Sensor> {
        std::iter::once(&self.input).chain(&self.outputs)
    }

    /// Refuses peaks that only a wrong unit explains.
    ///
    /// # Errors
    /// When a sensor peaks above 10 g or the input below 2·10⁻⁵ g.
    pub fn check_plausible(&self) -> Result<()> {
        let hint = "is `records.unit` the unit of the files (`g`, `gal` or `m/s2`)?";
        for sensor in self.sensors() {
            let peak_m_s2 = peak(&sensor.acceleration_m_s2);
            if peak_m_s2 > MAX_PEAK_M_S2 {
                return Err(Error::new(format!(
                    "sensor `{}` peaks at {:.3} g, more than the 10 g that a record can believably hold",
                    sensor.name,
                    peak_m_s2 / G_M_S2
                ))
                .hint(hint));
            }
        }
        let peak_m_s2 = self.input_pga_m_s2();
        if peak_m_s2 < MIN_PEAK_M_S2 {
            return Err(Error::new(format!(
                "input sensor `{}` peaks at {:.3e} g, less than the 2e-5 g of a usable record",
                self.input.name,
                peak_m_s2 / G_M_S2
            ))
            .hint(hint));
        }
        Ok(())
    }
}

fn peak(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m, v| m.max(v.abs()))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) fn record(n: usize, dt_s: f64, scale: f64) -> Record {
        let wave = |lag_s: f64, factor: f64| {
            (0..n).map(|i| scale * factor * (9.0 * (i as f64 * dt_s - lag_s)).sin()).collect()
        };
        let sensor = |name: &str, lag_s, factor| Sensor { name: name.into(), acceleration_m_s2: wave(lag_s, factor) };
        Record {
            event: "E1".into(),
            component: "NS".into(),
            dt_s,
            input: sensor("borehole", 0.0, 1.0),
            outputs: vec![sensor("mid", 0.1, 1.7), sensor("surface", 0.2, 3.0)],
        }
    }

    #[test]
    fn resampling_keeps_the_wave_and_the_duration() {
        let fine = record(3001, 0.005, 0.3);
        let coarse = fine.resampled(0.05);
        assert_eq!((coarse.n_step(), coarse.dt_s), (301, 0.05));
        let (exact, n) = (record(301, 0.05, 0.3), 301);
        for (a, b) in coarse.sensors().zip(exact.sensors()) {
            assert_eq!(a.name, b.name);
            for i in 40..n - 40 {
                assert!((a.acceleration_m_s2[i] - b.acceleration_m_s2[i]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn windows_are_cut_by_time_and_clipped_to_the_record() {
        let r = record(101, 0.01, 1.0);
        let w = r.window(0.2, 0.3);
        assert_eq!(w.n_step(), 31);
        assert_eq!(w.input.acceleration_m_s2[0], r.input.acceleration_m_s2[20]);
        assert_eq!(r.window(0.9, 5.0).n_step(), 11);
        assert_eq!(r.window(9.0, 5.0).n_step(), 0);
    }

    #[test]
    fn peaks_that_only_a_wrong_unit_explains_are_refused() {
        assert!(record(1000, 0.01, 1.0).check_plausible().is_ok());
        let error = record(1000, 0.01, 200.0).check_plausible().unwrap_err();
        assert!(error.to_string().contains("peaks at") && error.hint_text().unwrap().contains("records.unit"));
        assert!(record(1000, 0.01, 1e-5).check_plausible().is_err());
    }
}
