//! One parameter space: declared values that may be off within their tolerances, and the parameters of effects, each with a prior.
//!
//! | parameter                        | coordinate                | prior                                            |
//! |----------------------------------|---------------------------|--------------------------------------------------|
//! | depth modes of ln Vs             | standard deviations       | N(0, 1), from `tolerances.vs_ln` layer by layer and [`super::depth_modes::COMMON_VELOCITY_LN`] for all together |
//! | small-strain damping, depth of boundaries, reference strain, shape of curves; gain, clock, depth, azimuth of a sensor | standard deviations | N(0, 1) of what [`effects::tolerated`] has |
//! | share of Rayleigh damping in place of one that laws remember | – | N(0, 1) between nothing and `MOST_REPLACED` of [`rayleigh`] |
//! | frequencies at which it meets the declared ratio | standard deviations | N(0, 1), `SHIFT_LN` of [`rayleigh`] |
//! | share of what strays that is of another origin | –   | N(0, [`ADDED_SHARE`]) between nothing and all    |
//! | a modulus without dispersion | standard deviations | N(0, 1) (`convention`)                             |
//! | strength of an effect            | that of its catalogue     | N(value of no effect, [`WIDE`] times `Free::size`); half of it where only one sign exists |
//! | what shapes an effect            | that of its catalogue     | N(start of the place, `Free::size`)              |

mod tolerance;

use super::convention::Slope;
use super::depth_modes::{modes, ranges};
use crate::diagnosis::Problem;
use crate::effects::{self, Free, Instance, LAYER_VELOCITY_LN, Tolerances, velocity_between};
use crate::error::Result;
use faer::Mat;
use std::ops::Range;
pub use tolerance::Tolerance;
use tolerance::rayleigh;
use toml::Table;

/// Standard deviations of the prior of a strength, as multiples of its typical size.
pub const WIDE: f64 = 1.5;
/// Prior standard deviation of the share of what strays that is of another origin: records of strong motion are triggered by it, and what
/// strays from its base is mostly its own motion.
const ADDED_SHARE: f64 = 0.1;
/// Farthest that a declared value is within its tolerance, standard deviations.
const FARTHEST: f64 = Tolerances::FARTHEST;
/// Step of a finite difference, prior standard deviations: records tell some coordinates to a hundredth of them, and replays are smooth to
/// less.
const STEP: f64 = 0.02;

/// What is off in all of one kind, by an effect and by declared values.
#[derive(Debug, Clone)]
pub struct Total {
    /// In the coordinate of the effect.
    pub coordinate: f64,
    /// How it changes with each coordinate of the model.
    pub slopes: Vec<f64>,
}

/// What may be off in the declared site.
#[derive(Debug, Clone)]
pub struct Declared {
    /// Depths between which velocities move together, m.
    pub cuts_m: Vec<f64>,
    /// ln of the velocity of each range by depth mode, `[range][mode]`, at one prior standard deviation of the mode.
    pub modes: Vec<Vec<f64>>,
    /// The other tolerances.
    pub others: Vec<Tolerance>,
    /// What other programs make of the same column, at one prior standard deviation: coordinates that no effect stands for.
    pub conventions: Vec<Slope>,
    /// How far apart the longest record tells frequencies, Hz.
    resolution_hz: f64,
    input: String,
}

impl Declared {
    /// The tolerances of `problem`.
    ///
    /// # Errors
    /// When an effect that stands for one is not registered.
    pub fn new(problem: &Problem) -> Result<Self> {
        let (array, t) = (&problem.array, &problem.tolerances);
        let cuts_m = ranges(array);
        let modes = modes(array, &cuts_m, t.vs_ln);
        // What damping depends on before how much there is: a multiplier is of all of it.
        let mut others = rayleigh(&array.profile)?;
        for own in effects::tolerated(array, t) {
            others.push(Tolerance::of(own, &array.profile)?);
        }
        let longest_s = problem.events.iter().map(|e| e.dt_s * e.input.len() as f64).fold(f64::MIN_POSITIVE, f64::max);
        let resolution_hz = 1.0 / longest_s;
        Ok(Self { cuts_m, modes, others, conventions: Vec::new(), resolution_hz, input: array.input.clone() })
    }

    /// The same, and what other programs make of the column.
    pub fn with_conventions(self, conventions: Vec<Slope>) -> Self {
        Self { conventions, ..self }
    }

