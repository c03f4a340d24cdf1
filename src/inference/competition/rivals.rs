//! What could be taken for an effect, fitted in its place: the place of what is named is claimed with it.

use super::prior::acts;
use super::scan::Ground;
use super::{Competition, FAR, FINALS, has_set, is_same_set};
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::inference::forward::Label;
use crate::inference::posterior::{Fit, Fitter, Start, Stop};
use crate::progress::Progress;

impl<'a> Competition<'a> {
    /// Fits what could be taken for each effect of the most probable model under `labels`, in its place, to all events: the place of what
    /// is named is claimed with it. Whether there is another most probable model now.
    pub(super) fn challenge(&mut self, labels: &[Label], progress: &dyn Progress) -> Result<bool> {
        let leading = self.leading(labels).clone();
        if has_set(&self.challenged, &leading.model.effects) {
            return Ok(false);
        }
        self.challenged.push(leading.model.effects.clone());
        let (by, start) = self.around(&leading)?;
        let mut rivals = self.rivals(&by, &start);
        self.most_promising_first(&mut rivals);
        let least = self.log_posterior(&start) - FAR;
        rivals.retain(|rival| self.promise(rival) > least);
        let starts: Vec<_> =
            rivals.into_iter().take(FINALS).map(|rival| (Start::led_by(rival), Stop::ON_THE_WAY)).collect();
        self.begin(&starts);
        self.settle_close(labels, progress)?;
        Ok(!is_same_set(&leading.model.effects, &self.leading(labels).model.effects))
    }

    /// The same effect at the places before and after that of `own`: how well one of them does in its stead is told by a fit,
    /// whatever it does at the strengths that are tried. Where it may be at any depth, those of the catalogue are a beginning: the places
    /// half-way to the nearest that are known so far are looked at as well.
    fn next_to(&self, own: &Instance) -> Vec<Instance> {
        let Some(depth_m) = own.depth_m() else {
            let alike: Vec<&Instance> = self.instances.iter().filter(|i| i.is_alike(own)).collect();
            let at = alike.iter().position(|i| i.is_one(own));
            let next = alike.into_iter().enumerate().filter(|(i, _)| at.is_some_and(|at| at.abs_diff(*i) == 1));
            return next.map(|(_, next)| next.clone()).collect();
        };
        let fitted = self.fits.iter().flat_map(|fit| &fit.model.effects);
        let alike = self.instances.iter().chain(fitted).filter(|i| i.is_alike(own));
        let away_m: Vec<(f64, &Instance)> = alike.filter_map(|i| Some((i.depth_m()? - depth_m, i))).collect();
        let array = &self.fitter.forward.problem.array;
        let of_side = |side: f64| {
            let all = away_m.iter().filter(|(away, _)| away * side > 0.0);
            let (away, next) = all.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
            Some([(*next).clone(), own.at_depth(depth_m + 0.5 * away)])
        };
        [-1.0, 1.0].into_iter().filter_map(of_side).flatten().filter(|next| acts(array, next)).collect()
    }

    /// First fits of what could be taken for each of the effects of `base`, in its place.
    fn rivals(&self, by: &Fitter<'a>, base: &Fit<'a>) -> Vec<Fit<'a>> {
        let of = |index: usize| -> Vec<Fit<'a>> {
            let own = &base.model.effects[index];
            if own.zero().is_none() {
                return Vec::new();
            }
            let is_meant = |i: &&Instance| is_rival(own, i) && base.model.index_of(i).is_none();
            // Tolerances hold beside a rival as they do beside the effect, unless they stand in for what it would explain.
            let rest = without(base, index);
            let grounds = [Ground::declared(by, rest.clone()), Some(Ground::new(by, rest))];
            let of_ground = |ground: Ground<'a, '_>| ground.starts(self.instances.iter().filter(is_meant));
            let mut starts: Vec<Start<'a>> = grounds.into_iter().flatten().flat_map(of_ground).collect();
            let is_new =
                |next: &Start<'a>| !starts.iter().any(|known| is_same_set(&known.model.effects, &next.model.effects));
            let next = self.next_to(own);
            let next = next.iter().filter(is_meant).map(|i| exchanged(base, index, i));
            let next: Vec<Start<'a>> = next.filter(is_new).collect();
            starts.extend(next);
            self.first_fits(by, &starts)
        };
        (0..base.model.effects.len()).flat_map(of).collect()
    }
}

/// Where `base` is, effect `index` left out.
fn without<'a>(base: &Fit<'a>, index: usize) -> Start<'a> {
    let mut rest = Start::led_by(base.clone());
    rest.x.drain(base.model.coordinates_of(index));
    rest.slopes.drain(base.model.coordinates_of(index));
    rest.model.effects.remove(index);
    rest
}

/// Where `base` is, `other` in the place of its effect `index` and as strong.
fn exchanged<'a>(base: &Fit<'a>, index: usize, other: &Instance) -> Start<'a> {
    let mut start = without(base, index).and(other, &base.x[base.model.coordinates_of(index)]);
    start.x.iter_mut().zip(start.model.bounds()).for_each(|(x, [low, high])| *x = x.clamp(low, high));
    start
}

/// Whether `other` could be taken for `own`: the catalogue of either knows them to be confused, or it is another place of the same.
fn is_rival(own: &Instance, other: &Instance) -> bool {
    let has = |one: &Instance, kind| effects::find(one.kind).is_ok_and(|e| e.catalogue.confused_with.contains(&kind));
    own.kind == other.kind || has(own, other.kind) || has(other, own.kind)
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{Nonlinear, Truth, as_declared, in_competition, problem};
    use super::*;
    use crate::inference::parameters::Model;

    #[test]
    fn a_place_next_to_that_of_an_effect_is_always_a_rival() {
        let problem = problem(&Truth { events: 3, ..Truth::default() });
        in_competition(&problem, &Nonlinear(&problem), as_declared, |competition| {
            let depth_m = |i: &Instance| i.depth_m().unwrap();
            let slips: Vec<Instance> =
                competition.instances.iter().filter(|i| i.kind == "interface_slip").cloned().collect();
            assert!(slips.len() > 6 && slips.windows(2).all(|pair| depth_m(&pair[0]) < depth_m(&pair[1])));
            let next = |own: &Instance| competition.next_to(own).iter().map(depth_m).collect::<Vec<_>>();
            let between = |a: usize, b: usize| 0.5 * (depth_m(&slips[a]) + depth_m(&slips[b]));
            assert_eq!(next(&slips[0]), [depth_m(&slips[1]), between(0, 1)]);
            assert_eq!(next(&slips[3]), [depth_m(&slips[2]), between(3, 2), depth_m(&slips[4]), between(3, 4)]);
            // A boundary of layers is nowhere but where one is declared.
            let boundaries = competition.instances.iter().filter(|i| i.kind == "interface_depth");
            assert!(boundaries.map(|own| competition.next_to(own).len()).all(|count| count <= 2));
            // Nothing slips in records of what is declared.
            let (by, _) = competition.around(&competition.fits[0]).unwrap();
            let model = Model { declared: competition.fits[0].model.declared, effects: vec![slips[3].clone()] };
            let x = [vec![0.0; model.declared.len()], slips[3].start()].concat();
            let base = by.fit(Start::at(model, x), Stop::WHERE_IT_IS).unwrap();
            let rivals = competition.rivals(&by, &base);
            for place in [&slips[2], &slips[4]] {
                assert!(rivals.iter().any(|fit| fit.model.index_of(place).is_some()), "{}", depth_m(place));
            }
        });
    }
}
