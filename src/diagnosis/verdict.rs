//! From the path of a diagnosis to its verdict: known, ambiguous, unknown or none, with intervals and what remains.

use super::evidence::{Evidence, evidence, input_coherent_share};
use super::fit::Fitter;
use super::outcome::{Diagnosis, Estimate, Excess, Found, Thresholds, ToleranceAlarm, UpperBound, Verdict};
use super::path::Path;
use super::remainder::{remainder, strongest};
use super::round::Fitted;
use super::screen::{Marginal, derivative};
use super::search::{Model, Search};
use super::unknowns::nuisance_tables;
use crate::effects::{self, Instance};
use crate::error::Result;
use std::collections::BTreeMap;

/// Power of what is left, over noise's, above which it is not explained however much there was.
pub(super) const KNOWN_LEVEL: f64 = 2.0;
/// Share of the range of a parameter within which it is at its end.
const AT_END: f64 = 1e-3;
/// Normal quantile of a two-sided 95 % interval.
const TWO_SIDED: f64 = 1.96;

/// Standard deviations to either side that an interval reaches: as far as a model costs what 95 % leave open, and what replays cannot
/// tell apart,
///
/// ```text
/// x ± σ √(1.96² + a)
/// ```
///
/// a being the cost within which two effects count as indistinguishable: two replays that hardly differ cost as much more or less.
pub(super) fn reach(search: &Search<'_>) -> f64 {
    let unresolved = if search.replay.is_some() { search.settings.ambiguity } else { 0.0 };
    (TWO_SIDED * TWO_SIDED + unresolved).sqrt()
}

/// Everything a diagnosis says.
///
/// # Errors
/// When the last model cannot be evaluated.
pub(super) fn assemble(search: &Search<'_>, path: &Path, thresholds: &Thresholds) -> Result<Diagnosis> {
    let fitter = search.fitter(&path.anchor);
    let corrected = &path.corrected;
    let unknowns = search.unknowns(&corrected.effects);
    let deviations = fitter.deviations(&unknowns, &corrected.train, corrected.level());
    let excess = [&path.declared, &path.recalibrated, corrected].map(excess);
    let lost = path.recalibrated.excess();
    let explained_share = (!path.accepted.is_empty() && lost > 0.0)
        .then(|| ((path.recalibrated.cost() - corrected.cost()) / lost).clamp(0.0, 1.0));
    let ambiguity = ambiguity(search, path);
    let mut notes = Vec::new();
    let verdict = verdict(search, path, thresholds, explained_share, excess[2], &ambiguity, &mut notes);
    let is_named = !path.accepted.is_empty();
    let evidence = evidence(search, corrected, &path.anchor)?;
    notes.extend(unnamed(&evidence, verdict));
    let remainder = remainder(search, corrected);
    notes.extend(strongest(&remainder, verdict));
    let input_coherent_share = input_coherent_share(search, &path.recalibrated);
    notes.extend(unfollowing(input_coherent_share, verdict));
    notes.extend(strained(corrected));
    notes.extend(at_end_of_range(search, corrected).into_iter().map(|(instance, what)| {
        let name = format!("`{}` {}", instance.kind, instance.place());
        format!("{} is at the end of its range ({what}): it may stand for something else", name.trim())
    }));
    let nuisances = nuisance_tables(&search.nuisances, path.recalibrated.x());
    let corrected_nuisances = nuisance_tables(&search.nuisances, corrected.x());
    let upper_bounds = if is_named { Vec::new() } else { upper_bounds(search, &fitter, &path.recalibrated) };
    Ok(Diagnosis {
        verdict,
        effects: found(search, path, &deviations),
        ambiguity: if is_named { ambiguity } else { Vec::new() },
        nuisances,
        corrected_nuisances,
        candidates: path.candidates.clone(),
        explained_share,
        input_coherent_share,
        declared: excess[0],
        recalibrated: excess[1],
        corrected: excess[2],
        tolerance_alarms: tolerance_alarms(search, corrected, &deviations, thresholds),
        upper_bounds,
        remainder,
        evidence,
        notes,
        rest: None,
    })
}

