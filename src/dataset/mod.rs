//! Trajectories on disk (MCAP), their index and splits, decimation and normalisation.
