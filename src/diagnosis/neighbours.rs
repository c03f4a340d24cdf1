//! What the nonlinear column does near an estimate: replays around it, and between them.

use super::anchor::Anchor;
use super::axes::Axis;
use super::problem::Replay;
use super::propagated::propagated;
use super::responses::Scene;
use super::search::Search;
use super::settings::DiagnoseSettings;
use super::spectra::RecordSpectra;
use super::unknowns::{Nuisance, Placed, Unknowns, common_velocity, nuisances};
use super::velocities::{ln_velocity, velocity};
use crate::column::Profile;
use crate::effects::{self, Effect, Instance, Situation};
use crate::error::Result;
use crate::numerics::threads::on_threads;
use crate::progress::Progress;
use realfft::num_complex::Complex;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Velocities of the whole column at which it is replayed, prior standard deviations of their common nuisance.
const STRETCH: [f64; 7] = [-4.5, -3.0, -1.5, 0.0, 1.5, 3.0, 4.5];
/// Place of the estimate among them.
const MIDDLE: usize = 3;
/// Farthest a velocity may be from its declared value, prior standard deviations.
const FARTHEST: f64 = 60.0;

/// Replays around an estimate of the soil and what lies between them.
///
/// ```text
/// V(n) = T(s) + Σ_i [(V_i − V_0) n_i − c_i n_i T'(0)],   s = n_0 + Σ_i c_i n_i         (1)
/// c_i = ⟨V_i − V_0, T'(0)⟩ / ⟨T'(0), T'(0)⟩                                           (2)
/// ```
///
/// n_i is how far a nuisance of the soil is from the estimate, prior standard deviations, and V_i the replay one of them up; n_0
/// is that of all velocities. A turned input sensor counts among the soil. T(s), cubic between replays, has all velocities
/// changed together: that moves the resonances, narrow at small damping, so far that no slope holds. Of what a layer's velocity
/// does, (2) is the part that moves resonances alike. Damping that cannot fall below nothing has a replay on either side.
///
/// Effects of the soil have replays of their own along their strength ([`Axis`]), which add to (1). Any other that changes
/// velocities is a larger change of the same kind: n_i grows by the ln of the velocity that has the mean
/// compliance of the layer.
///
/// Limits: what two layers do together is the sum of what they do apart; replays at an estimate tell what that misses.
/// Check:  `between_replays_lies_what_they_bracket`; `tests/diagnosis`: twins of the nonlinear column.
#[derive(Clone)]
pub struct Neighbours {
    /// The manifest's own effects.
    declared: Arc<Vec<Box<dyn Effect>>>,
    /// Nuisances of the estimate, and its `[[effects]]` beyond those.
    pub(super) at: Vec<f64>,
    pub(super) tables: Vec<toml::Table>,
    /// Effects followed beside the nuisances.
    pub(super) axes: Vec<Axis>,
    /// Where the first replay is, by group and record: its nuisances and what its effects do to velocities.
    pub(super) centre: Vec<Vec<Vec<f64>>>,
    /// By nuisance.
    soil: Vec<Option<Soil>>,
    /// Replays of [`STRETCH`].
    stretch: Option<[usize; STRETCH.len()]>,
    /// The estimate's first; `None` where the column did not finish.
    pub(super) replays: Vec<Arc<Replayed>>,
}

/// A replay, `[group][record]`.
pub(super) type Replayed = Vec<Vec<Option<Seen>>>;

/// A nuisance of the soil.
#[derive(Clone)]
pub(super) struct Soil {
    /// Its replay a step up; none for the common velocity where that is stretched.
    pub(super) up: Option<usize>,
    /// The same down, where that is not the mirror image.
    down: Option<usize>,
    /// The step, prior standard deviations.
    pub(super) step: f64,
    /// c of (2).
    share: f64,
    /// Depths, m, between which it is a velocity's, and the deviation of its ln.
    pub(super) range: Option<([f64; 2], f64)>,
}

/// One record's replay in its window.
pub(super) struct Seen {
    /// As the record is seen: `[bin][sensor]`.
    pub spectrum: Vec<C64>,
    /// `[sensor][step]`, m/s².
    history: Vec<Vec<f64>>,
}

