//! Declared values that may be off within their tolerances: how far a coordinate moves the parameter of an effect.

use super::{FARTHEST, STEP};
use crate::column::{Analysis, Column, Profile, Rayleigh};
use crate::effects::{self, Free, Instance, Situation, Tolerated};
use crate::error::{Error, Result};
use std::f64::consts::TAU;
use toml::Table;

/// A multiplier of damping with which its unit is measured.
const TWICE: f64 = 2.0;
/// Least share of a declared damping.
const LEAST_DAMPING: f64 = 0.05;
/// Most of the damping that laws remember that Rayleigh damping takes the place of: what effects change of it, none of it would not have.
const MOST_REPLACED: f64 = 0.95;
/// Prior standard deviation of the ln of the frequencies at which Rayleigh damping in its place meets the declared ratio: programs ask for
/// it at multiples of the fundamental frequency or at the ends of a band.
const SHIFT_LN: f64 = 0.5;

/// A declared value that may be off within its tolerance: the effect that moves it.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerance {
    /// The effect; one free parameter.
    pub instance: Instance,
    /// Prior standard deviation of its coordinate.
    pub deviation: f64,
    /// That of its value over what is declared, beside the deviation of the coordinate, where this one is a ln; else nothing.
    absolute: f64,
    /// What else moves in its table, and how far by deviation.
    pub(super) beside: Vec<(&'static str, f64)>,
    /// Smallest and largest coordinate.
    pub(super) bounds: [f64; 2],
    /// Whether what it does and the effect itself add up: where less of nothing is refused, what stands in for it is on top.
    pub(super) adds_up: bool,
}

impl Tolerance {
    /// That of what is declared, in a column of `profile`.
    pub(super) fn of(
        Tolerated { instance, deviation, damping_ratio, .. }: Tolerated,
        profile: &Profile,
    ) -> Result<Self> {
        let zero = instance.zero().unwrap_or_default();
        let less: Vec<f64> = zero.iter().zip(&instance.free).map(|(zero, free)| zero - free.size).collect();
        let adds_up = instance.acts_on(profile, &less);
        let own = Self { adds_up, ..Self::new(instance, deviation) };
        if damping_ratio == 0.0 {
            return Ok(own);
        }
        let unit = damping_unit(&own.instance, profile)?;
        Ok(Self { absolute: if unit > 0.0 { damping_ratio / unit } else { 0.0 }, ..own })
    }

    fn new(instance: Instance, deviation: f64) -> Self {
        Self { instance, deviation, absolute: 0.0, beside: Vec::new(), bounds: [-FARTHEST, FARTHEST], adds_up: true }
    }

    /// `[[effects]]` table `z` prior standard deviations from what is declared.
    pub(super) fn table(&self, z: f64) -> Table {
        let mut table = self.instance.at(&[self.coordinate(z)]);
        for (key, by_deviation) in &self.beside {
            table.insert((*key).into(), (by_deviation * z).into());
        }
        table
    }

    /// Coordinate of the effect's parameter `z` prior standard deviations from what is declared.
    ///
    /// ```text
    /// dm/dz = √((a m)² + b²),   m(0) = 1:   m = b/a · sinh(a z + asinh(a/b))  (1)
    /// ```
    ///
    /// for a multiplier m with the deviation a of its ln and an absolute one of b.
    pub fn coordinate(&self, z: f64) -> f64 {
        let p = self.instance.free[0].parameter;
        let (a, b) = (self.deviation, self.absolute);
        let moved = if b > 0.0 { (b / a * (a * z + (a / b).asinh()).sinh()).max(LEAST_DAMPING).ln() } else { a * z };
        p.coordinate(p.zero.unwrap_or(0.0)) + moved
    }

    /// How far `z` goes for one unit of that coordinate.
    pub(super) fn reach(&self, z: f64) -> f64 {
        let ends = [0.5, -0.5].map(|h| self.coordinate(z + h * STEP));
        STEP / (ends[0] - ends[1])
    }
}

/// What one unit of a multiplier of damping is in damping ratio, which the column says: the declared ratio, or that of the effect where
/// none is declared.
fn damping_unit(multiplier: &Instance, profile: &Profile) -> Result<f64> {
    let mut more = profile.clone();
    effects::build(&multiplier.table(&[TWICE]))?.edit(&mut more, &Situation::default());
    let declared = Column::new(profile, &Analysis::default())?;
    let frequency_hz = declared.frequency_hz();
    let ratio = |column: &Column| column.small_strain_damping_ratio(frequency_hz);
    Ok((ratio(&Column::new(&more, &Analysis::default())?) - ratio(&declared)) / (TWICE - 1.0))
}

