//! Replays of the nonlinear column as the point from which the fast column extrapolates.

use super::problem::Replay;
use super::responses::{Responses, Scene};
use super::spectra::SMOOTH_HZ;
use crate::error::Result;
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Bounds of the factor between the two columns.
const FACTOR: [f64; 2] = [0.33, 3.0];

/// What the nonlinear column does beyond the fast one at one set of effects.
///
/// ```text
/// V(θ) = K · V_fast(θ) + (V_FE(a) − K · V_fast(a)),   K = ⟨V_FE V_fast*⟩ / ⟨|V_fast|²⟩ at a          (1)
/// ```
///
/// exact at the anchor a; ⟨⟩ is a mean over neighbouring bins. Where the fast column is nearly silent, K would be a
/// quotient of two small numbers; the mean and the second part of (1) keep that from mattering.
pub struct Anchor {
    /// By group and record; `None` without a replay, where the fast column stands alone.
    pub records: Vec<Vec<Option<RecordAnchor>>>,
}

/// K and the second part of (1), `[bin][sensor]`.
pub struct RecordAnchor {
    /// K.
    pub factor: Vec<C64>,
    /// V_FE(a) − K · V_fast(a).
    pub rest: Vec<C64>,
}

impl Anchor {
    /// The fast column alone.
    pub fn fast(scene: &Scene<'_>) -> Self {
        Self { records: scene.groups.iter().map(|g| g.records.iter().map(|_| None).collect()).collect() }
    }

    /// Replays the events under `tables` and compares with the fast column's `responses` there.
    ///
    /// # Errors
    /// When the replay is impossible.
    pub fn replayed(
        scene: &Scene<'_>,
        replay: &dyn Replay,
        tables: &[toml::Table],
        responses: &Responses,
    ) -> Result<Self> {
        let replays = replay.replay(tables)?;
        let mut anchor = Self::fast(scene);
        for (g, group) in scene.groups.iter().enumerate() {
            for (r, record) in group.records.iter().enumerate() {
                let (Some(Some(replayed)), Some(response)) = (replays.get(record.event), responses.records[g].get(r))
                else {
                    continue;
                };
                let nonlinear: Vec<Vec<C64>> = replayed.iter().map(|x| scene.bins(g, r, x)).collect();
                anchor.records[g][r] = Some(compare(&group.frequencies_hz, &nonlinear, &response.motion));
            }
        }
        Ok(anchor)
    }
}

fn compare(frequencies_hz: &[f64], replayed: &[Vec<C64>], motion: &[C64]) -> RecordAnchor {
    let (n, count) = (frequencies_hz.len(), replayed.len());
    let step_hz = frequencies_hz[1] - frequencies_hz[0];
    let half = (SMOOTH_HZ / step_hz).round().max(1.0) as usize;
    let mut anchor =
        RecordAnchor { factor: vec![C64::new(1.0, 0.0); n * count], rest: vec![C64::default(); n * count] };
    for (s, nonlinear) in replayed.iter().enumerate() {
        let fast: Vec<C64> = (0..n).map(|k| motion[k * count + s]).collect();
        for k in 0..n {
            let range = k.saturating_sub(half)..(k + half + 1).min(n);
            let cross: C64 = range.clone().map(|m| nonlinear[m] * fast[m].conj()).sum();
            let power: f64 = range.map(|m| fast[m].norm_sqr()).sum();
            let raw = if power > 0.0 { cross / power } else { C64::new(1.0, 0.0) };
            let size = raw.norm();
            let factor = if size > 0.0 { raw * (size.clamp(FACTOR[0], FACTOR[1]) / size) } else { C64::new(1.0, 0.0) };
            anchor.factor[k * count + s] = factor;
            anchor.rest[k * count + s] = nonlinear[k] - factor * fast[k];
        }
    }
    anchor
}
