//! What is estimated: nuisances with the priors of the declared tolerances, and the free parameters of effects.

use super::axes::Axis;
use super::problem::Problem;
use crate::effects::{self, Array, Effect, Free, Instance, Parameter};
use crate::error::{Error, Result};

/// Prior standard deviation of the ln of a reference strain.
const NONLINEARITY_LN: f64 = 0.15;
/// Prior standard deviation of the ln of all shear-wave velocities together: dispersion of mesh and time step.
const COMMON_VELOCITY_LN: f64 = 0.01;
/// Prior standard deviations within which a declared value is what it was declared to be; no null twin makes them fewer.
pub(super) const TOLERATED: f64 = 3.0;
/// Farthest a nuisance may be from its declared value, prior standard deviations. One in two thousand is farther; free to go
/// there, many thin layers together would imitate what is not declared.
pub(super) const MAX_DEVIATIONS: f64 = 3.5;
/// Step of finite differences, prior standard deviations of a nuisance.
const STEP: f64 = 0.001;
/// Most depth ranges with a velocity of their own.
const MAX_RANGES: usize = 20;

/// A declared value that may be off within its tolerance.
#[derive(Debug, Clone, PartialEq)]
pub struct Nuisance {
    /// The effect that moves it; one free parameter.
    pub instance: Instance,
    /// Prior standard deviation of its coordinate.
    pub deviation: f64,
    /// Whether it changes the motion of the ground as computed by more than a delay: the soil, how strongly and in which direction its
    /// base is shaken.
    pub is_shaken: bool,
}

impl Nuisance {
    fn new(kind: &'static str, target: &[(&str, toml::Value)], deviation: f64) -> Result<Self> {
        let parameter = parameter(kind)?;
        let target = target.iter().map(|(k, v)| (k.to_string(), v.clone())).collect();
        let free = vec![Free::new(parameter, parameter.zero.unwrap_or(0.0))];
        let is_shaken = effects::find(kind)?.catalogue.class.moves_column();
        Ok(Self { instance: Instance { kind, target, free }, deviation, is_shaken })
    }

    /// The parameter that moves.
    pub fn parameter(&self) -> &'static Parameter {
        self.instance.free[0].parameter
    }

    /// Whether `effect` is the same change of the ground.
    pub fn is_same(&self, effect: &Instance) -> bool {
        self.is_shaken && effect.free.len() == 1 && self.instance.is_same(effect)
    }

    fn zero(&self) -> f64 {
        self.parameter().coordinate(self.instance.free[0].zero.unwrap_or(0.0))
    }

    /// Prior standard deviations from the declared value at a `coordinate`.
    pub fn deviations(&self, coordinate: f64) -> f64 {
        (coordinate - self.zero()) / self.deviation
    }

    /// Its value `x` prior standard deviations from the declared one.
    pub fn value(&self, x: f64) -> f64 {
        self.parameter().value(self.zero() + self.deviation * x)
    }

    /// Its `[[effects]]` table there.
    pub fn table(&self, x: f64) -> toml::Table {
        self.instance.at(&[self.zero() + self.deviation * x])
    }

    /// For people.
    pub fn what(&self) -> String {
        format!("{} {}", self.instance.kind, self.instance.place()).trim().to_string()
    }
}

/// The first parameter of `kind`.
fn parameter(kind: &str) -> Result<&'static Parameter> {
    effects::find(kind)?
        .catalogue
        .parameters
        .first()
        .ok_or_else(|| Error::new(format!("effect `{kind}` has no strength to be a nuisance")))
}

