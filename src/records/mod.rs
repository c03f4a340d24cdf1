//! Measured records: one file format a file, registered in `FORMATS`.
