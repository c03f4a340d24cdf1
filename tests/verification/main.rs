//! Physics of the column and its laws against closed forms, finite differences, convergence slopes and independent results.

mod reference;
mod reference_column;
mod robustness;
mod sanisand;
mod support;
mod transfer_function;
