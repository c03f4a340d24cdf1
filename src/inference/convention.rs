//! What other programs make of the same declared column: what these change is no property of a site.

use super::forward::{Bins, Forward, Prediction, built};
use crate::column::{Analysis, Column, Profile, Rayleigh};
use crate::diagnosis::DiagnoseSettings;
use crate::diagnosis::responses::Scene;
use crate::effects::{self, Effect};
use crate::error::Result;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::sync::Arc;
use toml::Table;

type C64 = Complex<f64>;

/// Share of the motion below which a convention changes nothing.
const NOTHING: f64 = 1e-6;
/// Share of the damping that laws remember that stays where it becomes Rayleigh damping: an effect takes no more away.
const LEFT: f64 = 0.05;

/// What is added to the outputs, by record.
pub type Slope = Arc<Vec<Bins>>;

/// What each convention adds to the outputs under `tables` on top of what is declared: a complex modulus without dispersion, as
/// frequency-domain programs have it, instead of the causal one; and [`rayleigh`] damping, as time-domain programs have it. Taken from
/// the linear-equivalent column, tuned to the replay there; one that changes nothing is left out.
///
/// # Errors
/// When the column cannot be built or replayed.
pub fn conventions(forward: &Forward<'_>, settings: &DiagnoseSettings, tables: &[Table]) -> Result<Vec<Slope>> {
    let effects = built(forward.problem, tables)?;
    let mut scene = Scene::new(forward.problem, settings)?;
    scene.tune(&effects, &forward.fine(tables)?)?;
    let ours = motions(&scene, &effects)?;
    let mut theirs = vec![motions(&scene.without_dispersion(), &effects)?];
    if let Some(table) = rayleigh(&forward.problem.array.profile)? {
        theirs.push(motions(&scene, &built(forward.problem, &[tables, &[table]].concat())?)?);
    }
    Ok(theirs.iter().filter_map(|theirs| change(&ours, theirs)).collect())
}

/// Motions at the outputs of a linear-equivalent column, by record.
fn motions(scene: &Scene<'_>, effects: &[Box<dyn Effect>]) -> Result<Vec<Bins>> {
    let groups: Vec<usize> = (0..scene.groups.len()).collect();
    let n = scene.problem.array.outputs.len().max(1);
    let by_sensor =
        |motion: &[C64]| -> Bins { (0..n).map(|s| motion.iter().skip(s).step_by(n).copied().collect()).collect() };
    let found = scene.responses(effects, &groups, None)?;
    Ok(found.records.iter().flatten().map(|r| by_sensor(&r.motion)).collect())
}

/// What `theirs` have more than `ours`, if anything.
fn change(ours: &[Bins], theirs: &[Bins]) -> Option<Slope> {
    let mut power = [0.0, 0.0];
    let by_sensor =
        |(ours, theirs): (&Vec<C64>, &Vec<C64>)| -> Vec<C64> { ours.iter().zip(theirs).map(|(a, b)| b - a).collect() };
    let by_record = |(ours, theirs): (&Bins, &Bins)| -> Bins {
        let added: Bins = ours.iter().zip(theirs).map(by_sensor).collect();
        power[0] += ours.iter().flatten().map(C64::norm_sqr).sum::<f64>();
        power[1] += added.iter().flatten().map(C64::norm_sqr).sum::<f64>();
        added
    };
    let added: Vec<Bins> = ours.iter().zip(theirs).map(by_record).collect();
    (power[1] > NOTHING * NOTHING * power[0]).then(|| Arc::new(added))
}

/// An effect that makes Rayleigh damping of the damping that laws remember and that does not depend on frequency: the same ratio at the
/// fundamental frequency of the column and at five times that. `None` where no law has such damping.
fn rayleigh(profile: &Profile) -> Result<Option<Table>> {
    let alone = Profile { rayleigh: Rayleigh::default(), ..profile.clone() };
    let column = Column::new(&alone, &Analysis::default())?;
    let fundamental_hz = column.frequency_hz();
    let ratio = (1.0 - LEFT) * column.small_strain_damping_ratio(fundamental_hz);
    let asked = Rayleigh::of_ratio(ratio, [TAU * fundamental_hz, 5.0 * TAU * fundamental_hz]);
    let table = Table::from_iter([
        ("kind".to_string(), "frequency_dependent_damping".into()),
        ("ln_ratio".to_string(), LEFT.ln().into()),
        ("alpha_1_s".to_string(), asked.alpha_1_s.into()),
        ("beta_s".to_string(), asked.beta_s.into()),
    ]);
    Ok(effects::build(&table)?.refusal(profile).is_none().then_some(table))
}

/// Adds `strengths` of `conventions` to a prediction.
pub fn add(prediction: &mut Prediction, conventions: &[Slope], strengths: &[f64]) {
    for (convention, strength) in conventions.iter().zip(strengths).filter(|(_, w)| **w != 0.0) {
        for (p, change) in prediction.iter_mut().zip(convention.iter()) {
            for (y, d) in p.outputs.iter_mut().flatten().zip(change.iter().flatten()) {
                *y += d * *strength;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::Layer;
    use crate::effects::Situation;

    #[test]
    fn rayleigh_damping_is_that_of_the_law_at_two_frequencies_and_less_between() {
        let mut layer = Layer::plain("elastic", 20.0, 1900.0, 200.0);
        let law = toml::Table::from_iter([("damping_ratio".to_string(), 0.02.into())]);
        layer.law = Arc::new(law);
        let profile = Profile { elements: 20, ..Profile::plain(vec![layer]) };
        let table = rayleigh(&profile).unwrap().unwrap();
        let mut edited = profile.clone();
        effects::build(&table).unwrap().edit(&mut edited, &Situation::default());
        let ratio = |profile: &Profile, f: f64| {
            Column::new(profile, &Analysis::default()).unwrap().small_strain_damping_ratio(f)
        };
        for (f, share) in [(2.5, 1.0), (12.5, 1.0), (5.6, 0.75)] {
            let found = ratio(&edited, f) / ratio(&profile, f);
            assert!((found - share).abs() < 0.03, "{f} Hz: {found}");
        }
        let hysteretic = Profile::plain(vec![Layer::plain("sanisand", 20.0, 1900.0, 200.0)]);
        assert!(rayleigh(&hysteretic).unwrap().is_none());
    }
}
