//! Effects a declared site model may lack: one effect a file, registered in `EFFECTS`.
