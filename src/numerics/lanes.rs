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

#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

/// The registers of x86-64. The values may only exist inside functions compiled for (and run on) these features.
#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Lane;
    use std::arch::x86_64::*;
    use std::ops::{Add, Div, Mul, Neg, Sub};

    /// Four numbers in an AVX2 register.
    #[derive(Clone, Copy)]
    pub struct Avx2(__m256d);

    /// Eight numbers in an AVX-512 register.
    #[derive(Clone, Copy)]
    pub struct Avx512(__m512d);

    macro_rules! operators {
        ($lane:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $zero:ident) => {
            impl Add for $lane {
                type Output = Self;
                #[inline(always)]
                fn add(self, o: Self) -> Self {
                    // SAFETY: the value exists only where the feature does (see the module).
                    Self(unsafe { $add(self.0, o.0) })
                }
            }
            impl Sub for $lane {
                type Output = Self;
                #[inline(always)]
                fn sub(self, o: Self) -> Self {
                    // SAFETY: as above.
                    Self(unsafe { $sub(self.0, o.0) })
                }
            }
            impl Mul for $lane {
                type Output = Self;
                #[inline(always)]
                fn mul(self, o: Self) -> Self {
                    // SAFETY: as above.
                    Self(unsafe { $mul(self.0, o.0) })
                }
            }
            impl Div for $lane {
                type Output = Self;
                #[inline(always)]
                fn div(self, o: Self) -> Self {
                    // SAFETY: as above.
                    Self(unsafe { $div(self.0, o.0) })
                }
            }
            impl Neg for $lane {
                type Output = Self;
                #[inline(always)]
                fn neg(self) -> Self {
                    // SAFETY: as above. Multiplying keeps the sign of zero, as `-x` does for f64.
                    self * Self::splat(-1.0)
                }
            }
        };
    }
    operators!(Avx2, _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd, _mm256_setzero_pd);
    operators!(Avx512, _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd, _mm512_setzero_pd);

    const MANTISSA: i64 = 0x000f_ffff_ffff_ffff;
    const ONE: i64 = 0x3ff0_0000_0000_0000;
    const TWO_52: i64 = 0x4330_0000_0000_0000;
    const TWO_52_F: f64 = 4_503_599_627_370_496.0;

    // SAFETY of every block below: values of these types exist only in functions compiled for the feature.
    impl Lane for Avx2 {
        const N: usize = 4;
        type Mask = __m256d;

        #[inline(always)]
        fn splat(x: f64) -> Self {
            Self(unsafe { _mm256_set1_pd(x) })
        }
        #[inline(always)]
        fn from_fn(mut from: impl FnMut(usize) -> f64) -> Self {
            let x = [from(0), from(1), from(2), from(3)];
            Self(unsafe { _mm256_loadu_pd(x.as_ptr()) })
        }
        #[inline(always)]
        fn lane(self, i: usize) -> f64 {
            let mut x = [0.0; 4];
            unsafe { _mm256_storeu_pd(x.as_mut_ptr(), self.0) };
            x[i]
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            Self(unsafe { _mm256_sqrt_pd(self.0) })
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), self.0) })
        }
        #[inline(always)]
        fn max(self, o: Self) -> Self {
            Self(unsafe { _mm256_max_pd(self.0, o.0) })
        }
        #[inline(always)]
        fn min(self, o: Self) -> Self {
            Self(unsafe { _mm256_min_pd(self.0, o.0) })
        }
        #[inline(always)]
        fn lt(self, o: Self) -> __m256d {
            unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(self.0, o.0) }
        }
        #[inline(always)]
        fn select(mask: __m256d, yes: Self, no: Self) -> Self {
            Self(unsafe { _mm256_blendv_pd(no.0, yes.0, mask) })
        }
        #[inline(always)]
        fn and(a: __m256d, b: __m256d) -> __m256d {
            unsafe { _mm256_and_pd(a, b) }
        }
        #[inline(always)]
        fn or(a: __m256d, b: __m256d) -> __m256d {
            unsafe { _mm256_or_pd(a, b) }
        }
        #[inline(always)]
        fn not(a: __m256d) -> __m256d {
            unsafe { _mm256_xor_pd(a, _mm256_castsi256_pd(_mm256_set1_epi64x(-1))) }
        }
        #[inline(always)]
        fn any(a: __m256d) -> bool {
            unsafe { _mm256_movemask_pd(a) != 0 }
        }
        #[inline(always)]
        fn bits_up_52(self) -> Self {
            Self(unsafe { _mm256_castsi256_pd(_mm256_slli_epi64::<52>(_mm256_castpd_si256(self.0))) })
        }
        #[inline(always)]
        fn exponent_and_mantissa(self) -> (Self, Self) {
            unsafe {
                let bits = _mm256_castpd_si256(self.0);
                let exponent = _mm256_or_si256(_mm256_srli_epi64::<52>(bits), _mm256_set1_epi64x(TWO_52));
                let mantissa =
                    _mm256_or_si256(_mm256_and_si256(bits, _mm256_set1_epi64x(MANTISSA)), _mm256_set1_epi64x(ONE));
                (Self(_mm256_castsi256_pd(exponent)) - Self::splat(TWO_52_F), Self(_mm256_castsi256_pd(mantissa)))
            }
        }
    }

    impl Lane for Avx512 {
        const N: usize = 8;
        type Mask = __mmask8;

        #[inline(always)]
        fn splat(x: f64) -> Self {
            Self(unsafe { _mm512_set1_pd(x) })
        }
        #[inline(always)]
        fn from_fn(mut from: impl FnMut(usize) -> f64) -> Self {
            let x = [from(0), from(1), from(2), from(3), from(4), from(5), from(6), from(7)];
            Self(unsafe { _mm512_loadu_pd(x.as_ptr()) })
        }
        #[inline(always)]
        fn lane(self, i: usize) -> f64 {
            let mut x = [0.0; 8];
            unsafe { _mm512_storeu_pd(x.as_mut_ptr(), self.0) };
            x[i]
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            Self(unsafe { _mm512_sqrt_pd(self.0) })
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(unsafe { _mm512_abs_pd(self.0) })
        }
        #[inline(always)]
        fn max(self, o: Self) -> Self {
            Self(unsafe { _mm512_max_pd(self.0, o.0) })
        }
        #[inline(always)]
        fn min(self, o: Self) -> Self {
            Self(unsafe { _mm512_min_pd(self.0, o.0) })
        }
        #[inline(always)]
        fn lt(self, o: Self) -> __mmask8 {
            unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, o.0) }
        }
        #[inline(always)]
        fn select(mask: __mmask8, yes: Self, no: Self) -> Self {
            Self(unsafe { _mm512_mask_blend_pd(mask, no.0, yes.0) })
        }
        #[inline(always)]
        fn and(a: __mmask8, b: __mmask8) -> __mmask8 {
            a & b
        }
        #[inline(always)]
        fn or(a: __mmask8, b: __mmask8) -> __mmask8 {
            a | b
        }
        #[inline(always)]
        fn not(a: __mmask8) -> __mmask8 {
            !a
        }
        #[inline(always)]
        fn any(a: __mmask8) -> bool {
            a != 0
        }
        #[inline(always)]
        fn bits_up_52(self) -> Self {
            Self(unsafe { _mm512_castsi512_pd(_mm512_slli_epi64::<52>(_mm512_castpd_si512(self.0))) })
        }
        #[inline(always)]
        fn exponent_and_mantissa(self) -> (Self, Self) {
            unsafe {
                let bits = _mm512_castpd_si512(self.0);
                let exponent = _mm512_or_si512(_mm512_srli_epi64::<52>(bits), _mm512_set1_epi64(TWO_52));
                let mantissa =
                    _mm512_or_si512(_mm512_and_si512(bits, _mm512_set1_epi64(MANTISSA)), _mm512_set1_epi64(ONE));
                (Self(_mm512_castsi512_pd(exponent)) - Self::splat(TWO_52_F), Self(_mm512_castsi512_pd(mantissa)))
            }
        }
    }
}

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