impl Scene<'_> {
    /// Replays around the unknowns `x`, which hold these `effects`, and follows those of the soil and every change of a velocity by these from now on;
    /// also hears there what the column makes of noise in its input. The anchor there.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn look_around(
        &mut self,
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        (instances, x): (&[Instance], &[f64]),
        progress: &dyn Progress,
    ) -> Result<Anchor> {
        let nuisances = &nuisances(self.problem)?;
        let unknowns = Unknowns { nuisances, effects: instances.to_vec(), axes: Some(&[]) };
        let common = common_velocity(nuisances);
        let soil = nuisances.iter().map(|n| n.is_shaken.then(|| Soil::of(n))).collect();
        let mut all = self.around(&unknowns, x, soil, self.seen_roughly(replay, &unknowns.tables(x))?)?;
        // Replay k of these becomes the replay k + 1 of `all`.
        let mut moves: Vec<(usize, f64)> = Vec::new();
        let mut to_run = |nuisance: usize, deviations: f64| {
            moves.push((nuisance, deviations));
            moves.len()
        };
        for (i, nuisance) in nuisances.iter().enumerate().filter(|(i, _)| Some(*i) != common) {
            let Some(soil) = &mut all.soil[i] else { continue };
            soil.up = Some(to_run(i, 1.0));
            soil.down = (nuisance.instance.kind == "small_strain_damping").then(|| to_run(i, -1.0));
        }
        all.stretch = common.map(|common| STRETCH.map(|s| if s == 0.0 { 0 } else { to_run(common, s) }));
        progress.start("neighbours", moves.len() as u64);
        let run = |k: usize| -> Result<Arc<Replayed>> {
            let (nuisance, deviations) = moves[k];
            let mut x = x.to_vec();
            x[nuisance] += deviations;
            let seen = self.seen_roughly(replay, &unknowns.tables(&x))?;
            progress.advance(1);
            Ok(Arc::new(seen))
        };
        all.replays.extend(on_threads(moves.len(), run).into_iter().collect::<Result<Vec<_>>>()?);
        common.into_iter().for_each(|common| all.find_shares(common));
        all.keep_axes(self.neighbours.as_deref(), (nuisances, instances));
        self.follow_effects(&mut all, replay, &unknowns, x);
        all.centre = self.centre(&all, &unknowns, x)?;
        let noisier = self.seen(&replay.replay_noisier(&unknowns.tables(x))?);
        let all = Arc::new(all);
        self.neighbours = Some(all.clone());
        let (anchor, responses) =
            Search::new(self, settings, Some(replay))?.anchored_with_responses(instances, x, None)?;
        self.propagated = Arc::new(propagated(self, [&all.replays[0], &noisier], &anchor, &responses));
        Ok(anchor)
    }

    /// Neighbours of the unknowns `x` that know no more than `replayed`, the replay there.
    ///
    /// # Errors
    /// When a declared effect cannot be built.
    pub(super) fn around(
        &self,
        unknowns: &Unknowns<'_>,
        x: &[f64],
        soil: Vec<Option<Soil>>,
        replayed: Replayed,
    ) -> Result<Neighbours> {
        Ok(Neighbours {
            declared: Arc::new(effects::build_all(&self.problem.declared)?),
            at: x[..unknowns.nuisances.len()].to_vec(),
            tables: unknowns.tables(x),
            axes: Vec::new(),
            centre: Vec::new(),
            soil,
            stretch: None,
            replays: vec![Arc::new(replayed)],
        })
    }

    /// [`Neighbours::centre`] of `all` around `x`.
    pub(super) fn centre(&self, all: &Neighbours, unknowns: &Unknowns<'_>, x: &[f64]) -> Result<Vec<Vec<Vec<f64>>>> {
        let unknowns = Unknowns { axes: Some(&all.axes), ..unknowns.clone() };
        let built = unknowns.build(&self.problem.declared, x)?;
        let placed = unknowns.placed(x).x;
        let centre = |record: &RecordSpectra| {
            let situation = &self.problem.events[record.event].situation;
            let shift = self.edited_beside(Some(all), &built, situation).1;
            shift.iter().zip(&placed).map(|(shift, x)| shift + x).collect()
        };
        Ok(self.groups.iter().map(|g| g.records.iter().map(centre).collect()).collect())
    }

    /// A rough replay under `effects`, as records are seen.
    ///
    /// # Errors
    /// When it is impossible.
    pub(super) fn seen_roughly(&self, replay: &dyn Replay, effects: &[toml::Table]) -> Result<Replayed> {
        Ok(self.seen(&replay.replay_roughly(effects)?))
    }

    pub(super) fn seen(&self, replays: &[Option<Vec<Vec<f64>>>]) -> Replayed {
        let of = |g: usize, r: usize| {
            let record = &self.groups[g].records[r];
            let window = record.window.clone();
            let history: Vec<Vec<f64>> = replays
                .get(record.event)?
                .as_ref()?
                .iter()
                .map(|history| history.get(window.clone()).map(<[f64]>::to_vec))
                .collect::<Option<_>>()?;
            let rows: Vec<Vec<C64>> = history.iter().map(|h| self.windowed(g, h)).collect();
            let n = rows.first().map_or(0, Vec::len);
            let spectrum = (0..n).flat_map(|k| rows.iter().map(move |row| row[k])).collect();
            Some(Seen { spectrum, history })
        };
        (0..self.groups.len()).map(|g| (0..self.groups[g].records.len()).map(|r| of(g, r)).collect()).collect()
    }
}