/// The nuisances of `problem`.
///
/// # Errors
/// When an effect that stands for one is not registered.
pub fn nuisances(problem: &Problem) -> Result<Vec<Nuisance>> {
    let (array, t) = (&problem.array, &problem.tolerances);
    let mut found = Vec::new();
    for pair in ranges(array).windows(2) {
        let target = [("top_m", pair[0].into()), ("bottom_m", pair[1].into())];
        found.push(Nuisance::new("layer_velocity", &target, t.vs_ln)?);
    }
    let whole = [("top_m", 0.0.into()), ("bottom_m", array.profile.depth_m().into())];
    found.push(Nuisance::new("layer_velocity", &whole, COMMON_VELOCITY_LN)?);
    found.push(Nuisance::new("small_strain_damping", &[], t.damping_ln)?);
    found.push(Nuisance::new("nonlinearity", &[], NONLINEARITY_LN)?);
    for sensor in array.sensors() {
        let target = [("sensor", sensor.into())];
        let gain = Nuisance::new("sensor_gain", &target, t.gain_ln)?;
        found.push(Nuisance { is_shaken: sensor == array.input, ..gain });
        found.push(Nuisance::new("clock_offset", &target, t.clock_s)?);
        if array.components.len() > 1 {
            let turned = Nuisance::new("sensor_orientation", &target, t.orientation_deg)?;
            found.push(Nuisance { is_shaken: sensor == array.input, ..turned });
        }
    }
    found.retain(|n| n.deviation > 0.0);
    Ok(found)
}

/// Which of `nuisances` is the velocity of all layers together.
pub(super) fn common_velocity(nuisances: &[Nuisance]) -> Option<usize> {
    nuisances.iter().rposition(|n| n.instance.kind == "layer_velocity")
}

/// `[[effects]]` tables of `nuisances` so many prior standard deviations from their declared values.
pub fn nuisance_tables(nuisances: &[Nuisance], deviations: &[f64]) -> Vec<toml::Table> {
    nuisances.iter().zip(deviations).map(|(n, x)| n.table(*x)).collect()
}

/// Depths between which velocities move together: the layers, or ranges of equal travel time where there are too many.
pub fn ranges(array: &Array) -> Vec<f64> {
    let layers = &array.profile.layers;
    let travel_s = array.profile.travel_time_s();
    let (mut depth_m, mut passed_s) = (0.0, 0.0);
    let mut cuts = vec![0.0];
    for (i, layer) in layers.iter().enumerate() {
        depth_m += layer.thickness_m;
        passed_s += layer.thickness_m / layer.vs_m_s;
        let is_due = passed_s >= travel_s * cuts.len() as f64 / MAX_RANGES as f64;
        if layers.len() <= MAX_RANGES || is_due || i + 1 == layers.len() {
            cuts.push(depth_m);
        }
    }
    cuts
}

/// Nuisances and effects estimated together; the vector holds nuisances in prior standard deviations, then coordinates.
#[derive(Debug, Clone)]
pub struct Unknowns<'a> {
    /// Nuisances, always all of them.
    pub nuisances: &'a [Nuisance],
    /// Effects, in the order of their parameters.
    pub effects: Vec<Instance>,
    /// Effects that neighbours of the nonlinear column follow; with them, the fast column keeps what is declared of the ground's
    /// motion, because the neighbours follow that. `None` where there are no neighbours.
    pub axes: Option<&'a [Axis]>,
}

/// Unknowns as anchors and neighbours know them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Placed {
    /// Nuisances, then effects.
    pub x: Vec<f64>,
    /// Coordinate of the effect on each axis; `None` where it is not there.
    pub axes: Vec<Option<f64>>,
}

impl Placed {
    /// Unknowns none of which is on an axis.
    pub fn plain(x: &[f64]) -> Self {
        Self { x: x.to_vec(), axes: Vec::new() }
    }
}

