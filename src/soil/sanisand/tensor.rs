//! Symmetric tensors of plane strain: components xx, yy, zz, xy.

use std::ops::{Add, Mul, Sub};

/// xx, yy, zz, xy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tensor(pub [f64; 4]);

impl Tensor {
    pub const ZERO: Self = Self([0.0; 4]);
    pub const UNIT: Self = Self([1.0, 1.0, 1.0, 0.0]);

    #[inline(always)]
    pub fn trace(self) -> f64 {
        self.0[0] + self.0[1] + self.0[2]
    }

    #[inline(always)]
    pub fn deviator(self) -> Self {
        self - Self::UNIT * (self.trace() / 3.0)
    }

    /// a:b
    #[inline(always)]
    pub fn dot(self, b: Self) -> f64 {
        let a = self.0;
        a[0] * b.0[0] + a[1] * b.0[1] + a[2] * b.0[2] + 2.0 * a[3] * b.0[3]
    }

    #[inline(always)]
    pub fn norm(self) -> f64 {
        self.dot(self).sqrt()
    }

    /// a·a
    #[inline(always)]
    pub fn square(self) -> Self {
        let [x, y, z, s] = self.0;
        Self([x * x + s * s, y * y + s * s, z * z, s * (x + y)])
    }
}

impl Add for Tensor {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self([self.0[0] + b.0[0], self.0[1] + b.0[1], self.0[2] + b.0[2], self.0[3] + b.0[3]])
    }
}

impl Sub for Tensor {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self([self.0[0] - b.0[0], self.0[1] - b.0[1], self.0[2] - b.0[2], self.0[3] - b.0[3]])
    }
}

impl Mul<f64> for Tensor {
    type Output = Self;
    #[inline(always)]
    fn mul(self, k: f64) -> Self {
        Self([self.0[0] * k, self.0[1] * k, self.0[2] * k, self.0[3] * k])
    }
}
