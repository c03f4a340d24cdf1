//! Several numbers computed side by side: one generic kernel runs on plain `f64` and on AVX2 or AVX-512 registers.
//!
//! Only operations that IEEE 754 rounds exactly are offered (no fused multiply-add), and `exp` and `ln` are the same
//! polynomials everywhere, so a kernel gives **the same bytes** on every width; a faster machine changes the time alone.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A bundle of `N` numbers and the operations a constitutive kernel needs.
pub trait Lane:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// How many numbers.
    const N: usize;
    /// One truth value per number.
    type Mask: Copy;

    /// The same number in every lane.
    fn splat(x: f64) -> Self;
    /// Lane `i` is `from(i)`.
    fn from_fn(from: impl FnMut(usize) -> f64) -> Self;
    /// The first `N` numbers of `x`.
    fn load(x: &[f64]) -> Self;
    /// Writes to the first `N` numbers of `x`.
    fn store(self, x: &mut [f64]);
    /// The number in lane `i`.
    fn lane(self, i: usize) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// The larger one (the second operand where either is not a number).
    fn max(self, other: Self) -> Self;
    /// The smaller one (the second operand where either is not a number).
    fn min(self, other: Self) -> Self;
    /// Those of the lanes, at most as many as there are.
    fn mask(lanes: &[bool]) -> Self::Mask;
    /// Lane by lane `self < other`; false for not-a-number.
    fn lt(self, other: Self) -> Self::Mask;
    /// `yes` where the mask holds, `no` elsewhere.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Both.
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Either.
    fn or(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Negation.
    fn not(a: Self::Mask) -> Self::Mask;
    /// Whether any lane holds.
    fn any(a: Self::Mask) -> bool;
    /// `2^(low 11 bits of self's pattern − 1023)`: the pattern moved 52 bits up.
    fn bits_up_52(self) -> Self;
    /// (biased exponent as a number, mantissa in 1…2) of a positive normal number.
    fn exponent_and_mantissa(self) -> (Self, Self);

    /// `eˣ` for |x| ≤ 700 (clamped), relative error below 1e-15.
    #[inline(always)]
    fn exp(self) -> Self {
        let x = self.max(Self::splat(-700.0)).min(Self::splat(700.0));
        let shift = Self::splat(6_755_399_441_055_744.0); // 1.5·2⁵²
        let k = (x * Self::splat(std::f64::consts::LOG2_E) + shift) - shift;
        let r = (x - k * Self::splat(0.693_147_180_369_123_8)) - k * Self::splat(1.908_214_929_270_587_7e-10);
        let mut sum = Self::splat(1.0 / 6_227_020_800.0);
        for c in [
            1.0 / 479_001_600.0,
            1.0 / 39_916_800.0,
            1.0 / 3_628_800.0,
            1.0 / 362_880.0,
            1.0 / 40_320.0,
            1.0 / 5_040.0,
            1.0 / 720.0,
            1.0 / 120.0,
            1.0 / 24.0,
            1.0 / 6.0,
            0.5,
            1.0,
            1.0,
        ] {
            sum = sum * r + Self::splat(c);
        }
        sum * (k + (shift + Self::splat(1023.0))).bits_up_52()
    }

    /// `self` ≥ 0 to the power `exponent` > 0; see [`raise`].
    #[inline(always)]
    fn powf(self, exponent: Self) -> Self {
        let smallest = Self::splat(f64::MIN_POSITIVE);
        // Zero and what is smaller than any normal number become nothing.
        let power = Lane::exp(exponent * Lane::ln(Lane::max(self, smallest)));
        Self::select(smallest.lt(self), power, self)
    }

    /// Natural logarithm of a positive normal number, relative error below 1e-14.
    #[inline(always)]
    fn ln(self) -> Self {
        let (biased, mantissa) = self.exponent_and_mantissa();
        let large = Self::splat(std::f64::consts::SQRT_2).lt(mantissa);
        let m = Self::select(large, mantissa * Self::splat(0.5), mantissa);
        let exponent = biased - Self::select(large, Self::splat(1022.0), Self::splat(1023.0));
        let s = (m - Self::splat(1.0)) / (m + Self::splat(1.0));
        let s2 = s * s;
        let mut sum = Self::splat(1.0 / 21.0);
        for c in [19.0, 17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0] {
            sum = sum * s2 + Self::splat(1.0 / c);
        }
        exponent * Self::splat(std::f64::consts::LN_2) + Self::splat(2.0) * s * sum
    }
}