    /// Depth modes.
    pub fn n_mode(&self) -> usize {
        self.modes.first().map_or(0, Vec::len)
    }

    /// Number of coordinates.
    pub fn len(&self) -> usize {
        self.n_mode() + self.others.len() + 1 + self.conventions.len()
    }

    /// Strengths of the conventions at the coordinates `z`.
    pub fn convention_strengths<'z>(&self, z: &'z [f64]) -> &'z [f64] {
        &z[self.added() + 1..self.len()]
    }

    /// Coordinate of the share of what strays that is of another origin.
    pub fn added(&self) -> usize {
        self.n_mode() + self.others.len()
    }

    /// ln of the factor on the velocity of each range at the coordinates `z`.
    pub fn ln_factors(&self, z: &[f64]) -> Vec<f64> {
        self.modes.iter().map(|row| row.iter().zip(z).map(|(m, z)| m * z).sum()).collect()
    }

    /// `[[effects]]` tables at the coordinates `z`; what is as declared is left out.
    pub fn tables(&self, z: &[f64]) -> Vec<Table> {
        self.tables_beside(z, &[])
    }

    /// The same without what `effects` have in their [`Model::total`].
    pub fn tables_beside(&self, z: &[f64], effects: &[&Instance]) -> Vec<Table> {
        let mut factors = self.ln_factors(z);
        let mut z = z.to_vec();
        for effect in effects {
            match self.same_range(effect) {
                Some(rows) => {
                    let ln = self.mean_over(&rows, |row| factors[row]);
                    rows.for_each(|row| factors[row] -= ln);
                }
                None => self.same_other(effect).into_iter().for_each(|i| z[self.n_mode() + i] = 0.0),
            }
        }
        let ranges = self.cuts_m.windows(2).zip(factors).filter(|(_, ln)| *ln != 0.0);
        let mut tables: Vec<Table> = ranges
            // The range of the effect; velocities beyond it are no tolerance.
            .map(|(pair, ln)| {
                velocity_between([pair[0], pair[1]]).table(&[ln.clamp(-LAYER_VELOCITY_LN, LAYER_VELOCITY_LN)])
            })
            .collect();
        let others = self.others.iter().zip(&z[self.n_mode()..]).filter(|(_, z)| **z != 0.0);
        tables.extend(others.map(|(o, z)| o.table(*z)));
        tables
    }

    /// The one of the other tolerances that does what the only parameter of `effect` does.
    fn same_other(&self, effect: &Instance) -> Option<usize> {
        self.others.iter().position(|o| o.beside.is_empty() && o.instance.is_one(effect))
    }

    /// The ranges of velocities that `effect` moves, where that is what it does and it ends where they end.
    fn same_range(&self, effect: &Instance) -> Option<Range<usize>> {
        let depth = |key: &str| effect.target.get(key).and_then(toml::Value::as_float);
        let (top_m, bottom_m) = (depth("top_m")?, depth("bottom_m")?);
        let cut = |depth_m: f64| self.cuts_m.iter().position(|cut_m| (cut_m - depth_m).abs() < 1e-6);
        let is_velocity = self.n_mode() > 0 && effect.is_alike(&velocity_between([top_m, bottom_m]));
        is_velocity.then(|| Some(cut(top_m)?..cut(bottom_m)?)).flatten().filter(|rows| !rows.is_empty())
    }

    /// Mean over the depth of some ranges.
    fn mean_over(&self, rows: &Range<usize>, of: impl Fn(usize) -> f64) -> f64 {
        let [top_m, bottom_m] = [rows.start, rows.end].map(|cut| self.cuts_m[cut]);
        rows.clone().map(|row| (self.cuts_m[row + 1] - self.cuts_m[row]) * of(row)).sum::<f64>() / (bottom_m - top_m)
    }

    /// How far declared values at `z` are moved in the only parameter of `effect`, and how that changes with each of them; none where no
    /// declared value does the same, or what it does is not added to the effect.
    fn moved(&self, effect: &Instance, z: &[f64]) -> Option<Total> {
        let mut slopes = vec![0.0; self.len()];
        if let Some(rows) = self.same_range(effect) {
            let factors = self.ln_factors(z);
            (0..self.n_mode()).for_each(|k| slopes[k] = self.mean_over(&rows, |row| self.modes[row][k]));
            return Some(Total { coordinate: self.mean_over(&rows, |row| factors[row]), slopes });
        }
        let i = self.same_other(effect).filter(|i| self.others[*i].adds_up)?;
        let (at, own) = (self.n_mode() + i, &self.others[i]);
        slopes[at] = 1.0 / own.reach(z[at]);
        Some(Total { coordinate: own.coordinate(z[at]) - own.coordinate(0.0), slopes })
    }

    /// Coordinates that at `z` do what the only parameter of `effect` does, and how far they go for one unit of it; none where what is
    /// declared cannot stand in for it.
    fn same_as(&self, effect: &Instance, z: &[f64]) -> Vec<(usize, f64)> {
        let Some(rows) = self.same_range(effect) else {
            let Some(i) = self.same_other(effect) else { return Vec::new() };
            let at = self.n_mode() + i;
            return vec![(at, self.others[i].reach(z[at]))];
        };
        // Modes that together move the layer and nothing else, if there are any.
        let inside: Vec<f64> = (0..self.modes.len()).map(|row| f64::from(u8::from(rows.contains(&row)))).collect();
        let m = self.n_mode();
        let product = |a: usize, b: usize| self.modes.iter().map(|row| row[a] * row[b]).sum::<f64>();
        let side: Vec<f64> = (0..m).map(|k| self.modes.iter().zip(&inside).map(|(row, w)| row[k] * w).sum()).collect();
        let Some(shares) = super::algebra::solved(&Mat::from_fn(m, m, product), &side) else { return Vec::new() };
        let reached = self.ln_factors(&shares);
        let is_same = inside.contains(&1.0) && reached.iter().zip(&inside).all(|(a, b)| (a - b).abs() < 1e-6);
        if is_same { shares.into_iter().enumerate().collect() } else { Vec::new() }
    }

    /// Smallest and largest value of coordinate `i`.
    fn bounds(&self, i: usize) -> [f64; 2] {
        if i == self.added() {
            return [0.0, 1.0];
        }
        let other = i.checked_sub(self.n_mode()).and_then(|i| self.others.get(i));
        other.map_or([-FARTHEST, FARTHEST], |o| o.bounds)
    }

    /// Whether coordinate `i` changes how the column is shaken.
    fn is_replayed(&self, i: usize) -> bool {
        let others = i.checked_sub(self.n_mode());
        others.is_none_or(|i| self.others.get(i).is_some_and(|o| is_replayed(&o.instance, &self.input)))
    }
}

