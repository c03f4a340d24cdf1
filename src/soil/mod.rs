//! Constitutive laws: one law a file, registered in `LAWS`.
