//! Who computes the items of an ensemble.

mod local;

pub(super) use local::{Ensemble, Permits, guarded};
