//! The registers of x86-64. The values may only exist inside functions compiled for (and run on) these features.

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
    ($lane:ident, $add:ident, $sub:ident, $mul:ident, $div:ident) => {
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
operators!(Avx2, _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd);
operators!(Avx512, _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd);

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
    fn load(x: &[f64]) -> Self {
        let x = &x[..4];
        Self(unsafe { _mm256_loadu_pd(x.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, x: &mut [f64]) {
        let x = &mut x[..4];
        unsafe { _mm256_storeu_pd(x.as_mut_ptr(), self.0) };
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
    fn mask(lanes: &[bool]) -> __m256d {
        let mut x = [0.0; 4];
        for (x, is_in) in x.iter_mut().zip(lanes) {
            *x = f64::from(u8::from(*is_in));
        }
        Self::splat(0.0).lt(Self::load(&x))
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
    fn load(x: &[f64]) -> Self {
        let x = &x[..8];
        Self(unsafe { _mm512_loadu_pd(x.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, x: &mut [f64]) {
        let x = &mut x[..8];
        unsafe { _mm512_storeu_pd(x.as_mut_ptr(), self.0) };
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
    fn mask(lanes: &[bool]) -> __mmask8 {
        let mut mask = 0;
        for (i, is_in) in lanes.iter().enumerate() {
            mask |= u8::from(*is_in) << i;
        }
        mask
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
            let mantissa = _mm512_or_si512(_mm512_and_si512(bits, _mm512_set1_epi64(MANTISSA)), _mm512_set1_epi64(ONE));
            (Self(_mm512_castsi512_pd(exponent)) - Self::splat(TWO_52_F), Self(_mm512_castsi512_pd(mantissa)))
        }
    }
}