/// Rayleigh damping in place of the damping that laws remember and that does not depend on frequency, as other programs have it for the
/// same ratio: how much of it and where it meets that ratio, at first at the fundamental frequency of the column and at five
/// times that. None where no law has such damping.
pub(super) fn rayleigh(profile: &Profile) -> Result<Vec<Tolerance>> {
    let alone = Profile { rayleigh: Rayleigh::default(), ..profile.clone() };
    let column = Column::new(&alone, &Analysis::default())?;
    let fundamental_hz = column.frequency_hz();
    let ratio = column.small_strain_damping_ratio(fundamental_hz);
    let asked = Rayleigh::of_ratio(ratio, [TAU * fundamental_hz, 5.0 * TAU * fundamental_hz]);
    let of = |name: &str, deviation| -> Result<Tolerance> {
        let parameters = effects::find(effects::FREQUENCY_DEPENDENT_DAMPING)?.catalogue.parameters;
        let none = || Error::new(format!("damping that depends on frequency has no `{name}`"));
        let parameter = parameters.iter().find(|p| p.name == name).ok_or_else(none)?;
        let free = vec![Free::new(parameter, parameter.zero.unwrap_or(0.0))];
        let instance = Instance::new(effects::FREQUENCY_DEPENDENT_DAMPING, [], free);
        Ok(Tolerance::new(instance, deviation))
    };
    let share = Tolerance {
        beside: vec![("beta_s", asked.beta_s), ("replaced", 1.0)],
        bounds: [0.0, MOST_REPLACED],
        ..of("alpha_1_s", asked.alpha_1_s)?
    };
    let has_memory = effects::build(&share.table(1.0))?.refusal(profile).is_none();
    if has_memory { Ok(vec![share, of("ln_shift", SHIFT_LN)?]) } else { Ok(Vec::new()) }
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{Truth, problem};
    use super::*;
    use crate::column::Layer;
    use crate::effects::Tolerances;
    use std::sync::Arc;

    #[test]
    fn rayleigh_damping_is_that_of_the_law_at_two_frequencies_and_less_between() {
        let mut layer = Layer::plain("elastic", 20.0, 1900.0, 200.0);
        layer.law = Arc::new(Table::from_iter([("damping_ratio".to_string(), 0.02.into())]));
        let profile = Profile { elements: 20, ..Profile::plain(vec![layer]) };
        let ratio = |profile: &Profile, f: f64| {
            Column::new(profile, &Analysis::default()).unwrap().small_strain_damping_ratio(f)
        };
        let tolerances = rayleigh(&profile).unwrap();
        let moved = (2.5 * SHIFT_LN.exp(), 12.5 * SHIFT_LN.exp());
        let at = |of: f64, shift: f64, f: f64| {
            let mut edited = profile.clone();
            for (tolerance, z) in tolerances.iter().zip([of, shift]).filter(|(_, z)| *z != 0.0) {
                effects::build(&tolerance.table(z)).unwrap().edit(&mut edited, &Situation::default());
            }
            ratio(&edited, f) / ratio(&profile, f)
        };
        // A part of it keeps the ratio where all of it does.
        for (of, shift, f, share) in [
            (1.0, 0.0, 2.5, 1.0),
            (0.4, 0.0, 2.5, 1.0),
            (1.0, 0.0, 12.5, 1.0),
            (1.0, 0.0, 5.6, 0.75),
            (0.4, 0.0, 5.6, 0.9),
            (1.0, 1.0, moved.0, 1.0),
            (1.0, 1.0, moved.1, 1.0),
        ] {
            let found = at(of, shift, f);
            assert!((found - share).abs() < 0.03, "{of} of it at {f} Hz: {found}");
        }
        let hysteretic = Profile::plain(vec![Layer::plain("sanisand", 20.0, 1900.0, 200.0)]);
        assert!(rayleigh(&hysteretic).unwrap().is_empty());
    }

    #[test]
    fn what_programs_make_of_damping_is_the_same_whether_a_ratio_is_declared_or_none() {
        // A fraction of one per cent, whatever the unit of the multiplier is.
        let declared = |kind: &str, damping_ratio: Option<f64>| {
            let mut array = problem(&Truth::default()).array;
            let mut layer = Layer::plain(kind, 40.0, 2000.0, 200.0);
            layer.law = Arc::new(damping_ratio.map(|r| ("damping_ratio".to_string(), r.into())).into_iter().collect());
            array.profile = Profile { elements: 20, ..Profile::plain(vec![layer]) };
            array
        };
        for (kind, ratio) in [("elastic", Some(0.01)), ("elastic", Some(0.04)), ("sanisand", None), ("cam_clay", None)]
        {
            let array = declared(kind, ratio);
            // So close to nothing that it is linear.
            let tolerances = Tolerances { damping_ln: 1e-6, ..Tolerances::default() };
            let tolerance =
                Tolerance::of(effects::tolerated(&array, &tolerances).swap_remove(0), &array.profile).unwrap();
            let moved = |z: f64| {
                let mut profile = array.profile.clone();
                effects::build(&tolerance.table(z)).unwrap().edit(&mut profile, &Situation::default());
                let column = Column::new(&profile, &Analysis::default()).unwrap();
                column.small_strain_damping_ratio(
                    Column::new(&array.profile, &Analysis::default()).unwrap().frequency_hz(),
                )
            };
            let found = moved(1.0) - moved(0.0);
            assert!((found / 0.003 - 1.0).abs() < 0.1, "{kind} {ratio:?}: {found}");
        }
    }
}
