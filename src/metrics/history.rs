//! Everything of one acceleration history that the field's measures compare: computed once, compared with many.

use super::anderson::Scored;
use super::fourier::smoothed_fourier_amplitude;
use super::intensity::{arias_build_up_m_s, significant_duration_s};
use super::peaks::{peak, peak_velocity_m_s};
use super::psa::{DAMPING, psa};

/// Ordinates a decade of the Fourier amplitude and of the response spectrum.
const FOURIER_A_DECADE: usize = 40;
const PSA_A_DECADE: usize = 20;
/// Range of the Fourier amplitude, Hz.
const FOURIER_HZ: [f64; 2] = [0.05, 50.0];
/// Range of the response spectrum, s: beyond what is reported, for the lowest band of the score.
const PSA_S: [f64; 2] = [0.01, 20.0];

/// One history, measured.
#[derive(Debug, Clone)]
pub struct History {
    /// Step, s.
    pub dt_s: f64,
    /// Peak acceleration, m/s².
    pub pga_m_s2: f64,
    /// Peak velocity, m/s.
    pub pgv_m_s: f64,
    /// Arias intensity, m/s.
    pub arias_m_s: f64,
    /// Time from 5 to 75 and to 95 % of it, s.
    pub duration_s: [f64; 2],
    /// Smoothed Fourier amplitude at [`fourier_frequencies_hz`], m/s.
    pub fourier_m_s: Vec<f64>,
    /// Response spectrum of 5 % at [`psa_periods_s`], m/s².
    pub psa_m_s2: Vec<f64>,
    /// What the score of Anderson needs, by band.
    pub(super) scored: Vec<Option<Scored>>,
}

impl History {
    /// Measures the acceleration `x` (m/s², step `dt_s`); the score will look at `band_hz` alone.
    pub fn new(x: &[f64], dt_s: f64, band_hz: [f64; 2]) -> Self {
        let build_up = arias_build_up_m_s(x, dt_s);
        let fourier_m_s = smoothed_fourier_amplitude(x, dt_s, &fourier_frequencies_hz());
        let psa_m_s2 = psa(x, dt_s, DAMPING, &psa_periods_s());
        Self {
            dt_s,
            pga_m_s2: peak(x),
            pgv_m_s: peak_velocity_m_s(x, dt_s),
            arias_m_s: build_up.last().copied().unwrap_or(0.0),
            duration_s: [0.75, 0.95].map(|share| significant_duration_s(&build_up, dt_s, [0.05, share])),
            scored: Scored::of(x, dt_s, band_hz, &fourier_m_s, &psa_m_s2),
            fourier_m_s,
            psa_m_s2,
        }
    }
}

/// Frequencies of [`History::fourier_m_s`], Hz: 40 a decade from 0.05 to 50.
pub fn fourier_frequencies_hz() -> Vec<f64> {
    log_spaced(FOURIER_HZ, FOURIER_A_DECADE)
}

/// Periods of [`History::psa_m_s2`], s: 20 a decade from 0.01 to 20.
pub fn psa_periods_s() -> Vec<f64> {
    log_spaced(PSA_S, PSA_A_DECADE)
}

fn log_spaced([first, last]: [f64; 2], a_decade: usize) -> Vec<f64> {
    let n = ((last / first).log10() * a_decade as f64).round() as usize;
    (0..=n).map(|i| first * (last / first).powf(i as f64 / n as f64)).collect()
}
