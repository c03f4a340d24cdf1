//! Synthetic base motions: a seeded nonstationary suite, baseline correction, scaling to a target PGA.
