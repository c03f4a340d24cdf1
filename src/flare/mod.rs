//! FLARE-T: encoder, latent equations, decoder; pretraining, distillation, calibration.