impl Soil {
    pub(super) fn of(nuisance: &Nuisance) -> Self {
        let at = |key: &str| nuisance.instance.target.get(key).and_then(toml::Value::as_float);
        let range = at("top_m").zip(at("bottom_m")).map(|(top_m, bottom_m)| [top_m, bottom_m]);
        let is_velocity = nuisance.instance.kind == "layer_velocity";
        let range = range.filter(|_| is_velocity).map(|range| (range, nuisance.deviation));
        Self { up: None, down: None, step: 1.0, share: 0.0, range }
    }
}

impl Neighbours {
    /// (2) for the velocities; one for the `common` nuisance.
    fn find_shares(&mut self, common: usize) {
        let Some(stretch) = self.stretch else { return };
        let [below, above] = [stretch[MIDDLE - 1], stretch[MIDDLE + 1]];
        let shares: Vec<f64> = self
            .soil
            .iter()
            .map(|soil| {
                let Some(up) = soil.as_ref().filter(|s| s.range.is_some()).and_then(|s| s.up) else { return 0.0 };
                let (mut product, mut square) = (0.0, 0.0);
                for (g, group) in self.replays[0].iter().enumerate() {
                    for (r, zero) in group.iter().enumerate() {
                        let of = |replay: usize| self.replays[replay][g][r].as_ref().map(|s| &s.spectrum);
                        let (Some(zero), Some(up), Some(below), Some(above)) =
                            (zero.as_ref().map(|s| &s.spectrum), of(up), of(below), of(above))
                        else {
                            continue;
                        };
                        let power: f64 = zero.iter().map(C64::norm_sqr).sum();
                        if power <= 0.0 {
                            continue;
                        }
                        let span = STRETCH[MIDDLE + 1] - STRETCH[MIDDLE - 1];
                        for k in 0..zero.len() {
                            let slope = (above[k] - below[k]) / span;
                            product += ((up[k] - zero[k]) * slope.conj()).re / power;
                            square += slope.norm_sqr() / power;
                        }
                    }
                }
                if square > 0.0 { product / square } else { 0.0 }
            })
            .collect();
        for (i, (soil, share)) in self.soil.iter_mut().zip(shares).enumerate() {
            if let Some(soil) = soil {
                soil.share = if i == common { 1.0 } else { share };
            }
        }
    }

    /// Keeps the axes of the neighbours `before` of effects that are not among these `instances`.
    fn keep_axes(&mut self, before: Option<&Self>, (nuisances, instances): (&[Nuisance], &[Instance])) {
        let Some(before) = before else { return };
        let mut places = BTreeMap::new();
        for axis in before.axes.iter().filter(|axis| !instances.contains(&axis.instance)) {
            let place = |replay: usize| {
                *places.entry(replay).or_insert_with(|| {
                    self.replays.push(before.replays[replay].clone());
                    self.replays.len() - 1
                })
            };
            self.axes.extend(axis.kept(nuisances, place));
        }
    }