/// How far tolerances went where that is the only reason why nothing but noise is left.
fn strained(model: &Model) -> Option<String> {
    model.is_strained().then(|| {
        format!(
            "nothing but noise is left because declared values are farther off than their tolerances let expect (squared deviations sum up to {:.0}, {} expected): they may stand for something without a name",
            model.prior(),
            model.n_nuisance()
        )
    })
}

/// What a correction without a name would take out, where the verdict is that nothing named explains the records.
fn unnamed(evidence: &Evidence, verdict: Verdict) -> Option<String> {
    let [before, after] =
        evidence.generic.values().fold([0.0, 0.0], |sum, c| [sum[0] + c.validation[0], sum[1] + c.validation[1]]);
    (verdict == Verdict::Unknown && before > 0.0).then(|| {
        format!(
            "a smooth factor for each sensor, which is no physics, would take {:.0} % off what this model leaves of the validation events' power",
            100.0 * (1.0 - after / before)
        )
    })
}

/// How little of what remains any linear correction could explain, where that is most of the answer.
fn unfollowing(share: Option<f64>, verdict: Verdict) -> Option<String> {
    let share = share.filter(|s| verdict == Verdict::Unknown && *s < 0.5)?;
    Some(format!(
        "{:.0} % of the residual follows the recorded input alike in all events: no correction of site or sensors that is the same in all of them could explain more",
        100.0 * share
    ))
}

/// Excess of `model` over noise alone.
pub(super) fn excess(model: &Model) -> Excess {
    let of = |cost: f64, expected: f64| (cost - expected) / (2.0 * expected).sqrt();
    Excess {
        train: of(model.train.cost, model.expected[0]),
        validation: of(model.validation_cost(), model.expected[1]),
    }
}

/// Kinds whose gain in the first round came within `ambiguity` of the best, those that say the same in the answer, and those that one
/// at the end of its range may stand for.
fn ambiguity(search: &Search<'_>, path: &Path) -> Vec<String> {
    let best = path.first.first().map_or(f64::INFINITY, |best| best.gain);
    let close = path.first.iter().filter(|f| best - f.gain < search.settings.ambiguity && f.gain > 0.0);
    let named = path.accepted.iter().filter(|_| !path.stand_ins.is_empty());
    let mut all: Vec<&str> = close.chain(named).map(|f| f.instance.kind).collect();
    all.extend(path.stand_ins.iter().map(String::as_str));
    for (instance, _) in at_end_of_range(search, &path.corrected) {
        all.push(instance.kind);
        all.extend(effects::find(instance.kind).into_iter().flat_map(|e| e.catalogue.confused_with));
    }
    let mut kinds: Vec<String> = Vec::new();
    for kind in all {
        if !kinds.iter().any(|k| k == kind) {
            kinds.push(kind.to_string());
        }
    }
    kinds
}

/// Effects of `model` with a parameter at an end of its range that is not their absence, and that parameter.
fn at_end_of_range<'m>(search: &Search<'_>, model: &'m Model) -> Vec<(&'m Instance, String)> {
    let unknowns = search.unknowns(&model.effects);
    let end = |(k, instance): (usize, &'m Instance)| {
        let zero = instance.zero().unwrap_or_default();
        let own = model.x()[unknowns.start(k)..].iter().zip(&instance.free).enumerate();
        let parameters = own.filter_map(|(i, (x, free))| {
            let [low, high] = free.parameter.bounds();
            let is_end = |end: f64| (x - end).abs() < AT_END * (high - low) && zero.get(i) != Some(&end);
            let p = free.parameter;
            (is_end(low) || is_end(high))
                .then(|| format!("{} = {:.3} {}", p.name, p.value(*x), p.unit).trim().to_string())
        });
        let parameters: Vec<String> = parameters.collect();
        (!parameters.is_empty()).then(|| (instance, parameters.join(", ")))
    };
    model.effects.iter().enumerate().filter_map(end).collect()
}

