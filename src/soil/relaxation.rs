//! Small-strain damping as a few relaxing springs: their weights, and the complex modulus that follows.

use crate::numerics::nnls::nonnegative;
use std::f64::consts::TAU;
use std::sync::OnceLock;

/// Small-strain damping that a law asks for beside its hysteresis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Damping {
    /// Rayleigh damping with this ratio at the fundamental frequency of the column and at five times that.
    Rayleigh {
        /// Damping ratio there.
        ratio: f64,
    },
    /// Memory of the law's stress, [`Viscoelastic`](super::Viscoelastic): ξ(f) = ξ₀ (f/f_r)ⁿ.
    Memory {
        /// Damping ratio ξ₀ at [`REFERENCE_HZ`].
        ratio: f64,
        /// Exponent n; 0 is damping that does not depend on frequency.
        exponent: f64,
    },
}

impl Damping {
    /// The relaxation that it needs, if any.
    pub fn relaxation(&self) -> Option<Relaxation> {
        match *self {
            Self::Memory { ratio, exponent } if ratio > 0.0 => Some(Relaxation::new(ratio, exponent)),
            _ => None,
        }
    }
}

/// The relaxations of points with this damping; neighbours with the same one share the fit.
pub fn relaxations(damping: &[Damping]) -> Vec<Option<Relaxation>> {
    let mut found: Vec<Option<Relaxation>> = Vec::with_capacity(damping.len());
    for (i, damping_here) in damping.iter().enumerate() {
        let above = i.checked_sub(1).filter(|above| damping[*above] == *damping_here);
        found.push(above.map_or_else(|| damping_here.relaxation(), |above| found[above]));
    }
    found
}

/// Springs that relax.
pub const N_BODY: usize = 8;
/// Frequency at which a declared shear-wave velocity holds, Hz: the geometric middle of 0.5…20 Hz, in which profiles are
/// used, so that a column and a frequency-domain program without dispersion differ least.
pub const REFERENCE_HZ: f64 = 3.0;
/// Frequencies of the fastest and the slowest spring, Hz.
const BODIES_HZ: [f64; 2] = [0.04, 80.0];
/// Frequencies between which damping is fitted, Hz.
const BAND_HZ: [f64; 2] = [0.1, 27.0];
/// Frequencies of the fit.
const N_FIT: usize = 48;
/// Largest and smallest damping ratio that a power of the frequency is followed to.
const RATIOS: [f64; 2] = [1e-5, 0.6];

/// A modulus with generalised Maxwell bodies in parallel, over its real part at [`REFERENCE_HZ`].
///
/// ```text
/// K(f) = g + Σ a_j (i f/f_j) / (1 + i f/f_j),   Re K(f_r) = 1                                (1)
/// Im K(f) = 2 ξ₀ (f/f_r)ⁿ Re K(f)   for 0.1…27 Hz, by least squares with a_j ≥ 0              (2)
/// ```
///
/// | symbol | what                       | value               |
/// |--------|----------------------------|---------------------|
/// | f_j    | relaxation frequencies     | 8, 0.04…80 Hz, equidistant in ln f |
/// | f_r    | [`REFERENCE_HZ`]           | 3 Hz                |
///
/// (2) divided by its right side is linear in a_j/g. A causal modulus with damping has **dispersion**: its velocity grows by
/// 2ξ/π for every e-fold of frequency (4.2 % from 3 to 27 Hz at ξ = 0.03), as that of soil does, while frequency-domain
/// programs hold G(1 + 2iξ) at all frequencies. Neither is an error of the other; see [`Viscoelastic`](super::Viscoelastic)
/// for the difference in numbers.
///
/// Limits: damping fades below 0.04 Hz and above 80 Hz; powers of the frequency are followed for |n| ≤ 0.6 only.
/// Check: the tests below; `tests/verification/viscoelastic.rs`.
/// Source: Emmerich & Korn (1987), doi 10.1190/1.1442386, for (1) and the linear form of (2); Liu & Archuleta (2006),
/// doi 10.1785/0120050173; Day & Minster (1984), doi 10.1111/j.1365-246X.1984.tb05040.x; Lawson & Hanson (1974).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relaxation {
    /// What does not relax, g of (1).
    pub rest: f64,
    /// Weights a_j of the springs.
    pub weights: [f64; N_BODY],
}

