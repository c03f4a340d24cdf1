//! What could be taken for an effect, fitted in its place: the place of what is named is claimed with it.

use super::scan::Ground;
use super::{Competition, FAR, FINALS, has_set, is_same_set};
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::inference::parameters::Model;
use crate::inference::posterior::{Fit, Fitter, Start, least_borne_out};
use crate::progress::Progress;

impl<'a> Competition<'a> {
    /// Fits what could be taken for each effect of the most probable model under `labels`, in its place, to all events: the place of what
    /// is named is claimed with it. Whether there is another most probable model now.
    pub(super) fn challenge(&mut self, labels: &[usize], progress: &dyn Progress) -> Result<bool> {
        let leading = self.leading(labels).clone();
        if has_set(&self.challenged, &leading.model.effects) {
            return Ok(false);
        }
        self.challenged.push(leading.model.effects.clone());
        let by = self.few.fitter(&self.fitter);
        let start = self.few.of(&by, &leading)?;
        let mut rivals = self.rivals(&by, &start);
        self.best_first(&mut rivals);
        let least = self.log_posterior(&start) - FAR;
        rivals.retain(|rival| self.log_posterior(rival) > least);
        for rival in rivals.into_iter().take(FINALS) {
            let model = Model { declared: leading.model.declared, effects: rival.model.effects };
            self.finish(Start::at(model, rival.x), progress);
        }
        Ok(!is_same_set(&leading.model.effects, &self.leading(labels).model.effects))
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
            let (model, x) = without(base, index);
            let grounds = [Ground::declared(by, model.clone(), x.clone()), Ground::new(by, model, x)];
            let mut found: Vec<Fit<'a>> = Vec::new();
            for ground in grounds.into_iter().flatten() {
                let there = ground.best_of_ladder(own).and_then(|(at, _)| ground.fitted(own, at));
                let Some(highest) = there.map(|there| self.log_posterior(&there)) else { continue };
                let all = self.scanned(&ground, self.instances.iter().filter(is_meant));
                let is_close = |fit: &Fit<'a>| least_borne_out(highest - self.log_posterior(fit)) < FAR;
                found.extend(all.into_iter().filter(is_close));
            }
            self.best_first(&mut found);
            let mut best: Vec<&Fit<'a>> = Vec::new();
            for fit in &found {
                if !best.iter().any(|known| known.model.effects.last() == fit.model.effects.last()) {
                    best.push(fit);
                }
            }
            Self::replayed(by, &best)
        };
        (0..base.model.effects.len()).flat_map(of).collect()
    }
}

/// The model of `base` and where it is, effect `index` left out.
fn without<'a>(base: &Fit<'a>, index: usize) -> (Model<'a>, Vec<f64>) {
    let (mut model, mut x) = (base.model.clone(), base.x.clone());
    x.drain(base.model.coordinates_of(index));
    model.effects.remove(index);
    (model, x)
}

/// Whether `other` could be taken for `own`: the catalogue of either knows them to be confused, or it is another place of the same.
fn is_rival(own: &Instance, other: &Instance) -> bool {
    let has = |one: &Instance, kind| effects::find(one.kind).is_ok_and(|e| e.catalogue.confused_with.contains(&kind));
    own.kind == other.kind || has(own, other.kind) || has(other, own.kind)
}