fn verdict(
    search: &Search<'_>,
    path: &Path,
    thresholds: &Thresholds,
    explained: Option<f64>,
    rest: Excess,
    ambiguity: &[String],
    notes: &mut Vec<String>,
) -> Verdict {
    let settings = search.settings;
    let remains = rest.validation > thresholds.excess;
    let Some(share) = explained.filter(|_| !path.accepted.is_empty()) else {
        if !remains {
            return Verdict::None;
        }
        notes.push(format!(
            "structure remains on the validation events ({:.1} standard deviations, null twins stay below {:.1}), and no named effect pays for itself",
            rest.validation, thresholds.excess
        ));
        return Verdict::Unknown;
    };
    let level = path.corrected.level();
    if share < settings.unknown_share || (remains && (share < settings.known_share || level > KNOWN_LEVEL)) {
        notes.push(format!(
            "the named effects explain {:.0} % of the excess; what remains has no name in the catalogue and {level:.1} times the power of noise",
            100.0 * share
        ));
        return Verdict::Unknown;
    }
    if remains {
        notes.push(format!("beside the named effects, {:.0} % of the excess remains", 100.0 * (1.0 - share)));
    }
    if ambiguity.len() > 1 {
        let keys = ambiguity.iter().filter_map(|kind| {
            let entry = effects::find(kind).ok()?;
            Some(format!("`{kind}` shows by: {}", entry.catalogue.key))
        });
        notes.extend(keys);
        return Verdict::Ambiguous;
    }
    Verdict::Known
}

/// The named effects; intervals reach over all models that explain as much.
fn found(search: &Search<'_>, path: &Path, deviations: &[f64]) -> Vec<Found> {
    let reach = reach(search);
    let mut at = search.nuisances.len();
    let x = path.corrected.x();
    let of = |(instance, accepted): (&effects::Instance, &Fitted)| {
        let own = at..at + instance.free.len();
        at = own.end;
        let parameters = instance
            .free
            .iter()
            .zip(own.clone())
            .map(|(free, i)| {
                let p = free.parameter;
                let all = || path.alternatives.iter().map(|a| a[i]).chain([[x[i], deviations[i]]]);
                let low = all().map(|[x, d]| x - reach * d).fold(f64::INFINITY, f64::min);
                let high = all().map(|[x, d]| x + reach * d).fold(f64::NEG_INFINITY, f64::max);
                let ends = [low, high].map(|end| p.value(clamped(end, p.bounds())));
                let ci95 = if ends[0] <= ends[1] { ends } else { [ends[1], ends[0]] };
                (p.name.to_string(), Estimate { value: p.value(x[i]), unit: p.unit.to_string(), ci95 })
            })
            .collect();
        Found {
            kind: instance.kind.to_string(),
            target: instance.place(),
            class: instance.class(),
            table: instance.at(&x[own]),
            parameters,
            gain: accepted.gain,
            validation_gain: accepted.validation_gain,
            is_standing: false,
        }
    };
    path.corrected.effects.iter().zip(&path.accepted).map(of).collect()
}

fn clamped(x: f64, [low, high]: [f64; 2]) -> f64 {
    x.clamp(low, high)
}

fn tolerance_alarms(
    search: &Search<'_>,
    model: &Model,
    deviations: &[f64],
    thresholds: &Thresholds,
) -> Vec<ToleranceAlarm> {
    let of = |(i, nuisance): (usize, &super::unknowns::Nuisance)| {
        let x = model.x()[i];
        if x.abs() <= thresholds.deviations {
            return None;
        }
        let half = reach(search) * deviations[i];
        let ci95 = [nuisance.value(x - half), nuisance.value(x + half)];
        let unit = nuisance.parameter().unit.to_string();
        Some(ToleranceAlarm {
            what: nuisance.what(),
            deviations: x,
            estimate: Estimate { value: nuisance.value(x), unit, ci95 },
        })
    };
    search.nuisances.iter().enumerate().filter_map(of).collect()
}

