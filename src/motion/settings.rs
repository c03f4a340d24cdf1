//! Manifest section `[motions]`: how many base motions, how strong, how long, with what frequencies.

use super::cases::{MOST_CASES, parse_cases};
use crate::ranges::{Range, Ranged, range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Suite of synthetic base motions (manifest section `[motions]`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MotionSettings {
    /// Number of motions.
    pub count: usize,
    /// Seed of all random choices.
    pub seed: u64,
    /// Duration of each motion, s.
    pub duration_s: f64,
    /// Time step, s.
    pub step_s: f64,
    /// Bands of peak acceleration; their counts add up to `count`. Where there are none, three in five motions are of 0.005–0.02 g and the
    /// others of 0.02–0.2 g.
    pub bands: Vec<Band>,
    /// Cases to train on, such as `"1-80"`; the first four in five where there are neither these nor others.
    pub train: String,
    /// Cases to validate on, such as `"81-100"`; the others where there are neither.
    pub validation: String,
    /// Lower edge of the frequency content, Hz.
    pub low_hz: f64,
    /// Upper edge of the frequency content, Hz.
    pub high_hz: f64,
    /// Range of the dominant frequency, Hz, drawn log-uniformly for each motion.
    pub dominant_hz: [f64; 2],
    /// Range of the strong-motion duration as a share of `duration_s`, drawn uniformly for each motion.
    pub strong_share: [f64; 2],
}

impl Default for MotionSettings {
    fn default() -> Self {
        Self {
            count: 100,
            seed: 1,
            duration_s: 30.0,
            step_s: 0.005,
            bands: Vec::new(),
            train: String::new(),
            validation: String::new(),
            low_hz: 0.3,
            high_hz: 9.0,
            dominant_hz: [0.8, 6.0],
            strong_share: [0.15, 0.55],
        }
    }
}

/// A band of peak ground acceleration, filled by stratified draws.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Band {
    /// Number of motions in the band.
    pub count: usize,
    /// Smallest peak acceleration, g.
    pub min_pga_g: f64,
    /// Largest peak acceleration, g.
    pub max_pga_g: f64,
}

impl Ranged for MotionSettings {
    const RANGES: &'static [Range<Self>] = &[
        range!(count, "", 1.0, MOST_CASES as f64),
        range!(step_s, "s", 1e-4, 0.05),
        range!(duration_s, "s", 4.0, 600.0),
        range!(low_hz, "Hz", 0.05, 5.0),
        range!(each strong_share, "", 0.05, 0.8),
    ];
}

impl MotionSettings {
    /// The same with bands and split where none are given.
    #[must_use]
    pub fn completed(mut self) -> Self {
        if self.bands.is_empty() && self.count > 0 {
            let weak = (3 * self.count).div_ceil(5);
            self.bands = vec![Band { count: weak, min_pga_g: 0.005, max_pga_g: 0.02 }];
            if self.count > weak {
                self.bands.push(Band { count: self.count - weak, min_pga_g: 0.02, max_pga_g: 0.2 });
            }
        }
        if self.train.is_empty() && self.validation.is_empty() && self.count > 1 {
            let first = (4 * self.count / 5).max(1);
            self.train = format!("1-{first}");
            self.validation = format!("{}-{}", first + 1, self.count);
        }
        self
    }

    /// All that is wrong with the values: (dotted key, what is wrong).
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut found = self.beyond();
        let mut say = |key: &str, what: String| found.push((key.to_string(), what));
        if self.low_hz * self.duration_s < 1.0 {
            let least = 1.0 / self.duration_s;
            say(
                "low_hz",
                format!("must be at least {least:.3} Hz (one period within the motion), got {}", self.low_hz),
            );
        }
        let nyquist_share = 0.4 / self.step_s;
        if !(self.high_hz > 2.0 * self.low_hz && self.high_hz <= nyquist_share) {
            say(
                "high_hz",
                format!(
                    "`high_hz` must be in {:.3}…{nyquist_share:.1} Hz (twice `low_hz` to 0.4/`step_s`), got {}",
                    2.0 * self.low_hz,
                    self.high_hz
                ),
            );
        }
        let [first, last] = self.dominant_hz;
        if !(first >= self.low_hz && first <= last && last <= self.high_hz) {
            say(
                "dominant_hz",
                format!(
                    "`dominant_hz` must rise within `low_hz`…`high_hz` ({}…{} Hz), got [{first}, {last}]",
                    self.low_hz, self.high_hz
                ),
            );
        }
        let [first, last] = self.strong_share;
        if first > last {
            say("strong_share", format!("must not fall, got [{first}, {last}]"));
        }
        self.band_problems(&mut say);
        self.split_problems(&mut say);
        found
    }

    fn band_problems(&self, say: &mut dyn FnMut(&str, String)) {
        let total = self.bands.iter().fold(0, |sum: usize, b| sum.saturating_add(b.count));
        if total != self.count {
            say("bands", format!("the bands hold {total} motions, but `count` is {}", self.count));
        }
        for (i, band) in self.bands.iter().enumerate() {
            if !(band.min_pga_g > 0.0 && band.min_pga_g < band.max_pga_g && band.max_pga_g <= 5.0) {
                say(
                    &format!("bands[{}]", i + 1),
                    format!(
                        "a band must rise within 0…5 g, got `min_pga_g` {} and `max_pga_g` {}",
                        band.min_pga_g, band.max_pga_g
                    ),
                );
            }
        }
    }

    fn split_problems(&self, say: &mut dyn FnMut(&str, String)) {
        let mut taken = BTreeSet::new();
        for (key, text) in [("train", &self.train), ("validation", &self.validation)] {
            match parse_cases(text) {
                Err(error) => say(key, error.what().to_string()),
                Ok(cases) => {
                    for case in cases {
                        if case > self.count {
                            say(key, format!("case {case} in `{text}` is beyond `count` = {}", self.count));
                            break;
                        }
                        if !taken.insert(case) {
                            say(key, format!("case {case} is in both `train` and `validation`"));
                            break;
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_said_of_a_suite_fits_its_count() {
        for count in [2, 3, 20, 100, 101] {
            let settings = MotionSettings { count, ..MotionSettings::default() }.completed();
            assert_eq!(settings.problems(), [], "{count}");
            assert_eq!(settings.clone().completed(), settings);
        }
        let own = MotionSettings { train: "1-3".into(), ..MotionSettings::default() }.completed();
        assert!(own.train == "1-3" && own.validation.is_empty());
    }
}