impl Relaxation {
    /// The relaxation for damping ξ₀ (f/f_r)ⁿ.
    pub fn new(ratio: f64, exponent: f64) -> Self {
        let (normal, rhs) = if exponent == 0.0 { sums().at(ratio) } else { power_sums(ratio, exponent) };
        let weights = nonnegative(&normal, &rhs);
        let at_reference = 1.0 + weights.iter().zip(bodies(REFERENCE_HZ)).map(|(w, [re, _])| w * re).sum::<f64>();
        Self { rest: 1.0 / at_reference, weights: weights.map(|w| w / at_reference) }
    }

    /// K of (1) at `frequency_hz`: real and imaginary part.
    pub fn modulus(&self, frequency_hz: f64) -> [f64; 2] {
        self.modulus_by(&bodies(frequency_hz))
    }

    /// The same from the `springs` at a frequency.
    pub fn modulus_by(&self, springs: &[[f64; 2]; N_BODY]) -> [f64; 2] {
        let sum = |[re, im]: [f64; 2], (w, b): (&f64, &[f64; 2])| [re + w * b[0], im + w * b[1]];
        self.weights.iter().zip(springs).fold([self.rest, 0.0], sum)
    }
}

/// (i f/f_j) / (1 + i f/f_j) of each spring, real and imaginary part.
pub fn bodies(frequency_hz: f64) -> [[f64; 2]; N_BODY] {
    times_s().map(|time_s| {
        let x = TAU * frequency_hz * time_s;
        let scale = 1.0 / (1.0 + x * x);
        [x * x * scale, x * scale]
    })
}

/// Relaxation times of the springs, s.
pub(super) fn times_s() -> &'static [f64; N_BODY] {
    static TIMES: OnceLock<[f64; N_BODY]> = OnceLock::new();
    let [low, high] = BODIES_HZ;
    let time_s = |j: usize| 1.0 / (TAU * low * (high / low).powf(j as f64 / (N_BODY - 1) as f64));
    TIMES.get_or_init(|| std::array::from_fn(time_s))
}

/// Frequencies of the fit and the springs there.
fn fit_rows() -> &'static [(f64, [[f64; 2]; N_BODY])] {
    static ROWS: OnceLock<Vec<(f64, [[f64; 2]; N_BODY])>> = OnceLock::new();
    ROWS.get_or_init(|| {
        let [low, high] = BAND_HZ;
        let frequency = |k: usize| low * (high / low).powf(k as f64 / (N_FIT - 1) as f64);
        (0..N_FIT).map(frequency).map(|f| (f, bodies(f))).collect()
    })
}

/// Normal equations of (2), and their right side.
type Normal = ([[f64; N_BODY]; N_BODY], [f64; N_BODY]);

/// 1/(2ξ) of a target that is within what is followed.
fn scale(ratio: f64) -> f64 {
    0.5 / ratio.clamp(RATIOS[0], RATIOS[1])
}

/// The normal equations where the target is a power of the frequency.
fn power_sums(ratio: f64, exponent: f64) -> Normal {
    let mut normal = [[0.0; N_BODY]; N_BODY];
    let mut rhs = [0.0; N_BODY];
    for (frequency_hz, bodies) in fit_rows() {
        let scale = scale(ratio * (frequency_hz / REFERENCE_HZ).powf(exponent));
        let row = bodies.map(|[re, im]| scale * im - re);
        for i in 0..N_BODY {
            rhs[i] += row[i];
            for j in 0..=i {
                normal[i][j] += row[i] * row[j];
            }
        }
    }
    (normal, rhs)
}

/// Sums over the fit of products of the springs' parts, of which the normal equations of a constant target are made: a
/// column has as many targets as elements.
struct Sums {
    im_im: [[f64; N_BODY]; N_BODY],
    /// Of the imaginary part of one and the real part of the other, both ways.
    cross: [[f64; N_BODY]; N_BODY],
    re_re: [[f64; N_BODY]; N_BODY],
    im: [f64; N_BODY],
    re: [f64; N_BODY],
}