/// The strength of each effect that its 95 % interval leaves open, linear about the recalibrated model.
fn upper_bounds(search: &Search<'_>, fitter: &Fitter<'_>, model: &Model) -> Vec<UpperBound> {
    let unknowns = search.unknowns(&model.effects);
    let marginal = Marginal::new(fitter, &unknowns, &model.train);
    let mut bounds: BTreeMap<(String, String), UpperBound> = BTreeMap::new();
    for instance in &search.instances {
        let (Some(free), Some(zero)) = (instance.free.first(), instance.zero()) else { continue };
        let Some(column) = derivative(fitter, &unknowns, &model.train, instance, &zero) else { continue };
        let Some((step, normal)) = marginal.score(&model.train.residual, &column) else { continue };
        let deviation = 1.0 / normal[(0, 0)].sqrt();
        let size = step[0].abs() + reach(search) * deviation;
        let p = free.parameter;
        let toward = if zero[0] + size <= p.bounds()[1] { zero[0] + size } else { p.bounds()[1] };
        let bound = UpperBound {
            kind: instance.kind.to_string(),
            target: instance.place(),
            parameter: p.name.to_string(),
            value: p.value(toward),
            unit: p.unit.to_string(),
        };
        bounds.entry((bound.kind.clone(), bound.target.clone())).or_insert(bound);
    }
    bounds.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Uniform, judged, path};
    use super::super::responses::Scene;
    use super::super::settings::DiagnoseSettings;
    use super::*;

    #[test]
    fn what_is_at_the_end_of_its_range_may_be_something_else() {
        let (problem, settings) = (judged(""), DiagnoseSettings::default());
        let scene = Scene::new(&problem, &settings).unwrap();
        let replay = Uniform(&problem);
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let is_alpha = |i: &&Instance| i.free.len() == 1 && i.free[0].parameter.name == "alpha_1_s";
        let effects = [search.instances.iter().find(is_alpha).unwrap().clone()];
        let [low, high] = effects[0].bounds()[0];
        let kinds_at = |alpha: f64| {
            let mut x = vec![0.0; search.nuisances.len()];
            x.push(alpha);
            let anchor = search.anchored(&effects, &x, None).unwrap();
            let model = search.settle(&effects, &x, &anchor, None, 0).unwrap();
            ambiguity(&search, &path(model, anchor))
        };
        assert!(kinds_at(0.5 * (low + high)).is_empty());
        assert!(kinds_at(effects[0].zero().unwrap()[0]).is_empty(), "absence is no end");
        let kinds = kinds_at(high);
        assert!(kinds.len() > 1 && kinds.iter().any(|k| k == "small_strain_damping"), "{kinds:?}");
    }

    #[test]
    fn what_leaves_far_more_than_noise_is_not_known_however_much_it_explains() {
        let (problem, settings) = (judged(""), DiagnoseSettings::default());
        let scene = Scene::new(&problem, &settings).unwrap();
        let replay = Uniform(&problem);
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let effects = [search.instances.iter().find(|i| i.kind == "layer_velocity").unwrap().clone()];
        let velocity = search.nuisances.iter().rposition(|n| n.instance.kind == "layer_velocity").unwrap();
        let damping = search.nuisances.iter().position(|n| n.instance.kind == "small_strain_damping").unwrap();
        let verdict_of = |ln_velocity: f64, thresholds: &Thresholds| {
            let mut x = vec![0.0; search.nuisances.len() + 1];
            x[velocity] = ln_velocity / search.nuisances[velocity].deviation;
            x[damping] = 1.5f64.ln() / search.nuisances[damping].deviation;
            let anchor = search.anchored(&effects, &x, None).unwrap();
            let model = search.settle(&effects, &x, &anchor, None, 0).unwrap();
            let (level, rest) = (model.level(), excess(&model));
            let path = path(model, anchor);
            (verdict(&search, &path, thresholds, Some(0.99), rest, &[], &mut Vec::new()), level)
        };
        // The truth has 150 m/s and a damping ratio of 0.03, declared are 200 and 0.02.
        let thresholds = Thresholds {
            gain: 5.0,
            validation_gain: 5.0,
            excess: -100.0,
            deviations: 3.0,
            twins: 0,
            null_gains: Vec::new(),
        };
        let (near, level) = verdict_of(0.75f64.ln(), &thresholds);
        assert!(near == Verdict::Known && level < KNOWN_LEVEL, "{near:?} {level}");
        let (far, level) = verdict_of(0.7f64.ln(), &thresholds);
        assert!(far == Verdict::Unknown && level > KNOWN_LEVEL, "{far:?} {level}");
    }
}