/// Whether an effect changes the motion of the column, and not only what output sensors make of it.
fn is_replayed(instance: &Instance, input: &str) -> bool {
    instance.changes_column()
        || ["sensor", "with"].iter().any(|key| instance.target.get(*key).and_then(toml::Value::as_str) == Some(input))
}

/// The declared site with some effects, all of it estimated together.
#[derive(Debug, Clone)]
pub struct Model<'a> {
    /// What may be off.
    pub declared: &'a Declared,
    /// Effects that the site has besides.
    pub effects: Vec<Instance>,
}

impl<'a> Model<'a> {
    /// Number of coordinates: tolerances, then the free parameters of each effect.
    pub fn len(&self) -> usize {
        self.declared.len() + self.effects.iter().map(|e| e.free.len()).sum::<usize>()
    }

    /// First coordinate of effect `index`.
    pub fn start(&self, index: usize) -> usize {
        self.declared.len() + self.effects[..index].iter().map(|e| e.free.len()).sum::<usize>()
    }

    /// Coordinates of effect `index`.
    pub fn coordinates_of(&self, index: usize) -> Range<usize> {
        let start = self.start(index);
        start..start + self.effects[index].free.len()
    }

    /// Index of the effect that is `instance`, if it is there.
    pub fn index_of(&self, instance: &Instance) -> Option<usize> {
        self.effects.iter().position(|e| e.is_one(instance))
    }

    /// Whether every effect has a name.
    pub fn is_named(&self) -> bool {
        self.effects.iter().all(Instance::is_named)
    }

    fn free(&self) -> impl Iterator<Item = &Free> {
        self.effects.iter().flat_map(|e| &e.free)
    }

    /// `[[effects]]` tables at the coordinates `x`: tolerances first.
    pub fn tables(&self, x: &[f64]) -> Vec<Table> {
        let (z, mut own) = x.split_at(self.declared.len());
        let mut tables = self.declared.tables(z);
        for effect in &self.effects {
            let (these, others) = own.split_at(effect.free.len());
            own = others;
            tables.push(effect.at(these));
        }
        tables
    }

