//! Strains of an equivalent-linear column that its moduli and damping are those of.

use super::column::{EquivalentColumn, Wanted};
use super::tuning::{Tuning, least};
use crate::numerics::fixed_point::fixed_point;
use crate::numerics::grid::Grid;
use realfft::num_complex::Complex;
use std::f64::consts::{SQRT_2, TAU};

type C64 = Complex<f64>;

/// Effective strain over the largest strain.
const EFFECTIVE: f64 = 0.7;
/// Most iterations, and the relative change of every strain at which they end.
const ITERATIONS: (usize, f64) = (40, 1e-4);
/// Strain with which they start.
const START_STRAIN: f64 = 1e-5;
/// Least effective strain.
const LEAST_STRAIN: f64 = 1e-9;

/// What shakes the base of a column.
#[derive(Debug, Clone, Copy)]
pub struct Base<'m> {
    /// Frequencies of the bins, Hz, rising.
    pub frequencies_hz: &'m [f64],
    /// Acceleration by bin, as a transform that is not divided by the number of samples leaves it, m/s².
    pub acceleration_m_s2: &'m [C64],
    /// Number of samples behind the bins.
    pub samples: usize,
    /// Largest over RMS value of the velocity.
    pub peak_factor: f64,
}

/// A column with strains compatible with its moduli and damping under one motion of its base.
#[derive(Debug, Clone)]
pub struct Compatible {
    column: EquivalentColumn,
    grid: Grid,
    strain: Vec<f64>,
}

impl Compatible {
    /// `column` under `base`: ln γ = ln F(γ), F the effective strains of the column with γ.
    ///
    /// Source: Idriss and Sun (1992), SHAKE91.
    pub fn new(column: EquivalentColumn, base: &Base<'_>) -> Self {
        let strain = vec![START_STRAIN; column.n_element()];
        Self::from(column, base, strain)
    }

    /// [`Compatible::new`] with the strains of a column `near` by to start from, if that has as many elements.
    pub fn beside(column: EquivalentColumn, base: &Base<'_>, near: &Self) -> Self {
        if near.strain.len() == column.n_element() {
            Self::from(column, base, near.strain.clone())
        } else {
            Self::new(column, base)
        }
    }

    fn from(column: EquivalentColumn, base: &Base<'_>, strain: Vec<f64>) -> Self {
        let f = base.frequencies_hz;
        let ends_hz = [f.first(), f.last()].map(|f| f.copied().unwrap_or(1.0));
        let grid = Grid::around(ends_hz[0], ends_hz[1], column.grid_step_hz());
        let displacement: Vec<C64> =
            f.iter().zip(base.acceleration_m_s2).map(|(f, a)| a / -(TAU * f).powi(2)).collect();
        let to_effective = EFFECTIVE * base.peak_factor * SQRT_2 / base.samples as f64;
        let exp = |ln: &[f64]| ln.iter().map(|x| x.exp()).collect::<Vec<f64>>();
        let effective = |ln_strain: &[f64]| {
            let march = column.march(grid, &exp(ln_strain), Wanted::Strains, &Tuning::default());
            let norms = march.strain_norm(f, &displacement).into_iter();
            norms.map(|norm| (to_effective * norm).max(LEAST_STRAIN).ln()).collect()
        };
        let (iterations, still) = ITERATIONS;
        let start = strain.iter().map(|gamma| gamma.ln()).collect();
        let strain = exp(&fixed_point(start, effective, iterations, still).0);
        Self { column, grid, strain }
    }

    /// The same column and strains with a modulus that does not grow with frequency; see [`EquivalentColumn::without_dispersion`].
    #[must_use]
    pub fn without_dispersion(self) -> Self {
        Self { column: self.column.without_dispersion(), ..self }
    }

    /// Motions at `depths_m` under `base`, tuned, `[depth][bin]`, m/s².
    pub fn motions(&self, base: &Base<'_>, depths_m: &[f64], tuning: &Tuning) -> Vec<Vec<C64>> {
        let march = self.column.march(self.grid, &self.strain, Wanted::Motions { depths_m }, tuning);
        let mut all = vec![Vec::with_capacity(base.frequencies_hz.len()); depths_m.len()];
        let mut at = vec![C64::default(); depths_m.len()];
        for (f, input) in base.frequencies_hz.iter().zip(base.acceleration_m_s2) {
            march.response(*f, &mut at);
            all.iter_mut().zip(&at).for_each(|(bins, h)| bins.push(h * input));
        }
        all
    }

    /// The tuning with which its motions at `depths_m` are closest to `wanted`, `[depth][bin]`; see [`Tuning`].
    pub fn tuned(&self, base: &Base<'_>, depths_m: &[f64], wanted: &[Vec<C64>]) -> Tuning {
        let scale = |w: &Vec<C64>| 1.0 / w.iter().map(C64::norm_sqr).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        let scales: Vec<f64> = wanted.iter().map(scale).collect();
        Tuning(least(|p| {
            let motions = self.motions(base, depths_m, &Tuning(p));
            let rows = motions.iter().zip(wanted).zip(&scales);
            let missed = rows.flat_map(|((m, w), s)| m.iter().zip(w).map(move |(m, w)| (m - w) * *s));
            missed.flat_map(|c| [c.re, c.im]).collect()
        }))
    }
}
