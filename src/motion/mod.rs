//! Synthetic base motions: a seeded nonstationary suite, baseline correction, scaling to a target PGA.

mod assignment;
mod baseline;
mod cases;
mod settings;
mod suite;

pub use assignment::target_pga_m_s2;
pub use baseline::correct_baseline;
pub use cases::parse_cases;
pub use settings::{Band, MotionSettings};
pub use suite::{Motion, case_id, suite};