    /// What each replay counts in (1); the sum is one.
    fn weights(&self, [g, r]: [usize; 2], at: &Placed) -> Vec<f64> {
        let mut weights = vec![0.0; self.replays.len()];
        let all = || self.soil.iter().zip(at.x.iter().zip(&self.centre[g][r]));
        let soil = || all().filter_map(|(s, (n, centre))| Some((s.as_ref()?, n - centre)));
        let mut along = 0.0;
        for (soil, n) in soil() {
            let (replay, n) = match (soil.up, soil.down) {
                (_, Some(down)) if n < 0.0 => (down, -n),
                (Some(up), _) => (up, n),
                _ => continue,
            };
            weights[replay] += n / soil.step;
            weights[0] -= n / soil.step;
            along += soil.share * n;
        }
        for (i, axis) in self.axes.iter().enumerate() {
            let coordinate = at.axes.get(i).copied().flatten();
            for (node, weight) in axis.weights(coordinate) {
                weights[node.replay] += weight;
                weights[node.from] -= weight;
            }
        }
        let Some(stretch) = self.stretch else {
            weights[0] += 1.0;
            return weights;
        };
        let span = STRETCH[MIDDLE + 1] - STRETCH[MIDDLE - 1];
        weights[stretch[MIDDLE + 1]] -= along / span;
        weights[stretch[MIDDLE - 1]] += along / span;
        let s: f64 = soil().map(|(soil, n)| soil.share * n).sum();
        for (place, weight) in between(s) {
            weights[stretch[place]] += weight;
        }
        weights
    }

    /// What moving the soil `from` some deviations `to` others does to the motions of record `r` of group `g`: `[bin][sensor]`;
    /// empty where it is not known.
    pub fn moved(&self, [g, r]: [usize; 2], from: &Placed, to: &Placed) -> Vec<C64> {
        let weights: Vec<f64> =
            self.weights([g, r], to).iter().zip(self.weights([g, r], from)).map(|(to, from)| to - from).collect();
        let mut sum = Vec::new();
        for (replay, weight) in self.replays.iter().zip(weights).filter(|(_, w)| *w != 0.0) {
            let Some(seen) = &replay[g][r] else { return Vec::new() };
            sum.resize(seen.spectrum.len(), C64::default());
            sum.iter_mut().zip(&seen.spectrum).for_each(|(sum, v)| *sum += v * weight);
        }
        sum
    }

    /// (1) in time, `[sensor][step]` in the window; `None` where it is not known.
    pub fn motions(&self, [g, r]: [usize; 2], at: &Placed) -> Option<Vec<Vec<f64>>> {
        let mut sum: Vec<Vec<f64>> = Vec::new();
        for (replay, weight) in self.replays.iter().zip(self.weights([g, r], at)).filter(|(_, w)| *w != 0.0) {
            let seen = replay[g][r].as_ref()?;
            sum.resize(seen.history.len(), Vec::new());
            for (sum, history) in sum.iter_mut().zip(&seen.history) {
                sum.resize(history.len(), 0.0);
                sum.iter_mut().zip(history).for_each(|(sum, v)| *sum += v * weight);
            }
        }
        Some(sum)
    }

    /// Gives `edited` the velocities of `declared`, the column without effects, and what that took away, by nuisance in prior
    /// standard deviations. Where velocities are declared without tolerance, nothing follows them and they stay.
    pub fn take_velocities(&self, declared: &Profile, edited: &mut Profile, situation: &Situation) -> Vec<f64> {
        if !self.soil.iter().flatten().any(|s| s.range.is_some() && s.up.is_some()) {
            return vec![0.0; self.soil.len()];
        }
        let mut plain = Cow::Borrowed(declared);
        self.declared.iter().for_each(|e| e.edit(plain.to_mut(), situation));
        let shift = self.soil.iter().map(|soil| match soil {
            Some(Soil { range: Some((range, deviation)), up: Some(_), .. }) => {
                let ln = ln_velocity(edited, *range) - ln_velocity(&plain, *range);
                (ln / deviation).clamp(-FARTHEST, FARTHEST)
            }
            _ => 0.0,
        });
        let shift: Vec<f64> = shift.collect();
        let mut top_m = 0.0;
        for layer in &mut edited.layers {
            layer.vs_m_s = velocity(&plain, top_m + 0.5 * layer.thickness_m);
            top_m += layer.thickness_m;
        }
        shift
    }
}