    /// Tables of the effects alone.
    pub fn effect_table(&self, x: &[f64], index: usize) -> Table {
        let start = self.start(index);
        self.effects[index].at(&x[start..start + self.effects[index].free.len()])
    }

    /// The only parameter of effect `index` together with what declared values do of the same, which is what is off in all; none where no
    /// declared value does, where the two are not one after the other, as what else is done to a sensor may come between, and where they
    /// are beyond what one effect may be.
    ///
    /// How much of it is within a tolerance and how much beyond is for the priors of both to say and not for the records.
    pub fn total(&self, x: &[f64], index: usize) -> Option<Total> {
        let own = &self.effects[index];
        let sensor = |effect: &Instance| effect.target.get("sensor").cloned();
        let is_between = |other: &Instance| sensor(own).is_some() && sensor(other) == sensor(own) && !other.is_one(own);
        if own.free.len() != 1 || self.effects.iter().any(is_between) {
            return None;
        }
        let mut total = self.declared.moved(own, x)?;
        total.slopes.resize(self.len(), 0.0);
        total.slopes[self.start(index)] = 1.0;
        total.coordinate += x[self.start(index)];
        let [low, high] = own.bounds()[0];
        (low..=high).contains(&total.coordinate).then_some(total)
    }

    /// Coordinates of effects for which declared values can stand in at `x`: coordinate, and [`Declared::same_as`].
    pub fn same(&self, x: &[f64]) -> Vec<(usize, Vec<(usize, f64)>)> {
        let single = self.effects.iter().enumerate().filter(|(_, e)| e.free.len() == 1);
        let all = single.map(|(i, e)| (self.start(i), self.declared.same_as(e, x)));
        all.filter(|(_, parts)| !parts.is_empty()).collect()
    }

    /// Mean and standard deviation of the prior of each coordinate.
    pub fn prior(&self) -> Vec<[f64; 2]> {
        let effects = self.free().map(prior_of);
        let sd = |i: usize| if i == self.declared.added() { ADDED_SHARE } else { 1.0 };
        (0..self.declared.len()).map(|i| [0.0, sd(i)]).chain(effects).collect()
    }

    /// Smallest and largest value of each coordinate.
    pub fn bounds(&self) -> Vec<[f64; 2]> {
        let effects = self.effects.iter().flat_map(Instance::bounds);
        (0..self.declared.len()).map(|i| self.declared.bounds(i)).chain(effects).collect()
    }

    /// How far each coordinate can move either way from `x`.
    pub fn room(&self, x: &[f64]) -> Vec<[f64; 2]> {
        self.bounds().into_iter().zip(x).map(|([low, high], x)| [low - x, high - x]).collect()
    }

    /// Whether coordinate `i` is at an end of its range at `x`: closer to it than a finite difference is long.
    pub fn is_at_end(&self, x: &[f64], i: usize) -> bool {
        let (step, [low, high]) = (STEP * self.prior()[i][1], self.bounds()[i]);
        (x[i] - low).min(high - x[i]) < step
    }

    /// Whether the declared value `i` is at the end of its tolerance at `x`: it stands in for an effect.
    pub fn is_strained(&self, x: &[f64], i: usize) -> bool {
        i < self.declared.len() && x[i].abs() > FARTHEST - STEP
    }

    /// Whether coordinate `i` changes how the column is shaken.
    pub fn is_replayed(&self, i: usize) -> bool {
        if i < self.declared.len() {
            return self.declared.is_replayed(i);
        }
        let at = (0..self.effects.len()).rposition(|e| self.start(e) <= i).unwrap_or(0);
        is_replayed(&self.effects[at], &self.declared.input)
    }

    /// Step of a finite difference in coordinate `i` at `x`, away from the nearer bound.
    pub fn step(&self, x: &[f64], i: usize) -> f64 {
        let [low, high] = self.bounds()[i];
        // The phase of a line turns within the resolution of the records.
        let line = |(e, effect): (usize, &Instance)| Some(self.start(e) + effect.line()?);
        let is_line = self.effects.iter().enumerate().filter_map(line).any(|line| line == i);
        let size = STEP * if is_line { self.declared.resolution_hz } else { self.prior()[i][1] };
        let toward = if high - x[i] >= x[i] - low { 1.0 } else { -1.0 };
        toward * size.min(0.5 * (high - low))
    }
}

