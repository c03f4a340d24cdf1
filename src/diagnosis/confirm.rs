//! Confirms what a round found: replays of the best effects, from where they were fitted or from where they lead.

use super::anchor::Anchor;
use super::axes;
use super::problem::Roughly;
use super::round::{Fitted, Plain};
use super::search::{Model, Search};
use crate::effects::Instance;
use crate::error::Result;
use crate::numerics::threads::on_threads;
use crate::progress::Progress;

/// Share of the best gain above which the runner-up is confirmed too.
const CLOSE_SHARE: f64 = 0.7;
/// The same for another place of a kind that is confirmed.
const SAME_SHARE: f64 = 0.9;
/// Most rough replays of every effect then, of the better half, and of the better half of these.
const ROUGHLY: [usize; 3] = [1, 2, 3];
/// Share of the best fall of the cost below which the last of them are not worth it.
const PROMISING: f64 = 0.3;
/// Steps of a fit before them.
const ROUGH_STEPS: usize = 6;
/// Most replays of an effect to be confirmed.
const REPLAYS: usize = 6;

impl Search<'_> {
    /// Replays the best, and then whatever is close behind or has become the best, and fits again from there; the anchor
    /// of the best. Where none of these keeps what it promised from the declared values, those fitted `near_base` have
    /// their turn, and only what they gain on the replayed base counts.
    pub(super) fn confirm(
        &self,
        fitted: &mut Vec<Fitted>,
        near_base: Vec<Fitted>,
        from: (&Model, &Anchor, &[Plain<'_>]),
        progress: &dyn Progress,
    ) -> Result<Option<Anchor>> {
        let mut anchors: Vec<(Instance, Anchor)> = Vec::new();
        let base = from.0;
        if self.replay.is_none() {
            return Ok(None);
        }
        self.replay_best(fitted, &mut anchors, from, progress)?;
        if fitted.first().is_some_and(|f| f.gain > 0.0 && !f.is_confirmed) {
            fitted.extend(near_base);
            for f in fitted.iter_mut() {
                f.against = base.costs();
            }
            self.judge(fitted, base);
            self.replay_best(fitted, &mut anchors, from, progress)?;
        }
        let best = fitted.first().filter(|f| f.is_confirmed).map(|f| &f.instance);
        Ok(anchors.into_iter().rev().find(|(instance, _)| Some(instance) == best).map(|(_, anchor)| anchor))
    }

    /// Lets rough replays correct what is promised of effects of the soil, and sorts them again: every one is replayed once, the
    /// better half from each place again, and so on.
    fn try_roughly(
        &self,
        fitted: &mut Vec<Fitted>,
        (base, near_base, plain): (&Model, &Anchor, &[Plain<'_>]),
        progress: &dyn Progress,
    ) -> Result<()> {
        let Some(replay) = self.replay.map(Roughly) else { return Ok(()) };
        let places = (0..plain.len()).map(Some).chain([None]);
        for place in places {
            let (scene, near) = place.map_or((self.scene, near_base), |i| (plain[i].search.scene, &plain[i].anchor));
            let search = Search::new(scene, self.settings, Some(&replay))?;
            let is_here = |f: &Fitted| f.plain == place && axes::is_followable(&f.instance);
            let mut tries: Vec<(usize, Model, Anchor)> = fitted
                .iter()
                .enumerate()
                .filter(|(_, f)| is_here(f))
                .map(|(i, f)| (i, f.model.clone(), near.clone()))
                .collect();
            for (round, most) in ROUGHLY.into_iter().enumerate() {
                let run = |k: usize| {
                    let (i, model, anchor) = &tries[k];
                    let again = || search.settle(&model.effects, model.x(), anchor, Some(model), ROUGH_STEPS);
                    // They come fitted.
                    let start = if round == 0 { Ok(model.clone()) } else { again() };
                    let found = start.and_then(|s| search.replayed(s, (None, anchor), (most, f64::INFINITY), progress));
                    // Where the column does not finish, the promise stands, and is judged by its replay.
                    found.ok().map(|(model, anchor)| (*i, model, anchor))
                };
                tries = on_threads(tries.len(), run).into_iter().flatten().collect();
                for (i, model, _) in &tries {
                    fitted[*i].model = model.clone();
                    fitted[*i].against = base.costs();
                }
                tries.sort_by(|a, b| a.1.cost().total_cmp(&b.1.cost()));
                tries.truncate(tries.len().div_ceil(2));
                let best = tries.first().map_or(0.0, |best| base.cost() - best.1.cost());
                if round > 0 && best > 0.0 {
                    tries.retain(|other| base.cost() - other.1.cost() > PROMISING * best);
                }
            }
            for (i, model, anchor) in tries {
                fitted[i].model = search.settle(&model.effects, model.x(), &anchor, Some(&model), ROUGH_STEPS)?;
            }
        }
        self.judge(fitted, base);
        Ok(())
    }

    /// Looks around where the effect of `wanted` is, settles it there, and sees it from here.
    fn seen_from_there(&self, wanted: &Model, progress: &dyn Progress) -> Result<(Model, Anchor)> {
        let Some(replay) = self.replay else { return Ok((wanted.clone(), Anchor::fast(self.scene))) };
        let mut there = self.scene.clone();
        let place = (&wanted.effects[..], wanted.x());
        let found = there.settled_around(place, (replay, REPLAYS), self.settings, progress)?.0;
        self.seen(&found)
    }

    /// Settles `wanted` by another search, and sees it from here.
    fn seen_from_here(
        &self,
        search: &Search<'_>,
        wanted: Model,
        (anchor, limits): (&Anchor, (usize, f64)),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let found = search.replayed_until_settled(wanted, (None, anchor), limits, progress)?.0;
        self.seen(&found)
    }

    /// `found` by another search, replayed and seen from here.
    fn seen(&self, found: &Model) -> Result<(Model, Anchor)> {
        let anchor = self.anchored(&found.effects, found.x(), None)?;
        Ok((self.settle(&found.effects, found.x(), &anchor, None, 0)?, anchor))
    }

    /// Replays the best of `fitted` and what is close behind, as many as may be.
    fn replay_best(
        &self,
        fitted: &mut Vec<Fitted>,
        anchors: &mut Vec<(Instance, Anchor)>,
        (base, near_base, plain): (&Model, &Anchor, &[Plain<'_>]),
        progress: &dyn Progress,
    ) -> Result<()> {
        let is_far = base.is_far();
        if is_far {
            self.try_roughly(fitted, (base, near_base, plain), progress)?;
        }
        for done in 0..=self.settings.confirmed {
            let Some(index) = self.next_to_confirm(fitted, done) else { break };
            let f = &mut fitted[index];
            let limits = (REPLAYS, base.cost());
            let wanted = f.model.clone();
            let found = match f.plain.map(|i| &plain[i]) {
                _ if is_far && axes::is_followable(&f.instance) => self.seen_from_there(&wanted, progress),
                Some(Plain { search, anchor, .. }) => self.seen_from_here(search, wanted, (anchor, limits), progress),
                None => self.replayed_until_settled(wanted, (None, near_base), limits, progress),
            };
            let Ok((model, anchor)) = found else {
                let f = fitted.remove(index);
                progress.note(&format!("{} {}: the column does not finish", f.instance.kind, f.instance.place()));
                continue;
            };
            f.model = model;
            f.is_confirmed = true;
            f.against = base.costs();
            anchors.push((f.instance.clone(), anchor));
            self.judge(fitted, base);
        }
        Ok(())
    }

    /// The best if it is not confirmed, else the first of another kind or place that is close behind.
    fn next_to_confirm(&self, fitted: &[Fitted], done: usize) -> Option<usize> {
        let best = fitted.first().filter(|f| f.gain > 0.0)?;
        if !best.is_confirmed {
            return Some(0);
        }
        let kinds: Vec<&str> = fitted.iter().filter(|f| f.is_confirmed).map(|f| f.instance.kind).collect();
        let is_open = |f: &Fitted| {
            let close = if kinds.contains(&f.instance.kind) { SAME_SHARE } else { CLOSE_SHARE };
            !f.is_confirmed && f.gain >= close * best.gain
        };
        if done < self.settings.confirmed { fitted.iter().position(is_open) } else { None }
    }
}
