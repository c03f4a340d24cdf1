//! Linear columns on a rigid base against the exact transfer function, amplitude and phase.
