//! A site for tests of the program as a whole.

/// What makes `configs/smoke.toml` a site that runs through every stage of FLARE-T in a second.
pub const SMALL: &[&str] = &[
    "--pipeline",
    "flare-t",
    "--set",
    "site.elements=10",
    "--set",
    "pretrain.channels=8",
    "--set",
    "motions.count=6",
    "--set",
    "motions.bands=[{ count = 6, min_pga_g = 0.01, max_pga_g = 0.1 }]",
    "--set",
    "motions.train='1-4'",
    "--set",
    "motions.validation='5-6'",
    "--set",
    "pretrain.epochs=10",
    "--set",
    "pretrain.polish_every=10",
    "--set",
    "distill.epochs=4",
    "--set",
    "calibrate.epochs=4",
    "--set",
    "calibrate.solver=adam",
];
