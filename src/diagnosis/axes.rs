//! Effects of the soil that replays follow beside its nuisances.

use super::neighbours::{Neighbours, Replayed};
use super::problem::Replay;
use super::responses::Scene;
use super::unknowns::{Nuisance, Unknowns, nuisances};
use crate::effects::{Class, Instance};
use crate::error::Result;
use crate::numerics::threads::on_threads;
use std::sync::Arc;

/// Share of a typical size within which a replay tells nothing new.
const NEAR: f64 = 0.1;
/// How far beyond an effect's estimate it is replayed, as a share of its way from nothing.
const BEYOND: f64 = 0.2;

/// An effect of the soil and replays along its strength.
///
/// Limits: what it does together with other effects and nuisances is the sum of what they do apart.
/// Check:  `along_an_axis_replays_are_met`.
#[derive(Debug, Clone)]
pub struct Axis {
    /// The effect, of one parameter.
    pub instance: Instance,
    /// Where the column was replayed, by rising coordinate.
    nodes: Vec<Node>,
    /// The nuisance that is the same thing, if any, was there, prior standard deviations.
    pub nuisance: f64,
}

/// A replay on an axis, and the one that lacks nothing but its way along the axis; the same where both are one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Node {
    pub(super) coordinate: f64,
    pub(super) replay: usize,
    pub(super) from: usize,
}

impl Axis {
    /// An axis with these `nodes`, `nuisance` being where the nuisance was that is the same thing.
    pub(super) fn new(instance: &Instance, mut nodes: Vec<Node>, nuisance: f64) -> Self {
        nodes.sort_by(|a, b| a.coordinate.total_cmp(&b.coordinate));
        Self { instance: instance.clone(), nodes, nuisance }
    }

    /// What each replay adds at a `coordinate` of the effect, none being that it vanishes: quadratic between three replays,
    /// straight on beyond the ends.
    pub fn weights(&self, coordinate: Option<f64>) -> Vec<(Node, f64)> {
        let Some(x) = coordinate.or_else(|| Some(*self.instance.zero()?.first()?)) else { return Vec::new() };
        let n = &self.nodes;
        let at = |i: usize| n[i].coordinate;
        let last = n.len() - 1;
        if x <= at(0) || x >= at(last) || last == 1 {
            let (a, b) = if x <= at(0) { (0, 1) } else { (last - 1, last) };
            let share = (x - at(a)) / (at(b) - at(a));
            return vec![(n[a], 1.0 - share), (n[b], share)];
        }
        let near = (0..last - 1).min_by(|a, b| (at(a + 1) - x).abs().total_cmp(&(at(b + 1) - x).abs())).unwrap_or(0);
        let three = near..near + 3;
        let weight =
            |i: usize| -> f64 { three.clone().filter(|j| *j != i).map(|j| (x - at(j)) / (at(i) - at(j))).product() };
        three.clone().map(|i| (n[i], weight(i))).collect()
    }

    /// The axis as it was around another estimate, its replays now where `place` says, where it began from nothing and no nuisance
    /// is the same thing: what it adds is nearly the same there.
    pub(super) fn kept(&self, nuisances: &[Nuisance], mut place: impl FnMut(usize) -> usize) -> Option<Self> {
        let zero = *self.instance.zero()?.first()?;
        let began = self.nodes.iter().find(|n| n.replay == n.from)?;
        if began.coordinate != zero || nuisances.iter().any(|n| n.is_same(&self.instance)) {
            return None;
        }
        let node = |n: &Node| Node { replay: place(n.replay), from: place(n.from), ..*n };
        let nodes = self.nodes.iter().map(node).collect();
        Some(Self { nodes, ..self.clone() })
    }
}

/// Whether replays can follow `instance`.
pub(super) fn is_followable(instance: &Instance) -> bool {
    instance.class() == Class::Soil && instance.free.len() == 1 && instance.zero().is_some()
}

/// The same around its estimate: its velocities are those of the nuisances there; told apart by how they were replayed, they would seem
/// known apart.
pub(super) fn has_axis(instance: &Instance) -> bool {
    is_followable(instance) && instance.kind != "layer_velocity"
}