/// (place in [`STRETCH`], weight) of the replays between which `s` lies: cubic inside, straight on beyond the ends.
fn between(s: f64) -> Vec<(usize, f64)> {
    let last = STRETCH.len() - 1;
    if s <= STRETCH[0] || s >= STRETCH[last] {
        let (a, b) = if s < 0.0 { (0, 1) } else { (last, last - 1) };
        let share = (s - STRETCH[a]) / (STRETCH[b] - STRETCH[a]);
        return vec![(a, 1.0 - share), (b, share)];
    }
    let above = STRETCH.iter().position(|x| *x > s).unwrap_or(last);
    let first = above.saturating_sub(2).min(last - 3);
    let nodes = first..first + 4;
    let weight = |i: usize| -> f64 {
        nodes.clone().filter(|j| *j != i).map(|j| (s - STRETCH[j]) / (STRETCH[i] - STRETCH[j])).product()
    };
    nodes.clone().map(|i| (i, weight(i))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two velocities and a damping, every replay a number: the declared one, a step of each velocity, damping up and down, and
    /// all velocities together.
    fn neighbours(of: impl Fn([f64; 2], f64) -> f64) -> Neighbours {
        let seen = |v: f64| vec![vec![Some(Seen { spectrum: vec![C64::new(v, -v)], history: vec![vec![v]] })]];
        let mut values = vec![of([0.0; 2], 0.0), of([1.0, 0.0], 0.0), of([0.0, 1.0], 0.0), of([0.0; 2], 1.0)];
        values.push(of([0.0; 2], -1.0));
        values.extend(STRETCH.iter().filter(|s| **s != 0.0).map(|s| of([0.4 * s, 0.2 * s], 0.0)));
        let velocity = |up| Some(Soil { up, down: None, step: 1.0, share: 0.0, range: Some(([0.0, 1.0], 0.03)) });
        let damping = Some(Soil { up: Some(3), down: Some(4), step: 1.0, share: 0.0, range: None });
        let mut all = Neighbours {
            declared: Arc::default(),
            at: Vec::new(),
            tables: Vec::new(),
            axes: Vec::new(),
            centre: vec![vec![vec![0.0; 4]]],
            soil: vec![velocity(Some(1)), velocity(Some(2)), velocity(None), damping],
            stretch: Some([5, 6, 7, 0, 8, 9, 10]),
            replays: values.into_iter().map(seen).map(Arc::new).collect(),
        };
        all.find_shares(2);
        all
    }

    #[test]
    fn between_replays_lies_what_they_bracket() {
        let curved = |[a, b]: [f64; 2], d: f64| 1.0 + (0.3 * (a + 2.0 * b)).sin() + d.max(0.0);
        let all = neighbours(curved);
        let soil = |n: [f64; 4]| Placed::plain(&n);
        let at = |n: [f64; 4]| all.motions([0, 0], &soil(n)).unwrap()[0][0];
        assert!((at([0.0, 0.0, 1.0, 0.0]) - curved([0.4, 0.2], 0.0)).abs() < 2e-3);
        assert!((at([1.0, 0.0, 0.0, 0.0]) - curved([1.0, 0.0], 0.0)).abs() < 2e-2);
        assert!((at([2.0, 1.0, 0.0, 0.0]) - curved([2.0, 1.0], 0.0)).abs() < 5e-2, "far along what all do alike");
        assert!((at([0.0, 0.0, 0.0, 0.5]) - 1.5).abs() < 1e-12 && (at([0.0, 0.0, 0.0, -2.0]) - 1.0).abs() < 1e-12);
        let (from, to) = ([0.3, 0.0, 0.1, 0.2], [0.1, 0.7, -0.4, -1.0]);
        let moved = all.moved([0, 0], &soil(from), &soil(to))[0];
        assert!((moved - C64::new(1.0, -1.0) * (at(to) - at(from))).norm() < 1e-12);
    }
}
