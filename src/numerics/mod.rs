//! Numerical tools without domain words: linear algebra of the column, filters and resampling, random streams.

pub mod block_tridiagonal;
pub mod filter;
pub mod fixed_point;
pub mod grid;
pub mod integrate;
pub mod lanes;
pub mod nnls;
pub mod random;
pub mod resample;
pub mod smooth;
pub mod spectrum;
pub mod spill;
pub mod threads;
