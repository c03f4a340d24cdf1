//! The few inner loops that need wide fused arithmetic, and the choice of instructions at run time.
//!
//! Eight sequences travel side by side, one per lane, so that every scalar of the mathematics becomes one [`Lanes`].
//! [`dispatch`] runs a [`Kernel`] compiled for AVX2 and FMA where the processor has them and a portable build elsewhere;
//! the portable build rounds each product before the sum, so its results differ from the fused ones in the last bits. On
//! one machine the choice never changes, hence neither do the bytes.

/// Sequences that travel side by side.
pub const LANES: usize = 8;

/// One scalar for each of the sequences side by side.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(32))]
pub struct Lanes(pub [f32; LANES]);

impl Lanes {
    /// All lanes zero.
    pub const ZERO: Self = Self([0.0; LANES]);

    /// The same value in all lanes.
    #[inline(always)]
    pub fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    /// Sum over the lanes, in a fixed order.
    pub fn sum(&self) -> f32 {
        self.0.iter().sum()
    }

    /// `self += x`.
    #[inline(always)]
    pub fn add<const FMA: bool>(&mut self, x: &Self) {
        self.add_scaled::<FMA>(x, 1.0);
    }

    /// `self += x · s`.
    #[inline(always)]
    pub fn add_scaled<const FMA: bool>(&mut self, x: &Self, s: f32) {
        self.add_product::<FMA>(x, &Self::splat(s));
    }

    /// `self += x · y`, lane by lane.
    #[inline(always)]
    pub fn add_product<const FMA: bool>(&mut self, x: &Self, y: &Self) {
        #[cfg(target_arch = "x86_64")]
        if FMA {
            use std::arch::x86_64::{_mm256_fmadd_ps, _mm256_load_ps, _mm256_store_ps};
            // SAFETY: `FMA` is set by `dispatch` alone, where AVX2 and FMA were detected; lanes are aligned to 32 bytes.
            // Written out because the compiler takes larger blocks of such sums apart into single numbers.
            unsafe {
                let sum = _mm256_fmadd_ps(
                    _mm256_load_ps(x.0.as_ptr()),
                    _mm256_load_ps(y.0.as_ptr()),
                    _mm256_load_ps(self.0.as_ptr()),
                );
                _mm256_store_ps(self.0.as_mut_ptr(), sum);
            }
            return;
        }
        for ((a, x), y) in self.0.iter_mut().zip(&x.0).zip(&y.0) {
            *a = fused::<FMA>(*x, *y, *a);
        }
    }

    /// `f(x)`, lane by lane.
    #[inline(always)]
    pub fn map(self, f: impl Fn(f32) -> f32) -> Self {
        Self(self.0.map(f))
    }

    /// `x · y`, lane by lane.
    #[inline(always)]
    pub fn product(x: &Self, y: &Self) -> Self {
        let mut out = *x;
        for (o, y) in out.0.iter_mut().zip(&y.0) {
            *o *= y;
        }
        out
    }
}

/// `a·b + c`, rounded once where the kernel was compiled for fused arithmetic.
#[inline(always)]
pub fn fused<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// A loop worth compiling twice. `run` must be `#[inline(always)]`, or it is not compiled for the wide instructions.
pub trait Kernel {
    /// What it returns.
    type Out;
    /// Runs it; `FMA` tells whether fused arithmetic is one instruction.
    fn run<const FMA: bool>(self) -> Self::Out;
}

/// Runs `kernel` with the widest instructions this processor has.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Out {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn wide<K: Kernel>(kernel: K) -> K::Out {
            kernel.run::<true>()
        }
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
            // SAFETY: both features were detected on this processor.
            return unsafe { wide(kernel) };
        }
    }
    kernel.run::<false>()
}

/// `e^x` for `x ≤ 0` to 2 ulp: range reduction by ln 2 and a degree-6 polynomial, free of branches so that it vectorises.
#[inline(always)]
fn exp_nonpositive<const FMA: bool>(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0; // 1.5·2^23: adding it rounds to an integer, which then ends the mantissa
    let x = x.max(-87.0);
    let rounded = fused::<FMA>(x, std::f32::consts::LOG2_E, ROUND);
    let n = rounded - ROUND;
    let r = fused::<FMA>(n, 2.121_944_4e-4, fused::<FMA>(n, -0.693_359_4, x));
    let mut p = 1.987_569_1e-4;
    for c in [1.398_2e-3, 8.333_452e-3, 4.166_579_6e-2, 0.166_666_65, 0.5] {
        p = fused::<FMA>(p, r, c);
    }
    let p = fused::<FMA>(p * r, r, r) + 1.0;
    f32::from_bits(p.to_bits().wrapping_add(rounded.to_bits() << 23))
}

