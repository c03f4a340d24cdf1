//! Which peak acceleration each case gets: every run of consecutive cases holds every band, and every part of a band,
//! in proportion, so that the last fifth of the cases validates what the first four fifths trained.

use super::settings::MotionSettings;
use crate::numerics::random;
use crate::units::G_M_S2;
use rand::RngExt;
use rand::seq::SliceRandom;

/// Parts of a band that successive cases take in turn.
const PARTS: usize = 5;

/// Target peak acceleration of each case, m/s².
///
/// A band with `n` motions is cut into `n` equal strata and one value drawn in each.
pub fn target_pga_m_s2(settings: &MotionSettings) -> Vec<f64> {
    // Case positions: the members of a band are equally spaced over the cases, each band with its own offset.
    let mut places: Vec<(f64, usize, usize)> = Vec::new();
    let mut values: Vec<Vec<f64>> = Vec::new();
    for (b, band) in settings.bands.iter().enumerate() {
        let mut rng = random::stream(settings.seed, &format!("motion band {b}"));
        let offset: f64 = rng.random();
        places.extend((0..band.count).map(|j| ((j as f64 + offset) / band.count as f64, b, j)));
        let width = (band.max_pga_g - band.min_pga_g) / band.count as f64;
        let drawn: Vec<f64> =
            (0..band.count).map(|s| (band.min_pga_g + width * (s as f64 + rng.random::<f64>())) * G_M_S2).collect();
        values.push(in_turns(band.count, &mut rng).into_iter().map(|stratum| drawn[stratum]).collect());
    }
    places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    places.into_iter().map(|(_, band, j)| values[band][j]).collect()
}

/// A random order of `0..n` in which every `PARTS` successive entries come from different fifths of the range.
fn in_turns(n: usize, rng: &mut impl rand::Rng) -> Vec<usize> {
    let mut parts: Vec<Vec<usize>> = (0..PARTS).map(|p| (n * p / PARTS..n * (p + 1) / PARTS).collect()).collect();
    parts.iter_mut().for_each(|part| part.shuffle(rng));
    let mut order = Vec::with_capacity(n);
    while order.len() < n {
        let mut turn: Vec<usize> = parts.iter_mut().filter_map(Vec::pop).collect();
        turn.shuffle(rng);
        order.append(&mut turn);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Band;
    use crate::motion::suite::tests::lotung;

    fn in_band(pga_m_s2: &[f64], band: &Band) -> usize {
        let (low, high) = (band.min_pga_g * G_M_S2, band.max_pga_g * G_M_S2);
        pga_m_s2.iter().filter(|v| **v >= low && **v < high).count()
    }

    #[test]
    fn training_and_validation_hold_every_band_in_proportion() {
        for seed in 0..20 {
            let settings = MotionSettings { seed, ..lotung() };
            let pga = target_pga_m_s2(&settings);
            let counts = |cases: &[f64]| settings.bands.iter().map(|b| in_band(cases, b)).collect::<Vec<_>>();
            assert_eq!(counts(&pga), vec![60, 20, 20]);
            assert_eq!(counts(&pga[80..]), vec![12, 4, 4], "seed {seed}");
        }
    }

    #[test]
    fn every_stratum_holds_one_motion() {
        let pga = target_pga_m_s2(&lotung());
        for i in 0..20 {
            let stratum =
                Band { count: 1, min_pga_g: 0.06 + 0.0026 * f64::from(i), max_pga_g: 0.06 + 0.0026 * f64::from(i + 1) };
            assert_eq!(in_band(&pga, &stratum), 1, "stratum {i}");
        }
    }

    #[test]
    fn every_turn_visits_every_part() {
        let order = in_turns(60, &mut random::stream(3, "test"));
        for turn in order.chunks(PARTS) {
            let mut parts: Vec<usize> = turn.iter().map(|s| s / 12).collect();
            parts.sort_unstable();
            assert_eq!(parts, vec![0, 1, 2, 3, 4]);
        }
        let mut all = in_turns(7, &mut random::stream(3, "test"));
        all.sort_unstable();
        assert_eq!(all, (0..7).collect::<Vec<_>>());
    }
}
