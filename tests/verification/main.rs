//! Physics of the column and its laws against closed forms, finite differences, convergence slopes and independent results.

mod reference;
mod reference_column;
mod sanisand;
mod support;