/// Mean and standard deviation of the prior of a free parameter's coordinate.
pub fn prior_of(free: &Free) -> [f64; 2] {
    match free.zero {
        Some(zero) => [free.parameter.coordinate(zero), WIDE * free.size],
        None => [free.parameter.coordinate(free.start), free.size],
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, problem};
    use super::*;
    use crate::effects::Situation;

    #[test]
    fn what_is_off_in_all_is_what_effect_and_declared_values_make_of_the_column() {
        let problem = problem(&Truth::default());
        let declared = Declared::new(&problem).unwrap();
        let all = effects::instances(&problem.array);
        let edited = |tables: &[Table]| {
            let mut profile = problem.array.profile.clone();
            effects::apply(tables, &mut profile, &Situation::default()).unwrap();
            let damping = profile.layers[0].law["damping_ratio"].as_float().unwrap();
            (profile.layers.iter().map(|l| l.vs_m_s).collect::<Vec<_>>(), damping)
        };
        let mut z: Vec<f64> = (0..declared.len()).map(|i| 0.3 - 0.2 * (i % 4) as f64).collect();
        z[declared.added()] = 0.1;
        for (instance, at) in [
            (all.iter().find(|i| i.kind == "small_strain_damping").unwrap().clone(), 0.7),
            (velocity_between([0.0, 40.0]), 0.2),
        ] {
            let model = Model { declared: &declared, effects: vec![instance.clone()] };
            let x = [&z[..], &[at]].concat();
            let total = model.total(&x, 0).unwrap();
            assert!((total.coordinate - at).abs() > 1e-3, "declared values move it");
            let mut tables = declared.tables_beside(&z, &[&instance]);
            assert!(tables.len() < declared.tables(&z).len());
            tables.push(instance.at(&[total.coordinate]));
            let (separate, together) = (edited(&model.tables(&x)), edited(&tables));
            let pairs = separate.0.iter().zip(&together.0);
            assert!(pairs.into_iter().all(|(a, b)| (a / b - 1.0).abs() < 1e-9), "{separate:?} {together:?}");
            assert!((separate.1 / together.1 - 1.0).abs() < 1e-9, "{separate:?} {together:?}");
            // How it changes with each coordinate.
            for i in 0..x.len() {
                let moved = |h: f64| {
                    let mut x = x.clone();
                    x[i] += h;
                    model.total(&x, 0).unwrap().coordinate
                };
                let slope = (moved(1e-4) - moved(-1e-4)) / 2e-4;
                assert!((slope - total.slopes[i]).abs() < 1e-4, "{i}: {slope} {}", total.slopes[i]);
            }
        }
        // What else is done to a sensor may come between.
        let of = |kind: &str| all.iter().find(|i| i.kind == kind && i.place().contains("top")).unwrap().clone();
        let (gain, clock) = (of("sensor_gain"), of("clock_offset"));
        let of = |effects: Vec<Instance>| {
            let x = vec![0.1; declared.len() + effects.len()];
            Model { declared: &declared, effects }.total(&x, 0)
        };
        assert!(of(vec![gain.clone()]).is_some() && of(vec![gain, clock]).is_none());
    }

    #[test]
    fn velocities_of_all_layers_are_what_modes_make_of_them() {
        let problem = problem(&Truth::default());
        let declared = Declared::new(&problem).unwrap();
        let layer = |bottom_m: f64| velocity_between([0.0, bottom_m]);
        let z = vec![0.0; declared.len()];
        let shares = declared.same_as(&layer(40.0), &z);
        let mut beside = z.clone();
        shares.iter().for_each(|(i, share)| beside[*i] = *share);
        assert!(!shares.is_empty());
        assert!(declared.ln_factors(&beside).iter().all(|ln| (ln - 1.0).abs() < 1e-9));
        assert!(declared.same_as(&layer(20.0), &z).is_empty());
        // One that ends within a range moves part of it.
        let ranges =
            Declared { cuts_m: vec![0.0, 30.0, 40.0], modes: vec![vec![0.05, 0.0], vec![0.0, 0.05]], ..declared };
        assert!(ranges.same_as(&layer(35.0), &z).is_empty() && !ranges.same_as(&layer(30.0), &z).is_empty());
    }
}