impl Unknowns<'_> {
    /// Length of the vector.
    pub fn len(&self) -> usize {
        self.nuisances.len() + self.n_effect()
    }

    /// Free parameters of the effects.
    pub fn n_effect(&self) -> usize {
        self.effects.iter().map(|e| e.free.len()).sum()
    }

    /// Place of the first parameter of the effect at `index`.
    pub fn start(&self, index: usize) -> usize {
        self.nuisances.len() + self.effects[..index].iter().map(|e| e.free.len()).sum::<usize>()
    }

    /// `[[effects]]` tables at `x`, nuisances first.
    pub fn tables(&self, x: &[f64]) -> Vec<toml::Table> {
        let (nuisances, others) = x.split_at(self.nuisances.len());
        let mut tables = nuisance_tables(self.nuisances, nuisances);
        tables.extend(self.effect_tables(others));
        tables
    }

    /// Those of the effects alone.
    fn effect_tables(&self, mut x: &[f64]) -> Vec<toml::Table> {
        let table = |effect: &Instance| {
            let (own, others) = x.split_at(effect.free.len());
            x = others;
            effect.at(own)
        };
        self.effects.iter().map(table).collect()
    }

    /// The nuisance that is the same thing as `effect`, where neighbours follow it: they follow the effect with it. What effects
    /// do to velocities they follow in any case.
    pub fn followed_as(&self, effect: &Instance) -> Option<usize> {
        let is_other = effect.kind != "layer_velocity" && effect.free.len() == 1;
        let is_followed = self.axes.is_some() && self.axis(effect).is_none();
        self.nuisances.iter().position(|n| is_followed && n.is_shaken && is_other && n.instance.is_same(effect))
    }

    /// Whether unknown `i` moves nothing but what neighbours follow.
    pub fn is_followed(&self, i: usize) -> bool {
        if let Some(nuisance) = self.nuisances.get(i) {
            return self.axes.is_some() && nuisance.is_shaken;
        }
        let mut end = self.nuisances.len();
        let effect = self.effects.iter().find(|e| {
            end += e.free.len();
            i < end
        });
        effect.is_some_and(|e| self.followed_as(e).or(self.axis(e)).is_some())
    }

    /// The axis along which neighbours follow `effect`.
    pub fn axis(&self, effect: &Instance) -> Option<usize> {
        self.axes?.iter().position(|axis| axis.instance == *effect)
    }

    /// `x` with what is followed as a nuisance among these, and nothing where it was; what has an axis on it.
    pub fn placed(&self, x: &[f64]) -> Placed {
        let mut placed = Placed { x: x.to_vec(), axes: vec![None; self.axes.map_or(0, <[Axis]>::len)] };
        let mut at = self.nuisances.len();
        for effect in &self.effects {
            if let Some(nuisance) = self.followed_as(effect) {
                placed.x[nuisance] += self.nuisances[nuisance].deviations(x[at]);
                placed.x[at] = 0.0;
            }
            if let Some((i, axis)) = self.axis(effect).zip(self.axes).map(|(i, axes)| (i, &axes[i])) {
                let mut coordinate = x[at];
                if let Some(n) = self.nuisances.iter().position(|n| n.is_same(effect)) {
                    // Both go along the axis.
                    coordinate += self.nuisances[n].deviation * (x[n] - axis.nuisance);
                    placed.x[n] = axis.nuisance;
                }
                placed.axes[i] = Some(coordinate);
            }
            at += effect.free.len();
        }
        placed
    }

    /// The declared effects and those at `x` that the fast column and the sensors take, built.
    ///
    /// # Errors
    /// When a value is out of the range of its effect.
    pub fn build(&self, declared: &[toml::Table], x: &[f64]) -> Result<Vec<Box<dyn Effect>>> {
        let mut effects = effects::build_all(declared)?;
        let (nuisances, others) = x.split_at(self.nuisances.len());
        let taken = self.nuisances.iter().zip(nuisances).filter(|(n, _)| !(self.axes.is_some() && n.is_shaken));
        let is_fast = |e: &Instance| self.followed_as(e).is_none() && self.axis(e).is_none();
        let own = self.effects.iter().zip(self.effect_tables(others)).filter(|(e, _)| is_fast(e));
        for table in taken.map(|(n, x)| n.table(*x)).chain(own.map(|(_, table)| table)) {
            effects.push(effects::build(&table)?);
        }
        Ok(effects)
    }

    /// Smallest and largest value of each: [`MAX_DEVIATIONS`] for a nuisance, its own for an effect.
    pub fn bounds(&self) -> Vec<[f64; 2]> {
        let nuisances = self.nuisances.iter().map(|_| [-MAX_DEVIATIONS, MAX_DEVIATIONS]);
        nuisances.chain(self.effects.iter().flat_map(Instance::bounds)).collect()
    }

    /// Moves `x` into the bounds.
    pub fn clip(&self, x: &mut [f64]) {
        x.iter_mut().zip(self.bounds()).for_each(|(x, [low, high])| *x = x.clamp(low, high));
    }

    /// Nuisances that are the same thing as an effect, with the index of that: no motion tells the two apart, and the effect has
    /// no prior that would hold it.
    pub fn twice(&self) -> Vec<[usize; 2]> {
        let mut at = self.nuisances.len();
        let same = |effect: &Instance| {
            let own = at;
            at += effect.free.len();
            let is_same = |n: &Nuisance| effect.free.len() == 1 && n.instance.is_same(effect);
            Some([self.nuisances.iter().position(is_same)?, own])
        };
        self.effects.iter().filter_map(same).collect()
    }

    /// Leaves to the effects what nuisances share with them: the same motions.
    pub fn gather(&self, x: &mut [f64]) {
        let bounds = self.bounds();
        for [nuisance, effect] in self.twice() {
            let deviation = self.nuisances[nuisance].deviation;
            let own = (x[effect] + deviation * x[nuisance]).clamp(bounds[effect][0], bounds[effect][1]);
            x[nuisance] -= (own - x[effect]) / deviation;
            x[effect] = own;
        }
    }

    /// What counts as one step of each: a prior standard deviation of a nuisance, a typical size of an effect.
    pub fn deviations(&self) -> Vec<f64> {
        let effects = self.effects.iter().flat_map(|e| &e.free).map(|f| f.size);
        self.nuisances.iter().map(|_| 1.0).chain(effects).collect()
    }

    /// Steps of finite differences: small, and the same for a nuisance and the effect that is the same thing, or the curvature of
    /// two ways to the same motion would tell them apart.
    pub fn steps(&self) -> Vec<f64> {
        let own = |e: &Instance| -> Vec<f64> {
            let same = self.nuisances.iter().find(|n| n.instance.is_same(e));
            let step = |f: &Free| same.map_or(0.5 * STEP * f.size, |n| STEP * n.deviation);
            e.free.iter().map(step).collect()
        };
        self.nuisances.iter().map(|_| STEP).chain(self.effects.iter().flat_map(own)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_that_is_a_tolerance_goes_where_that_goes() {
        let nuisances = vec![
            Nuisance::new("nonlinearity", &[], 0.15).unwrap(),
            Nuisance::new("small_strain_damping", &[], 0.3).unwrap(),
        ];
        let effects = vec![nuisances[0].instance.clone()];
        let followed = Unknowns { nuisances: &nuisances, effects, axes: Some(&[]) };
        let x = [0.5, -1.0, -0.6];
        let placed = followed.placed(&x).x;
        assert!((placed[0] - (0.5 - 0.6 / 0.15)).abs() < 1e-12 && placed[1..] == [-1.0, 0.0]);
        assert_eq!((followed.build(&[], &x).unwrap().len(), followed.tables(&x).len()), (0, 3));
        let alone = Unknowns { axes: None, ..followed.clone() };
        let mut gathered = x.to_vec();
        followed.gather(&mut gathered);
        assert!(gathered[0].abs() < 1e-12 && gathered[1] == -1.0 && (gathered[2] - (0.5 * 0.15 - 0.6)).abs() < 1e-12);
        assert!((followed.placed(&gathered).x[0] - placed[0]).abs() < 1e-12);
        assert_eq!((alone.placed(&x).x, alone.build(&[], &x).unwrap().len()), (x.to_vec(), 3));
    }
}
