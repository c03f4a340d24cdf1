//! Physics of the column and its laws against closed forms, finite differences, convergence slopes and independent results.

mod anything;
mod around_a_law;
mod batch;
mod boundaries;
mod equilibrium;
mod laws;
mod masing;
mod reference;
mod reference_column;
mod robustness;
mod sanisand;
mod strength;
mod support;
mod transfer_function;
mod viscoelastic;
