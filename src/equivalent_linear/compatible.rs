//! Strains of an equivalent-linear column that its moduli and damping are those of.

use super::column::{EquivalentColumn, Nodes, Wanted};
use super::tuning::{Tuning, least};
use crate::numerics::fixed_point::fixed_point;
use crate::numerics::grid::Grid;
use realfft::num_complex::Complex;
use std::f64::consts::{SQRT_2, TAU};

type C64 = Complex<f64>;

/// Effective strain over the largest strain.
const EFFECTIVE: f64 = 0.7;
/// Most iterations.
const ITERATIONS: usize = 40;
/// Relative change of every strain at which they end.
const STILL: f64 = 1e-4;
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
    nodes: Nodes,
    strain: Vec<f64>,
}

/// Effective strains of a column under one motion of its base.
struct Effective<'b> {
    base: &'b Base<'b>,
    displacement: Vec<C64>,
    /// Effective strain over the root of its power.
    factor: f64,
}

impl<'b> Effective<'b> {
    fn new(base: &'b Base<'b>) -> Self {
        let motion = base.frequencies_hz.iter().zip(base.acceleration_m_s2);
        let displacement = motion.map(|(f, a)| a / -(TAU * f).powi(2)).collect();
        Self { base, displacement, factor: EFFECTIVE * base.peak_factor * SQRT_2 / base.samples as f64 }
    }

    /// ln F(γ) of ln γ.
    fn of(&self, column: &EquivalentColumn, nodes: &Nodes, ln_strain: &[f64]) -> Vec<f64> {
        let march = column.march(nodes, &exp(ln_strain), Wanted::Strains, &Tuning::default());
        let norms = march.strain_norm(self.base.frequencies_hz, &self.displacement).into_iter();
        norms.map(|norm| (self.factor * norm).max(LEAST_STRAIN).ln()).collect()
    }
}

fn exp(ln: &[f64]) -> Vec<f64> {
    ln.iter().map(|x| x.exp()).collect()
}

impl Compatible {
    /// `column` under `base`: ln γ = ln F(γ), F the effective strains of the column with γ.
    ///
    /// Source: Idriss and Sun (1992), SHAKE91.
    pub fn new(column: EquivalentColumn, base: &Base<'_>) -> Self {
        Self::near(column, base, None)
    }

    /// The same, sought from the strains of `other`.
    pub fn near(column: EquivalentColumn, base: &Base<'_>, other: Option<&Self>) -> Self {
        let ends_hz = [base.frequencies_hz.first(), base.frequencies_hz.last()].map(|f| f.copied().unwrap_or(1.0));
        let nodes = Nodes::new(Grid::around(ends_hz[0], ends_hz[1], column.grid_step_hz()));
        let effective = Effective::new(base);
        let map = |ln_strain: &[f64]| effective.of(&column, &nodes, ln_strain);
        let known = other.filter(|other| other.strain.len() == column.n_element());
        let unknown = || vec![START_STRAIN.ln(); column.n_element()];
        let start = known.map_or_else(unknown, |other| other.strain.iter().map(|strain| strain.ln()).collect());
        let strain = exp(&fixed_point(start, map, ITERATIONS, STILL).0);
        Self { column, nodes, strain }
    }

    /// The same column and strains with a modulus that does not grow with frequency; see [`EquivalentColumn::without_dispersion`].
    #[must_use]
    pub fn without_dispersion(self) -> Self {
        Self { column: self.column.without_dispersion(), ..self }
    }

    /// Motions at `depths_m` under `base`, tuned, `[depth][bin]`, m/s².
    pub fn motions(&self, base: &Base<'_>, depths_m: &[f64], tuning: &Tuning) -> Vec<Vec<C64>> {
        let march = self.column.march(&self.nodes, &self.strain, Wanted::Motions { depths_m }, tuning);
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