impl Sums {
    fn at(&self, ratio: f64) -> Normal {
        let s = scale(ratio);
        let normal = |i: usize, j: usize| s * (s * self.im_im[i][j] - self.cross[i][j]) + self.re_re[i][j];
        let normal = std::array::from_fn(|i| std::array::from_fn(|j| normal(i, j)));
        (normal, std::array::from_fn(|i| s * self.im[i] - self.re[i]))
    }
}

fn sums() -> &'static Sums {
    static SUMS: OnceLock<Sums> = OnceLock::new();
    SUMS.get_or_init(|| {
        let sum = |f: &dyn Fn(&[[f64; 2]; N_BODY]) -> f64| fit_rows().iter().map(|(_, row)| f(row)).sum::<f64>();
        let product = |f: &dyn Fn([f64; 2], [f64; 2]) -> f64| {
            std::array::from_fn(|i| std::array::from_fn(|j| sum(&|row| f(row[i], row[j]))))
        };
        Sums {
            im_im: product(&|a, b| a[1] * b[1]),
            cross: product(&|a, b| a[1] * b[0] + a[0] * b[1]),
            re_re: product(&|a, b| a[0] * b[0]),
            im: std::array::from_fn(|i| sum(&|row| row[i][1])),
            re: std::array::from_fn(|i| sum(&|row| row[i][0])),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest relative miss of the damping ratio over 0.1…25 Hz.
    fn miss(ratio: f64, exponent: f64) -> f64 {
        let relaxation = Relaxation::new(ratio, exponent);
        assert!(relaxation.weights.iter().all(|w| *w >= 0.0) && relaxation.rest > 0.0);
        let at = |k: u32| {
            let f = 0.1 * 250f64.powf(f64::from(k) / 200.0);
            let [re, im] = relaxation.modulus(f);
            (0.5 * im / re / (ratio * (f / REFERENCE_HZ).powf(exponent)) - 1.0).abs()
        };
        (0..=200).map(at).fold(0.0, f64::max)
    }

    #[test]
    fn damping_is_what_is_asked_for_from_a_tenth_to_25_hertz() {
        for ratio in [1e-4, 0.005, 0.01, 0.03, 0.05, 0.1, 0.2] {
            println!("ratio {ratio}: within {:.2} %", 100.0 * miss(ratio, 0.0));
            assert!(miss(ratio, 0.0) < 0.02);
        }
        for exponent in [-0.6, -0.3, 0.3, 0.6] {
            println!("exponent {exponent}: within {:.2} %", 100.0 * miss(0.03, exponent));
            assert!(miss(0.03, exponent) < 0.05);
        }
    }

    #[test]
    fn the_quick_way_to_a_constant_target_is_the_general_one() {
        for ratio in [1e-3, 0.02, 0.2] {
            let ((quick, right), (general, other)) = (sums().at(ratio), power_sums(ratio, 0.0));
            for i in 0..N_BODY {
                assert!((right[i] / other[i] - 1.0).abs() < 1e-9);
                assert!((0..=i).all(|j| (quick[i][j] / general[i][j] - 1.0).abs() < 1e-9));
            }
        }
    }

    #[test]
    fn the_modulus_is_the_declared_one_at_the_reference_frequency_and_grows_by_the_dispersion_of_a_causal_solid() {
        let ratio = 0.03;
        let relaxation = Relaxation::new(ratio, 0.0);
        assert!((relaxation.modulus(REFERENCE_HZ)[0] - 1.0).abs() < 1e-12);
        // Kjartansson (1979): constant loss angle θ gives |K| ∝ f^(2θ/π).
        let theta = (2.0 * ratio).atan();
        for f in [0.3, 1.0, 10.0, 20.0] {
            let [re, _] = relaxation.modulus(f);
            let exact = (f / REFERENCE_HZ).powf(2.0 * theta / std::f64::consts::PI);
            assert!((re / exact - 1.0).abs() < 5e-3, "{f} Hz: {re} {exact}");
        }
    }
}
