//! Numerical tools without domain words: linear algebra of the column, filters and resampling, random streams.

pub mod random;

pub mod block_tridiagonal;
pub mod delay;