impl Lane for f64 {
    const N: usize = 1;
    type Mask = bool;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn from_fn(mut from: impl FnMut(usize) -> f64) -> Self {
        from(0)
    }
    #[inline(always)]
    fn load(x: &[f64]) -> Self {
        x[0]
    }
    #[inline(always)]
    fn store(self, x: &mut [f64]) {
        x[0] = self;
    }
    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn mask(lanes: &[bool]) -> bool {
        lanes[0]
    }
    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    #[inline(always)]
    fn and(a: bool, b: bool) -> bool {
        a & b
    }
    #[inline(always)]
    fn or(a: bool, b: bool) -> bool {
        a | b
    }
    #[inline(always)]
    fn not(a: bool) -> bool {
        !a
    }
    #[inline(always)]
    fn any(a: bool) -> bool {
        a
    }
    #[inline(always)]
    fn bits_up_52(self) -> Self {
        f64::from_bits(self.to_bits() << 52)
    }
    #[inline(always)]
    fn exponent_and_mantissa(self) -> (Self, Self) {
        let bits = self.to_bits();
        ((bits >> 52) as f64, f64::from_bits((bits & 0x000f_ffff_ffff_ffff) | 0x3ff0_0000_0000_0000))
    }
}

/// Numbers in the widest register that there is.
pub const WIDEST: usize = 8;

/// How many numbers a register of this machine holds; only widths that it has exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Width(usize);

impl Width {
    /// All widths of this machine, narrowest first.
    pub fn all() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        let wider = {
            let has_eight = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq");
            [(is_x86_feature_detected!("avx2"), 4), (has_eight, 8)]
        };
        #[cfg(not(target_arch = "x86_64"))]
        let wider: [(bool, usize); 0] = [];
        std::iter::once(Self(1))
            .chain(wider.into_iter().filter(|(is_there, _)| *is_there).map(|(_, n)| Self(n)))
            .collect()
    }

    /// The widest of this machine.
    pub fn widest() -> Self {
        static OWN: std::sync::OnceLock<Width> = std::sync::OnceLock::new();
        *OWN.get_or_init(|| Self::all().pop().unwrap_or(Self(1)))
    }

    /// How many numbers.
    pub fn lanes(self) -> usize {
        self.0
    }

    /// The numbers of one lane in `[…][lane]`.
    pub fn of_lane(self, array: &mut [f64], lane: usize) -> impl Iterator<Item = &mut f64> {
        array.iter_mut().skip(lane).step_by(self.0)
    }
}

/// The body of a function that calls `kernel::<L>` with its arguments, compiled for the registers of a [`Width`].
macro_rules! on_lanes {
    ($width:expr, $kernel:ident($($name:ident: $type:ty),* $(,)?) $(-> $result:ty)?) => {{
        #[cfg(target_arch = "x86_64")]
        {
            use $crate::numerics::lanes::{Avx2, Avx512};

            #[target_feature(enable = "avx2")]
            fn by_four($($name: $type),*) $(-> $result)? {
                $kernel::<Avx2>($($name),*)
            }
            #[target_feature(enable = "avx512f,avx512dq")]
            fn by_eight($($name: $type),*) $(-> $result)? {
                $kernel::<Avx512>($($name),*)
            }
            match $width.lanes() {
                // SAFETY: a width exists only where the machine has its registers.
                8 => return unsafe { by_eight($($name),*) },
                // SAFETY: as above.
                4 => return unsafe { by_four($($name),*) },
                _ => {}
            }
        }
        $kernel::<f64>($($name),*)
    }};
}
pub(crate) use on_lanes;