/// Adds the bias to each row and applies ELU: `y = v` for `v > 0`, else `e^v − 1`.
pub struct BiasElu<'a> {
    /// `[n_row · n]`, overwritten.
    pub rows: &'a mut [f32],
    /// `[n]`.
    pub bias: &'a [f32],
}

impl Kernel for BiasElu<'_> {
    type Out = ();
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        for row in self.rows.chunks_exact_mut(self.bias.len()) {
            for (y, b) in row.iter_mut().zip(self.bias) {
                let v = *y + b;
                let e = exp_nonpositive::<FMA>(v.min(0.0)) - 1.0;
                *y = if v > 0.0 { v } else { e };
            }
        }
    }
}

/// Multiplies a cotangent by the slope of ELU, read off its output: `1` for `y > 0`, else `y + 1`.
pub struct EluSlope<'a> {
    /// Cotangent, overwritten.
    pub cotangent: &'a mut [f32],
    /// Output of the activation, same shape.
    pub output: &'a [f32],
}

impl Kernel for EluSlope<'_> {
    type Out = ();
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        for (d, y) in self.cotangent.iter_mut().zip(self.output) {
            *d *= 1.0 + y.min(0.0);
        }
    }
}

/// Squared error of one row; `decoded` becomes `scale · error`.
pub struct SquareError<'a> {
    /// Response, overwritten.
    pub decoded: &'a mut [f32],
    /// What it should be, same shape.
    pub target: &'a [f32],
    /// Factor on the error.
    pub scale: f32,
}

impl Kernel for SquareError<'_> {
    type Out = f64;
    #[inline(always)]
    fn run<const FMA: bool>(self) -> f64 {
        let mut sum = Lanes::ZERO;
        let (decoded, decoded_end) = self.decoded.as_chunks_mut::<LANES>();
        let (target, target_end) = self.target.as_chunks::<LANES>();
        decoded.iter_mut().zip(target).for_each(|(d, t)| square_errors(&mut sum, d, t, self.scale));
        square_errors(&mut sum, decoded_end, target_end, self.scale);
        f64::from(sum.sum())
    }
}

/// At most one number a lane.
#[inline(always)]
fn square_errors(sum: &mut Lanes, decoded: &mut [f32], target: &[f32], scale: f32) {
    for ((s, d), t) in sum.0.iter_mut().zip(decoded).zip(target) {
        let error = *d - t;
        *s += error * error;
        *d = scale * error;
    }
}

/// Sums the rows of a `[n_row · n]` matrix into `[n]`.
pub struct ColumnSum<'a> {
    /// The matrix.
    pub rows: &'a [f32],
    /// Added to.
    pub sum: &'a mut [f32],
}

impl Kernel for ColumnSum<'_> {
    type Out = ();
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        for row in self.rows.chunks_exact(self.sum.len()) {
            for (s, x) in self.sum.iter_mut().zip(row) {
                *s += x;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elu_and_its_slope_match_the_exact_functions() {
        let v: Vec<f32> = (-4000..4000).map(|i| i as f32 * 0.025).collect();
        for wide in [true, false] {
            let mut y = v.clone();
            let kernel = BiasElu { rows: &mut y, bias: &[0.0; 8000] };
            if wide {
                dispatch(kernel)
            } else {
                kernel.run::<false>()
            }
            let mut d = vec![1.0; v.len()];
            dispatch(EluSlope { cotangent: &mut d, output: &y });
            for ((v, y), d) in v.iter().zip(&y).zip(&d) {
                let exact = if *v > 0.0 { f64::from(*v) } else { f64::from(*v).exp_m1() };
                let slope = if *v > 0.0 { 1.0 } else { f64::from(*v).exp() };
                assert!((f64::from(*y) - exact).abs() < 2e-7 * (1.0 + exact.abs()), "elu({v}) = {y}, exact {exact}");
                assert!((f64::from(*d) - slope).abs() < 3e-7, "slope at {v}: {d}, exact {slope}");
            }
        }
    }
}
