//! What the column itself has wrong: a share of what it adds to its base motion, a random function of frequency.

use super::algebra::{Marginal, marginal, solved};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rayon::prelude::*;

/// Narrow and wide knots to an octave.
const AN_OCTAVE: [f64; 2] = [6.0, 1.0];
/// Least levels over the declared error of the model: wide, narrow, own.
const LEAST: [f64; 3] = [1.0, 0.5, 0.5];
/// Median of the prior of a level over its least, and standard deviation of its ln.
const LEVEL: [f64; 2] = [1.5, 0.7];
/// Steps in ln when levels are searched, and when they are followed from where they were best a step of a fit before.
const STEPS: [&[f64]; 2] = [&[0.9, 0.4, 0.2, 0.1], &[0.4, 0.1]];

/// ln of the levels of a discrepancy, shares of what the column adds to its base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    /// What all events share and changes over an octave.
    pub wide: f64,
    /// What all events share and changes from knot to knot.
    pub narrow: f64,
    /// What one record has for itself, over an octave.
    pub own: f64,
}

impl Levels {
    /// The least levels of a column that is right within `model_error`, a share of what it adds to its base.
    pub fn least(model_error: f64) -> Self {
        let [wide, narrow, own] = LEAST.map(|share| (share * model_error.max(1e-4)).ln());
        Self { wide, narrow, own }
    }

    fn each(self, other: Self, of: impl Fn(f64, f64) -> f64) -> Self {
        Self { wide: of(self.wide, other.wide), narrow: of(self.narrow, other.narrow), own: of(self.own, other.own) }
    }

    /// The medians of the prior above the least levels `self`.
    pub fn usual(self) -> Self {
        self.each(self, |least, _| least + LEVEL[0].ln())
    }

    /// No more than `usual`.
    pub fn sharpened(self, usual: Self) -> Self {
        self.each(usual, f64::min)
    }

    /// −ln of the prior density about the medians `usual`, constants apart.
    pub fn cost(self, usual: Self) -> f64 {
        let square = self.each(usual, |level, usual| 0.5 * ((level - usual) / LEVEL[1]).powi(2));
        square.wide + square.narrow + square.own
    }

    fn part(&mut self, index: usize) -> &mut f64 {
        match index {
            0 => &mut self.wide,
            1 => &mut self.narrow,
            _ => &mut self.own,
        }
    }
}

/// The discrepancy as coefficients at narrow knots, real and imaginary parts, sensor by sensor; then one for each convention: what
/// the column would do if it were computed in another way that the field holds to be as good, N(0, 1).
///
/// ```text
/// δ_s(f) = Σ_k φ_k(f) (a + t_e W γ + b_e)_sk,   a = W α + ν,   b_e = W β_e           (1)
/// α ~ N(0, σ_w²),  ν ~ N(0, σ_n²),  γ, β_e ~ N(0, σ_o²)                             (2)
/// ```
///
/// φ are hats over ln f and W takes knots an octave apart to them, half of its variance common to all sensors: what is wrong below
/// a sensor is wrong above it too. a is the same in all records, of both components; t_e is the strength of the motion
/// ([`strengths`]): what a law of soil has wrong grows or shrinks with strain; b_e is that of one record.
///
/// Source: Kennedy and O'Hagan (2001), doi 10.1111/1467-9868.00294.
pub struct Discrepancy {
    band_hz: [f64; 2],
    n_sensor: usize,
    n_knot: usize,
    n_convention: usize,
    least: Levels,
    /// W of (1), of both parts.
    wide: Mat<f64>,
}

/// Normal equations of one record: coefficients of the discrepancy first, then whatever else, the right-hand side last.
pub struct Normal {
    /// All of it.
    pub g: Mat<f64>,
    /// −ln of the likelihood where nothing is moved.
    pub nll: f64,
    /// Strength t of (1) of [`Discrepancy`].
    strength: f64,
    /// Wᵀ G, and Wᵀ G W.
    cross: Mat<f64>,
    inner: Mat<f64>,
}

/// Normal equations of all records without what each has for itself.
pub struct Shared {
    /// All of it; coefficients a, then γ of [`Discrepancy`] first.
    pub g: Mat<f64>,
    /// −ln of the likelihood where neither what is shared nor anything else is moved.
    pub nll: f64,
}