/// Copies `from` to `to`, `[…][lane]`, in `lanes` alone.
pub fn take_over(width: Width, lanes: &[bool], from: &[f64], to: &mut [f64]) {
    on_lanes!(width, taken_over(lanes: &[bool], from: &[f64], to: &mut [f64]))
}

#[inline(always)]
fn taken_over<L: Lane>(lanes: &[bool], from: &[f64], to: &mut [f64]) {
    copy::<L>(L::mask(lanes), from, to);
}

/// [`take_over`] for a kernel.
#[inline(always)]
pub fn copy<L: Lane>(is_taken: L::Mask, from: &[f64], to: &mut [f64]) {
    for (to, from) in to.chunks_exact_mut(L::N).zip(from.chunks_exact(L::N)) {
        L::select(is_taken, L::load(from), L::load(to)).store(to);
    }
}

/// Raises every x ≥ 0 to the power `exponent` > 0, in place, as many at a time as this machine's registers hold; the same bytes on every
/// width. Relative error below 1e-13 for |exponent ln x| ≤ 10; what is no number or infinite stays none or grows beyond all bounds.
pub fn raise(x: &mut [f64], exponent: f64) {
    on_lanes!(Width::widest(), raised(x: &mut [f64], exponent: f64))
}

#[inline(always)]
fn raised<L: Lane>(x: &mut [f64], exponent: f64) {
    for bundle in x.chunks_mut(L::N) {
        let last = bundle.len() - 1;
        let power = L::from_fn(|i| bundle[i.min(last)]).powf(L::splat(exponent));
        bundle.iter_mut().enumerate().for_each(|(i, x)| *x = power.lane(i));
    }
}

#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_and_logarithm_agree_with_the_library() {
        for i in 0..4000 {
            let x = -20.0 + f64::from(i) * 0.01;
            assert!((Lane::exp(x) / x.exp() - 1.0).abs() < 2e-15, "exp {x}");
            let y = x.exp();
            assert!((Lane::ln(y) - y.ln()).abs() < 1e-14 * y.ln().abs().max(0.1), "ln {y}");
        }
    }

    #[test]
    fn powers_agree_with_the_library_whatever_their_number() {
        for n in [1, 3, 8, 21] {
            for exponent in [0.5, 0.919, 1.5] {
                let x: Vec<f64> = (0..n).map(|i| f64::from(i) * 0.37 * 10f64.powi(i % 7 - 5)).collect();
                let mut found = x.clone();
                raise(&mut found, exponent);
                for (x, y) in x.iter().zip(found) {
                    assert!((y - x.powf(exponent)).abs() <= 1e-13 * y, "{x} to {exponent}: {y}");
                }
            }
        }
        let mut none = [f64::NAN];
        raise(&mut none, 0.9);
        assert!(none[0].is_nan());
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn every_width_gives_the_same_bytes() {
        #[target_feature(enable = "avx2")]
        fn wide4(x: &[f64]) -> Vec<u64> {
            x.chunks_exact(4).flat_map(|c| kernel(Avx2::from_fn(|i| c[i])).into_iter()).collect()
        }
        #[target_feature(enable = "avx512f,avx512dq")]
        fn wide8(x: &[f64]) -> Vec<u64> {
            x.chunks_exact(8).flat_map(|c| kernel(Avx512::from_fn(|i| c[i])).into_iter()).collect()
        }
        #[inline(always)]
        fn kernel<L: Lane>(x: L) -> Vec<u64> {
            let y = (x.ln() * L::splat(0.7)).exp() + x.sqrt() / (x + L::splat(1.0));
            (0..L::N).map(|i| y.lane(i).to_bits()).collect()
        }
        let x: Vec<f64> = (1..=800).map(|i| f64::from(i) * 0.037).collect();
        let narrow: Vec<u64> = x.iter().flat_map(|x| kernel(*x)).collect();
        if is_x86_feature_detected!("avx2") {
            // SAFETY: detected.
            assert_eq!(unsafe { wide4(&x) }, narrow);
        }
        if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq") {
            // SAFETY: detected.
            assert_eq!(unsafe { wide8(&x) }, narrow);
        }
    }
}
