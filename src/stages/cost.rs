//! What an ensemble will take, before it is run: time by a short stretch of its column on this machine, memory and disk by what is kept.

use super::budget::machine_bytes;
use crate::column::Column;
use crate::error::{Error, Result};
use crate::manifest::Site;
use crate::numerics::threads;
use std::f64::consts::TAU;
use std::time::Instant;

/// Elements times steps of the stretch that is run.
const PROBE: usize = 100_000;
/// Steps of that stretch at the most: a fast column needs no more.
const PROBE_STEPS: usize = 200;
/// A decoded trajectory beside the bytes it is read from; a learning set beside what is made of it.
const COPIES: f64 = 2.0;
/// What nothing of this counts: the program, a column, a report.
const ELSE_BYTES: f64 = 6e7;

/// What the ensemble of a site takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cost {
    /// Wall time of its columns, s.
    pub time_s: f64,
    /// Most memory of its stages, bytes.
    pub memory_bytes: f64,
    /// Its trajectories and learning set, bytes.
    pub disk_bytes: f64,
}

impl Cost {
    /// An estimate for `site`, whose column is `column`.
    pub fn of(site: &Site, column: &Column) -> Self {
        let (motions, analysis) = (&site.motions, &site.analysis);
        let [count, elements] = [motions.count, site.site.elements].map(|n| n as f64);
        let sensors = site.sensors.output.len() as f64;
        let workers = threads::available().min(motions.count.max(1)) as f64;
        let samples = |step_s: f64| motions.duration_s / step_s;
        // Time, base, surface and sensors in double precision, elements in single.
        let trajectory_bytes = samples(analysis.output_step_s) * (4.0 * elements + 8.0 * (3.0 + sensors));
        let channels = (site.pretrain.channels as f64).min(elements);
        let set_bytes = count * samples(site.pretrain.step_s) * 4.0 * (2.0 + channels + sensors);
        let suite_bytes = count * samples(motions.step_s) * 8.0;
        let learning_bytes = (2.0 * COPIES * set_bytes).min(site.training.memory_bytes(machine_bytes()));
        let reading_bytes = COPIES * workers * trajectory_bytes + learning_bytes;
        Self {
            time_s: samples(analysis.max_step_s) * step_time_s(site, column) * (count / workers).ceil(),
            memory_bytes: ELSE_BYTES + suite_bytes.max(reading_bytes),
            disk_bytes: count * trajectory_bytes + set_bytes,
        }
    }

    /// Refuses what this machine has no memory for.
    ///
    /// # Errors
    /// When it asks for more than there is.
    pub fn check(&self) -> Result<()> {
        let Some(available) = machine_bytes().filter(|available| self.memory_bytes > *available) else { return Ok(()) };
        let what = format!(
            "the ensemble needs some {:.1} GB of memory, this machine has {:.1} GB",
            self.memory_bytes / 1e9,
            available / 1e9
        );
        Err(Error::new(what)
            .at("`motions` and `analysis`")
            .hint("a longer `analysis.output_step_s` or `motions.step_s`, fewer `site.elements`, or shorter or fewer motions")
            .usage())
    }
}

/// Wall time of one step of the column under a motion as strong as those of the ensemble, s.
fn step_time_s(site: &Site, column: &Column) -> f64 {
    let n = (PROBE / site.site.elements.max(1)).clamp(2, PROBE_STEPS);
    let step_s = site.analysis.max_step_s;
    let peak_g = site.motions.bands.iter().map(|band| band.max_pga_g).fold(0.0, f64::max);
    let motion: Vec<f64> = (0..n)
        .map(|i| crate::units::G_M_S2 * peak_g * (TAU * column.frequency_hz() * i as f64 * step_s).sin())
        .collect();
    let start = Instant::now();
    // Where the column does not finish, the time that it took is told all the same.
    let _ = column.run(step_s, &motion, &mut |_| Ok(()));
    start.elapsed().as_secs_f64() / n as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::Manifest;
    use std::path::Path;

    #[test]
    fn what_no_machine_has_is_refused_and_a_small_site_is_not() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/smoke.toml");
        let mut site = Manifest::load(&path, &[]).expect("a sound site").site;
        let column = Column::new(&site.column().profile().expect("a profile"), &site.analysis).expect("a column");
        let small = Cost::of(&site, &column);
        small.check().expect("a small ensemble");
        assert!(small.time_s > 0.0 && small.disk_bytes < 1e8, "{small:?}");
        // Ten times as many motions take ten times the disk.
        site.motions.count *= 10;
        let more = Cost::of(&site, &column);
        assert!((more.disk_bytes / small.disk_bytes - 10.0).abs() < 1e-9);
        site.analysis.output_step_s = 1e-9;
        let refused = Cost::of(&site, &column).check().expect_err("terabytes").to_string();
        assert!(refused.contains("of memory, this machine has"), "{refused}");
    }
}