/// Posterior mean of the coefficients of a discrepancy.
pub struct Mean {
    /// What all records share at the mean strength.
    pub shared: Vec<f64>,
    /// What repeats in motions as strong as each record.
    pub repeatable: Vec<Vec<f64>>,
    /// All of each record.
    pub whole: Vec<Vec<f64>>,
}

/// Strengths of motions in standard deviations of the ln of their peaks from the mean of these; zero where all are alike.
pub fn strengths(peaks_m_s2: &[f64]) -> Vec<f64> {
    let ln: Vec<f64> = peaks_m_s2.iter().map(|p| p.max(f64::MIN_POSITIVE).ln()).collect();
    let n = ln.len().max(1) as f64;
    let mean = ln.iter().sum::<f64>() / n;
    let deviation = (ln.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    ln.iter().map(|x| if deviation > 1e-6 { (x - mean) / deviation } else { 0.0 }).collect()
}

/// Hat functions over ln f with `n` knots: the knot below and the share of the one above.
pub fn hat(frequency_hz: f64, [low, high]: [f64; 2], n: usize) -> (usize, f64) {
    if n < 2 {
        return (0, 0.0);
    }
    let x = (frequency_hz / low).ln() / (high / low).ln() * (n - 1) as f64;
    let x = x.clamp(0.0, (n - 1) as f64);
    let i = (x.floor() as usize).min(n - 2);
    (i, x - i as f64)
}

impl Discrepancy {
    /// That of `n_sensor` output sensors in a band, of `n_convention` other ways in which a column may be computed, and of levels of
    /// no less than `least`.
    pub fn new(band_hz: [f64; 2], n_sensor: usize, n_convention: usize, least: Levels) -> Self {
        let octaves = (band_hz[1] / band_hz[0]).log2();
        let [n_knot, n_wide] = AN_OCTAVE.map(|k| (k * octaves).ceil() as usize + 1);
        let mut wide = Mat::zeros(2 * n_sensor * n_knot + n_convention, 2 * (n_sensor + 1) * n_wide);
        for s in 0..n_sensor {
            for k in 0..n_knot {
                let at_hz = band_hz[0] * (band_hz[1] / band_hz[0]).powf(k as f64 / (n_knot - 1) as f64);
                let (i, w) = hat(at_hz, band_hz, n_wide);
                let norm = (2.0 * (w * w + (1.0 - w) * (1.0 - w))).sqrt();
                for (j, w) in [(i, 1.0 - w), ((i + 1).min(n_wide - 1), w)] {
                    for group in [0, s + 1] {
                        for part in 0..2 {
                            wide[(2 * (s * n_knot + k) + part, 2 * (group * n_wide + j) + part)] += w / norm;
                        }
                    }
                }
            }
        }
        Self { band_hz, n_sensor, n_knot, n_convention, least, wide }
    }

    /// Levels at the medians of their prior.
    pub fn usual(&self) -> Levels {
        self.least.usual()
    }

    /// −ln of the prior density of `levels`.
    pub fn cost(&self, levels: Levels) -> f64 {
        levels.cost(self.usual())
    }

    /// Number of coefficients.
    pub fn len(&self) -> usize {
        2 * self.n_sensor * self.n_knot + self.n_convention
    }

    /// The knot below a frequency and the share of the one above.
    pub fn knot(&self, frequency_hz: f64) -> (usize, f64) {
        hat(frequency_hz, self.band_hz, self.n_knot)
    }

    /// First of the two coefficients of sensor `s` at knot `k`.
    pub fn index(&self, s: usize, k: usize) -> usize {
        2 * (s * self.n_knot + k.min(self.n_knot - 1))
    }

    /// Knots of sensor `s`: frequency in Hz, real and imaginary part.
    pub fn at_knots(&self, s: usize, coefficients: &[f64]) -> Vec<[f64; 3]> {
        let [low, high] = self.band_hz;
        let of = |k: usize| {
            let i = self.index(s, k);
            let at_hz = low * (high / low).powf(k as f64 / (self.n_knot - 1) as f64);
            [at_hz, coefficients[i], coefficients[i + 1]]
        };
        (0..self.n_knot).map(of).collect()
    }

    /// Normal equations `g` of a record of this strength, prepared.
    pub fn normal(&self, g: Mat<f64>, nll: f64, strength: f64) -> Normal {
        let cross = self.wide.transpose() * g.subrows(0, self.len());
        let inner = cross.subcols(0, self.len()) * &self.wide;
        Normal { g, nll, strength, cross, inner }
    }

    /// A record without what it has for itself.
    pub fn without_own(&self, normal: &Normal, levels: Levels) -> Option<Shared> {
        let (level, last) = (levels.own.exp(), normal.g.nrows() - 1);
        let scaled = faer::Scale(level) * &normal.cross;
        let Marginal { left, ln_determinant } =
            marginal(&normal.g, &scaled, &(faer::Scale(level * level) * &normal.inner))?;
        let gain = normal.g[(last, last)] - left[(last, last)];
        Some(Shared {
            nll: normal.nll + 0.5 * ln_determinant - 0.5 * gain,
            g: self.with_strength(&left, normal.strength),
        })
    }

    /// Normal equations of a record in a and γ of (1): its coefficients are a + t W γ.
    fn with_strength(&self, g: &Mat<f64>, strength: f64) -> Mat<f64> {
        let (m, w, n) = (self.len(), self.wide.ncols(), g.nrows());
        let cross = faer::Scale(strength) * (self.wide.transpose() * g.subrows(0, m));
        let inner = faer::Scale(strength) * (cross.subcols(0, m) * &self.wide);
        let source = |i: usize| if i < m { i } else { i - w };
        Mat::from_fn(n + w, n + w, |i, j| match ((m..m + w).contains(&i), (m..m + w).contains(&j)) {
            (false, false) => g[(source(i), source(j))],
            (true, false) => cross[(i - m, source(j))],
            (false, true) => cross[(j - m, source(i))],
            (true, true) => inner[(i - m, j - m)],
        })
    }

    /// Number of coefficients that all records share: a and γ.
    fn len_shared(&self) -> usize {
        self.len() + self.wide.ncols()
    }

    /// Normal equations of whatever is beside the discrepancy, all of that marginalised, and −ln of the likelihood.
    pub fn without_shared(&self, shared: &Shared, levels: Levels) -> Option<Shared> {
        let (m, n) = (self.len_shared(), shared.g.nrows());
        let l = self.root(levels)?;
        let cross = l.transpose() * shared.g.submatrix(0, m, m, n - m);
        let inner = l.transpose() * shared.g.submatrix(0, 0, m, m) * &l;
        let kept = shared.g.submatrix(m, m, n - m, n - m).to_owned();
        let Marginal { left, ln_determinant } = marginal(&kept, &cross, &inner)?;
        let gain = kept[(n - m - 1, n - m - 1)] - left[(n - m - 1, n - m - 1)];
        Some(Shared { nll: shared.nll + 0.5 * ln_determinant - 0.5 * gain, g: left })
    }

    /// L of the prior covariance L Lᵀ of what all records share.
    fn root(&self, levels: Levels) -> Option<Mat<f64>> {
        let [wide, narrow] = [levels.wide, levels.narrow].map(|l| (2.0 * l).exp());
        let mut k = faer::Scale(wide) * (&self.wide * self.wide.transpose());
        let (m, n_hat) = (self.len(), self.len() - self.n_convention);
        (0..m).for_each(|i| k[(i, i)] += if i < n_hat { narrow } else { 1.0 });
        let factor = k.llt(Side::Lower).ok()?;
        let own = levels.own.exp();
        let n = self.len_shared();
        Some(Mat::from_fn(n, n, |i, j| match (i < m, j < m) {
            (true, true) if j <= i => factor.L()[(i, j)],
            (false, false) if i == j => own,
            _ => 0.0,
        }))
    }

    /// Posterior mean of the coefficients.
    pub fn mean(&self, normals: &[Normal], levels: Levels) -> Option<Mean> {
        let (m, n) = (self.len(), self.len_shared());
        let shared = self.summed(normals, levels)?.g;
        let last = shared.nrows() - 1;
        let l = self.root(levels)?;
        let mut inner = l.transpose() * shared.submatrix(0, 0, n, n) * &l;
        (0..n).for_each(|i| inner[(i, i)] += 1.0);
        let side: Vec<f64> = (0..n).map(|i| (i..n).map(|j| l[(j, i)] * shared[(j, last)]).sum()).collect();
        let z = solved(&inner, &side)?;
        let all: Vec<f64> = (0..n).map(|i| (0..=i).map(|j| l[(i, j)] * z[j]).sum()).collect();
        let (a, trend) = all.split_at(m);
        let widened = |i: usize, x: &[f64]| x.iter().enumerate().map(|(j, x)| self.wide[(i, j)] * x).sum::<f64>();
        let repeatable: Vec<Vec<f64>> =
            normals.iter().map(|r| (0..m).map(|i| a[i] + r.strength * widened(i, trend)).collect()).collect();
        let level = levels.own.exp();
        let of = |(normal, a): (&Normal, &Vec<f64>)| -> Option<Vec<f64>> {
            let (n_wide, last) = (self.wide.ncols(), normal.g.nrows() - 1);
            let rest = |i: usize| normal.cross[(i, last)] - (0..m).map(|j| normal.cross[(i, j)] * a[j]).sum::<f64>();
            let side: Vec<f64> = (0..n_wide).map(|i| level * rest(i)).collect();
            let mut inner = faer::Scale(level * level) * &normal.inner;
            (0..n_wide).for_each(|i| inner[(i, i)] += 1.0);
            let own: Vec<f64> = solved(&inner, &side)?.into_iter().map(|z| level * z).collect();
            Some((0..m).map(|i| a[i] + widened(i, &own)).collect())
        };
        let whole = normals.iter().zip(&repeatable).map(of).collect::<Option<_>>()?;
        Some(Mean { shared: a.to_vec(), repeatable, whole })
    }

    /// Score of each event in what is beside the discrepancy, that of the discrepancy eliminated; `shared` are records without what each
    /// has for itself, `groups` their events.
    ///
    /// ```text
    /// u_e = r_e,x − G_e,xd a − B (r_e,d − G_e,dd a),   B = G_xd (G_dd + K⁻¹)⁻¹                 (1)
    /// ```
    ///
    /// a is the posterior mean of what all records share, K its prior covariance; Σ_e u_e and what the prior of a pulls, B K⁻¹ a, are the
    /// slope of the marginal likelihood.
    pub fn scores(&self, shared: &[Shared], groups: &[usize], levels: Levels) -> Option<Vec<Vec<f64>>> {
        let (m, n) = (self.len_shared(), shared.first()?.g.nrows());
        let mut sum = Mat::<f64>::zeros(n, n);
        shared.iter().for_each(|s| sum += &s.g);
        let l = self.root(levels)?;
        let mut inner = l.transpose() * sum.submatrix(0, 0, m, m) * &l;
        (0..m).for_each(|i| inner[(i, i)] += 1.0);
        let cross = l.transpose() * sum.submatrix(0, m, m, n - m);
        // Columns of (G_dd + K⁻¹)⁻¹ G_dx, and in the last one a.
        let solved = &l * inner.llt(Side::Lower).ok()?.solve(&cross);
        let n_x = n - m - 1;
        let count = groups.iter().max()? + 1;
        let mut scores = vec![vec![0.0; n_x]; count];
        for (record, group) in shared.iter().zip(groups) {
            let g = &record.g;
            let left = |i: usize| g[(i, n - 1)] - (0..m).map(|j| g[(i, j)] * solved[(j, n_x)]).sum::<f64>();
            let own: Vec<f64> = (0..m).map(left).collect();
            for (x, score) in scores[*group].iter_mut().enumerate() {
                *score += left(m + x) - own.iter().enumerate().map(|(d, r)| solved[(d, x)] * r).sum::<f64>();
            }
        }
        Some(scores)
    }

    /// The most probable levels, from `levels` on, which may be known to be near; `normals` have nothing beside the discrepancy.
    pub fn tuned(&self, normals: &[Normal], mut levels: Levels, is_near: bool) -> Levels {
        let mut shared = self.summed(normals, levels);
        let cost = |shared: &Option<Shared>, levels: Levels| {
            let left = shared.as_ref().and_then(|s| self.without_shared(s, levels));
            left.map_or(f64::INFINITY, |l| l.nll + self.cost(levels))
        };
        let mut best = cost(&shared, levels);
        for step in STEPS[usize::from(is_near)] {
            for index in [2, 0, 1] {
                for sign in [1.0, -1.0] {
                    let mut is_moved = false;
                    loop {
                        let mut other = levels;
                        *other.part(index) += sign * step;
                        if *other.part(index) < *{ self.least }.part(index) {
                            break;
                        }
                        let beside = if index == 2 { Some(self.summed(normals, other)) } else { None };
                        let found = cost(beside.as_ref().unwrap_or(&shared), other);
                        if found >= best - 1e-3 {
                            break;
                        }
                        (best, levels, is_moved) = (found, other, true);
                        shared = beside.unwrap_or(shared);
                    }
                    if is_moved {
                        break;
                    }
                }
            }
        }
        levels
    }

    /// All records without what each has for itself.
    pub fn summed(&self, normals: &[Normal], levels: Levels) -> Option<Shared> {
        let parts: Vec<Shared> = normals.par_iter().map(|n| self.without_own(n, levels)).collect::<Option<_>>()?;
        // In order, so that sums have the same bits on any number of threads.
        parts.into_iter().reduce(|a, b| Shared { g: a.g + b.g, nll: a.nll + b.nll })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRENGTHS: [f64; 4] = [-1.0, 0.3, 0.0, 1.4];

    fn levels() -> Levels {
        Levels { wide: 0.3f64.ln(), narrow: 0.2f64.ln(), own: 0.4f64.ln() }
    }

    /// Records of two sensors, one convention and two coordinates, with the rows they are made of.
    fn records(discrepancy: &Discrepancy) -> Vec<Normal> {
        let n = discrepancy.len() + 3;
        let rows =
            |r: usize| Mat::from_fn(40, n, move |i, j| (((r + 1) * 7 * i + (3 + r) * j * j + i * j) as f64).sin());
        (0..4).map(|r| discrepancy.normal(rows(r).transpose() * rows(r), 0.0, STRENGTHS[r])).collect()
    }

    #[test]
    fn marginalising_in_two_steps_is_conditioning_on_the_whole_covariance() {
        let discrepancy = Discrepancy::new([1.0, 4.0], 2, 1, Levels::least(0.01));
        let normals = records(&discrepancy);
        let m = discrepancy.len();
        // All coefficients at once: those that are shared, then those of each record.
        let root = discrepancy.root(levels()).unwrap();
        let shared = &root * root.transpose();
        let own = faer::Scale((2.0 * levels().own).exp()) * (&discrepancy.wide * discrepancy.wide.transpose());
        // What goes with strength goes together in all records.
        let prior = Mat::from_fn(5 * m, 5 * m, |i, j| match (i / m, j / m) {
            (0, 0) => shared[(i, j)],
            (0, _) | (_, 0) => 0.0,
            (a, b) => own[(i % m, j % m)] * (STRENGTHS[a - 1] * STRENGTHS[b - 1] + f64::from(u8::from(a == b))),
        });
        let mut whole = Mat::<f64>::zeros(5 * m, 5 * m);
        let mut cross = Mat::<f64>::zeros(5 * m, 3);
        let mut kept = Mat::<f64>::zeros(3, 3);
        for (r, normal) in normals.iter().enumerate() {
            for i in 0..m {
                for j in 0..m {
                    for (a, b) in [(0, 0), (0, r + 1), (r + 1, 0), (r + 1, r + 1)] {
                        whole[(a * m + i, b * m + j)] += normal.g[(i, j)];
                    }
                }
                for j in 0..3 {
                    cross[(i, j)] += normal.g[(i, m + j)];
                    cross[((r + 1) * m + i, j)] += normal.g[(i, m + j)];
                }
            }
            kept += normal.g.submatrix(m, m, 3, 3);
        }
        // G' = G_xx − G_xd K (I + G_dd K)⁻¹ G_dx.
        let inner = Mat::<f64>::identity(5 * m, 5 * m) + &whole * &prior;
        let expected = &kept - cross.transpose() * &prior * inner.partial_piv_lu().solve(&cross);
        let sum = discrepancy.summed(&normals, levels()).unwrap();
        let found = discrepancy.without_shared(&sum, levels()).unwrap();
        let size = expected.norm_max();
        assert!((found.g - &expected).norm_max() < 1e-8 * size);
        assert!((found.nll - 0.5 * inner.determinant().ln() + 0.5 * (kept[(2, 2)] - expected[(2, 2)])).abs() < 1e-6);
    }

    #[test]
    fn scores_of_events_add_up_to_the_slope_of_the_marginal_likelihood() {
        let discrepancy = Discrepancy::new([1.0, 4.0], 2, 1, Levels::least(0.01));
        let normals = records(&discrepancy);
        let parts: Vec<Shared> = normals.iter().map(|n| discrepancy.without_own(n, levels()).unwrap()).collect();
        let scores = discrepancy.scores(&parts, &[0, 0, 1, 2], levels()).unwrap();
        let sum = discrepancy.summed(&normals, levels()).unwrap();
        let slope = discrepancy.without_shared(&sum, levels()).unwrap().g;
        assert_eq!(scores.len(), 3);
        // B K⁻¹ a by dense inverses.
        let m = discrepancy.len_shared();
        let root = discrepancy.root(levels()).unwrap();
        let inverse = super::super::algebra::inverse(&(&root * root.transpose())).unwrap();
        let whole = sum.g.submatrix(0, 0, m, m) + &inverse;
        let solved = super::super::algebra::inverse(&whole).unwrap() * sum.g.submatrix(0, m, m, 3);
        let pull = solved.transpose() * &inverse * &solved;
        for i in 0..2 {
            let total: f64 = scores.iter().map(|u| u[i]).sum();
            assert!((total + pull[(i, 2)] - slope[(i, 2)]).abs() < 1e-7 * slope.norm_max(), "{i}");
        }
    }

    #[test]
    fn levels_of_a_drawn_discrepancy_are_found() {
        let discrepancy = Discrepancy::new([0.5, 16.0], 2, 0, Levels::least(0.01));
        let m = discrepancy.len();
        let truth = Levels { wide: 0.1f64.ln(), narrow: 0.02f64.ln(), own: 0.05f64.ln() };
        let mut stream = crate::numerics::random::stream(1, "discrepancy");
        let mut draw = || -> f64 { rand_distr::Distribution::sample(&rand_distr::StandardNormal, &mut stream) };
        let root = discrepancy.root(truth).unwrap();
        let z: Vec<f64> = (0..m).map(|_| draw()).collect();
        let shared: Vec<f64> = (0..m).map(|i| (0..m).map(|j| root[(i, j)] * z[j]).sum()).collect();
        // Each coefficient of 40 records is seen with a deviation of 0.01.
        let precision = 1e4;
        let normals: Vec<Normal> = (0..40)
            .map(|_| {
                let z: Vec<f64> = (0..discrepancy.wide.ncols()).map(|_| truth.own.exp() * draw()).collect();
                let own = |i: usize| (0..z.len()).map(|j| discrepancy.wide[(i, j)] * z[j]).sum::<f64>();
                let seen: Vec<f64> = (0..m).map(|i| shared[i] + own(i) + 0.01 * draw()).collect();
                let g = Mat::from_fn(m + 1, m + 1, |i, j| match (i == m, j == m) {
                    (true, true) => precision * seen.iter().map(|s| s * s).sum::<f64>(),
                    (true, false) => precision * seen[j],
                    (false, true) => precision * seen[i],
                    _ => precision * f64::from(u8::from(i == j)),
                });
                discrepancy.normal(g, 0.0, 0.0)
            })
            .collect();
        let found = discrepancy.tuned(&normals, discrepancy.usual(), false);
        for (found, truth) in [(found.wide, truth.wide), (found.narrow, truth.narrow), (found.own, truth.own)] {
            assert!((found - truth).abs() < 0.4, "{} {}", found.exp(), truth.exp());
        }
        let mean = discrepancy.mean(&normals, found).unwrap().shared;
        let error: f64 = mean.iter().zip(&shared).map(|(a, b)| (a - b).powi(2)).sum();
        assert!(error < 0.1 * shared.iter().map(|s| s * s).sum::<f64>());
    }
}
