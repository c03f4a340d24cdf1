//! Which effects of a model are claimed: those whose interval holds no effect are recalibrated with what is declared.

use super::Answer;
use super::kinds::{is_taken, kinds, known_kinds, limited};
use crate::effects::Instance;
use crate::inference::intervals::{Member, may_be_none};
use crate::inference::posterior::Fit;

/// Indices of the named effects of a model.
#[derive(Debug, PartialEq)]
pub(super) struct Claims {
    /// Those that are claimed.
    pub claimed: Vec<usize>,
    /// The others: those that may be none, and those beside which others that do alike are probable too. Without them the claimed ones
    /// would have to stand in for what the records ask of them.
    pub besides: Vec<usize>,
}

impl<'a> Answer<'_, 'a> {
    /// A known kind, and how often it is there without one whose interval holds no effect. Evidence takes events for independent and the
    /// model for right up to what is expected of residuals; where events disagree more than that, it is sure of too much, and the
    /// interval, which is theirs, is not.
    ///
    /// Source: Kent (1982), doi 10.1093/biomet/69.1.19, for likelihood ratios of models that are not quite right.
    pub(super) fn doubtful(&self) -> Option<(&'static str, usize)> {
        let known = known_kinds(&self.masses());
        let sure = self.sure(&known)?;
        let members = self.members(sure);
        let index = self
            .claims(sure, known.clone(), &members)
            .claimed
            .into_iter()
            .find(|index| may_be_none(sure, *index, &members))?;
        let instance = &sure.model.effects[index];
        Some((instance.kind, known.iter().filter(|kind| **kind == instance.kind).count() - 1))
    }

    /// Kinds of the effects of `fit` that are claimed.
    pub(super) fn claimed_kinds(&self, fit: &Fit<'a>) -> Vec<&'static str> {
        limited(kinds(&fit.model.effects), self.most)
    }

    /// The effects of `fit`, one of `members`, of the `named` kinds, and the others.
    pub(super) fn claims(&self, fit: &Fit<'a>, named: Vec<&'static str>, members: &[Member<'_, 'a>]) -> Claims {
        Claims::of(&fit.model.effects, named, |index| may_be_none(fit, index, members))
    }

    /// What is not named because it is [`Self::doubtful`], in a sentence.
    pub(super) fn not_named(&self) -> Option<String> {
        let why = "Not named, because the 95 % interval of its strength holds no effect";
        sentence(why, self.most.keys())
    }
}

impl Claims {
    /// As many of `effects` as the kinds that are `claimed`, the doubtful ones last.
    fn of(effects: &[Instance], mut claimed: Vec<&'static str>, may_be_none: impl Fn(usize) -> bool) -> Self {
        let named = (0..effects.len()).filter(|i| effects[*i].is_named());
        let (doubted, sure): (Vec<usize>, Vec<usize>) = named.partition(|i| may_be_none(*i));
        let (mut claimed, mut besides): (Vec<usize>, Vec<usize>) =
            sure.into_iter().chain(doubted).partition(|i| is_taken(&mut claimed, effects[*i].kind));
        claimed.sort_unstable();
        besides.sort_unstable();
        Self { claimed, besides }
    }

    /// What of `fit` is recalibrated beside what is claimed: declared values within their tolerances that are not part of that, and the
    /// effects besides.
    pub fn recalibrated(&self, fit: &Fit<'_>) -> Vec<toml::Table> {
        let (declared, effects) = (fit.model.declared, &fit.model.effects);
        let has_total = |index: &&usize| fit.model.total(&fit.x, **index).is_some();
        let whole: Vec<&Instance> = self.claimed.iter().filter(has_total).map(|index| &effects[*index]).collect();
        let tables = declared.tables_beside(&fit.x[..declared.len()], &whole).into_iter();
        tables.chain(self.besides.iter().map(|index| fit.model.effect_table(&fit.x, *index))).collect()
    }

    /// The effects of `fit` besides in a sentence.
    pub fn not_left_out(&self, fit: &Fit<'_>) -> Option<String> {
        let own = self.besides.iter().map(|index| &fit.model.effects[*index].kind);
        sentence("Recalibrated with what is declared, because the records ask for it all the same", own)
    }
}

/// What holds of some kinds, if there are any.
fn sentence<'k>(what: &str, kinds: impl Iterator<Item = &'k &'static str>) -> Option<String> {
    let named: Vec<String> = kinds.map(|kind| kind.replace('_', " ")).collect();
    (!named.is_empty()).then(|| format!("{what}: {}.", named.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{Truth, problem};
    use super::*;
    use crate::effects;

    #[test]
    fn what_may_be_none_is_claimed_last_and_kept() {
        let array = problem(&Truth::default()).array;
        let all: Vec<Instance> = effects::instances(&array).into_iter().filter(|i| i.is_named()).collect();
        let kind = all.iter().map(|i| i.kind).find(|k| all.iter().filter(|i| i.kind == *k).count() > 1).unwrap();
        let other = all.iter().find(|i| i.kind != kind).unwrap().clone();
        let mut effects: Vec<Instance> = all.iter().filter(|i| i.kind == kind).take(2).cloned().collect();
        effects.insert(1, other.clone());
        let of = |claimed: &[&'static str], doubted: &[usize]| {
            let Claims { claimed, besides } = Claims::of(&effects, claimed.to_vec(), |i| doubted.contains(&i));
            [claimed, besides]
        };
        assert_eq!(of(&[kind, kind, other.kind], &[]), [vec![0, 1, 2], vec![]]);
        assert_eq!(of(&[kind, other.kind], &[0]), [vec![1, 2], vec![0]]);
        assert_eq!(of(&[kind, other.kind], &[2]), [vec![0, 1], vec![2]]);
        assert_eq!(of(&[kind, kind], &[1]), [vec![0, 2], vec![1]]);
        assert_eq!(of(&[], &[0, 1, 2]), [vec![], vec![0, 1, 2]]);
    }
}
