//! Measured records of a KiK-net site.

use flare_pipe::manifest::Manifest;
use flare_pipe::metrics::{FreeFilter, Pair};
use flare_pipe::numerics::filter::band_pass_zero_phase;
use flare_pipe::numerics::resample::resample_band_limited;
use flare_pipe::records::RecordSettings;
use flare_pipe::stages;
use std::path::{Path, PathBuf};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// What no filter that is the same in all events can beat by much: each of the ten weak events is predicted from the nine others.
#[test]
fn weak_events_of_a_real_site_have_the_ceiling_of_the_prototype() {
    const STEP_S: f64 = 0.05;
    let manifest = Manifest::load(&path("configs/fksh11.toml"), &[]).expect("a sound manifest");
    let Some(dir) = manifest.records_dir.clone().filter(|dir| dir.is_dir()) else {
        eprintln!("skipped: no records in ../shared/records/FKSH11");
        return;
    };
    let settings =
        RecordSettings { dir: Some(dir.display().to_string()), ..manifest.site.records.clone().expect("records") };
    let read = stages::measured(&settings, &manifest.site.column()).expect("sound records");
    let strong = ["2102132308", "1104111716", "2203162336"];
    for component in &settings.components {
        let coarse = |x: &[f64], dt_s: f64| {
            let band = band_pass_zero_phase(x, dt_s, 0.3, 9.5);
            resample_band_limited(&band, dt_s, STEP_S)
        };
        let histories: Vec<[Vec<f64>; 2]> = read
            .records
            .iter()
            .map(|(_, r)| r)
            .filter(|r| &r.component == component && !strong.contains(&r.event.as_str()))
            .map(|r| [&r.input, &r.outputs[0]].map(|s| coarse(&s.acceleration_m_s2, r.dt_s)))
            .collect();
        let pairs: Vec<Pair<'_>> = histories.iter().map(|[u, y]| Pair { input: u, output: y }).collect();
        let left_out = |i: usize| {
            let others: Vec<Pair<'_>> = pairs.iter().enumerate().filter(|(o, _)| *o != i).map(|(_, p)| *p).collect();
            FreeFilter::of(&others, STEP_S).expect("nine events").nrmse_percent(&pairs[i])
        };
        let errors: Vec<f64> = (0..pairs.len()).map(left_out).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        println!("{component}: ceiling {mean:.1} %, by event {errors:.0?}");
        assert!(errors.len() == 10 && (80.0..90.0).contains(&mean), "{component}: {mean} {errors:?}");
    }
}