impl Scene<'_> {
    /// The same with replays along those of `wanted` that are effects of the soil, each at the coordinate given.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn along(&self, replay: &dyn Replay, wanted: &[(&Instance, f64)]) -> Result<Self> {
        let mut along = self.clone();
        let Some(known) = &self.neighbours else { return Ok(along) };
        let mut all = Neighbours::clone(known);
        // What tolerances of velocities have made up for is followed as they are.
        let is_made_up_for = |i: &Instance| self.is_stiff() && i.kind == "layer_velocity";
        let is_new = |instance: &Instance, zero: f64, coordinate: f64| {
            let known = known.axes.iter().find(|axis| axis.instance == *instance).map_or(&[][..], |axis| &axis.nodes);
            let near = NEAR * instance.free[0].size;
            (coordinate - zero).abs() >= near && known.iter().all(|n| (coordinate - n.coordinate).abs() >= near)
        };
        let new: Vec<(&Instance, f64, f64)> = wanted
            .iter()
            .filter(|(i, _)| is_followable(i) && !is_made_up_for(i))
            .filter_map(|(i, coordinate)| Some((*i, i.zero()?[0], *coordinate)))
            .filter(|(i, zero, coordinate)| is_new(i, *zero, *coordinate))
            .collect();
        let run = |k: usize| {
            let (instance, _, coordinate) = new[k];
            let tables = [&known.tables[..], &[instance.at(&[coordinate])]].concat();
            self.seen_roughly(replay, &tables).ok()
        };
        for ((instance, zero, coordinate), seen) in new.iter().zip(on_threads(new.len(), run)) {
            self.follow(&mut all, instance, (*zero, vec![(*coordinate, seen)]));
        }
        along.neighbours = Some(Arc::new(all));
        Ok(along)
    }

    /// The same with replays along all of `open` that are effects of the soil, each at a typical size; those of the whole column,
    /// which are few and matter most, at one of either sign.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn along_all(&self, replay: &dyn Replay, open: &[Instance]) -> Result<Self> {
        let typical = |instance: &Instance| {
            let (Some(zero), [[low, high]]) = (instance.zero(), &instance.bounds()[..]) else { return Vec::new() };
            let size = instance.free[0].size;
            let both = [zero[0] - size, zero[0] + size].into_iter().filter(|x| x >= low && x <= high);
            both.take(if instance.target.is_empty() { 2 } else { 1 }).collect()
        };
        let wanted: Vec<(&Instance, f64)> =
            open.iter().flat_map(|i| typical(i).into_iter().map(move |x| (i, x))).collect();
        self.along(replay, &wanted)
    }

    /// Adds axes to `all` for the effects of `unknowns` at `x`, around which these are.
    pub(super) fn follow_effects(&self, all: &mut Neighbours, replay: &dyn Replay, unknowns: &Unknowns<'_>, x: &[f64]) {
        for (index, instance) in unknowns.effects.iter().enumerate().filter(|(_, i)| has_axis(i)) {
            let own = unknowns.start(index);
            let Some(zero) = instance.zero().map(|z| z[0]) else { continue };
            let [low, high] = instance.bounds()[0];
            let beyond = (x[own] + BEYOND * (x[own] - zero)).clamp(low, high);
            let new: Vec<f64> = [zero, beyond].into_iter().filter(|coordinate| *coordinate != x[own]).collect();
            let run = |k: usize| {
                let mut x = x.to_vec();
                x[own] = new[k];
                self.seen_roughly(replay, &unknowns.tables(&x)).ok()
            };
            let seen = on_threads(new.len(), run);
            self.follow(all, instance, (x[own], new.into_iter().zip(seen).collect()));
        }
    }

    /// Adds an axis with these `replays` to `all`, on which their centre lies at `centre`; none where the column does not finish as it
    /// does there.
    fn follow(
        &self,
        all: &mut Neighbours,
        instance: &Instance,
        (centre, replays): (f64, Vec<(f64, Option<Replayed>)>),
    ) {
        let known = all.axes.iter().position(|axis| axis.instance == *instance);
        let nuisances = nuisances(self.problem).unwrap_or_default();
        let same = nuisances.iter().position(|n| n.is_same(instance));
        let nuisance = same.map_or(0.0, |i| all.at[i]);
        let centre = Node { coordinate: centre, replay: 0, from: 0 };
        let mut nodes = known.map_or(vec![centre], |i| all.axes[i].nodes.clone());
        let before = nodes.len();
        let mut new = Vec::new();
        for (coordinate, seen) in replays {
            let Some(seen) = seen else { continue };
            let is_lost = |(centre, own): (&Option<_>, &Option<_>)| centre.is_some() && own.is_none();
            if all.replays[0].iter().flatten().zip(seen.iter().flatten()).any(is_lost) {
                continue;
            }
            nodes.push(Node { coordinate, replay: all.replays.len() + new.len(), from: 0 });
            new.push(Arc::new(seen));
        }
        if nodes.len() > before {
            all.replays.extend(new);
            let axis = Axis::new(instance, nodes, nuisance);
            match known {
                Some(i) => all.axes[i] = axis,
                None => all.axes.push(axis),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Free;

    #[test]
    fn along_an_axis_replays_are_met() {
        let parameter = &crate::effects::find("frequency_dependent_damping").unwrap().catalogue.parameters[0];
        let instance = Instance::new("frequency_dependent_damping", [], vec![Free::new(parameter, 0.5)]);
        let node = |(coordinate, replay)| Node { coordinate, replay, from: 0 };
        let axis = Axis::new(&instance, [(2.0, 7), (0.0, 0), (1.0, 5)].map(node).to_vec(), 0.0);
        let at = |x: Option<f64>| -> f64 {
            let value = |replay: usize| match replay {
                0 => 1.0,
                5 => 4.0,
                _ => 9.0,
            };
            axis.weights(x).iter().map(|(node, w)| w * value(node.replay)).sum()
        };
        // (1 + x)² between, its chords beyond.
        for (x, expected) in [(0.0, 1.0), (0.5, 2.25), (1.0, 4.0), (1.7, 7.29), (2.0, 9.0), (3.0, 14.0), (-1.0, -2.0)] {
            assert!((at(Some(x)) - expected).abs() < 1e-12, "{x}");
        }
        assert_eq!(at(None), 1.0, "it is not there");
        let short = Axis::new(&instance, [(0.0, 0), (2.0, 7)].map(node).to_vec(), 0.0);
        assert_eq!(short.weights(Some(0.5)), [(node((0.0, 0)), 0.75), (node((2.0, 7)), 0.25)]);
        let kept = short.kept(&[], |i| i + 9).unwrap();
        assert_eq!(kept.nodes[1], Node { coordinate: 2.0, replay: 16, from: 9 });
    }
}
