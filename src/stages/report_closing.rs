//! From a diagnosis and a comparison to the report's section on closing the loop.

use super::{compare, diagnose};
use crate::diagnosis::{self, DeclaredValue, Diagnosis, Estimate, Six, Summary, Verdict};
use crate::effects::{self, Class};
use crate::error::Result;
use crate::metrics::{BiasSigma, LnRatio, SensorTransfer};
use crate::pipeline::Task;
use crate::records::Split;
use crate::report::content::{
    Candidate, Change, Closing, DeclaredRow, ErrorRow, Field, FieldRow, Generic, Interval, Model, NamedEffect, Rest,
    TransferRow,
};

/// The section's content, where the pipeline closes the loop.
///
/// # Errors
/// When an output cannot be read.
pub fn content(task: &Task<'_>) -> Result<Option<Closing>> {
    if !(task.has_input("diagnose") && task.has_input("compare")) {
        return Ok(None);
    }
    let diagnosis = diagnose::read(task.input("diagnose")?)?;
    let found = compare::read(task.input("compare")?)?;
    Ok(Some(closing(&diagnosis, &found.errors, &found.summary, found.generic.as_ref())))
}

/// The same from a diagnosis and what was compared.
pub fn closing(
    diagnosis: &Diagnosis,
    errors: &[diagnosis::ErrorRow],
    summary: &Summary,
    generic: Option<&super::generic::Generic>,
) -> Closing {
    let medians = list(&summary.test_median_nrmse_percent);
    let intervals = list(&summary.test_ci95_nrmse_percent);
    let means = list(&summary.test_mean_nrmse_percent);
    let models = NAMES.iter().zip(medians.into_iter().zip(means.into_iter().zip(intervals)));
    let errors = errors.iter().map(|row| ErrorRow {
        event: row.event.clone(),
        component: row.component.clone(),
        sensor: row.sensor.clone(),
        is_held_out: row.split == Split::Test,
        nrmse_percent: list(&row.nrmse_percent),
    });
    let generic = generic.map(|g| {
        let of = g.test_median_nrmse_percent;
        let models = [
            ("Finite elements, a smooth factor for each sensor", [of.fe, of.fe_generic]),
            ("FLARE-T, more terms in the latent equations", [of.flare_t, of.flare_t_generic]),
        ];
        let models = models.into_iter().filter(|(_, [_, with])| with.is_some());
        Generic {
            models: models.map(|(name, medians)| (name.to_string(), medians)).collect(),
            changes: g.changes.iter().map(change).collect(),
            notes: g.notes(),
        }
    });
    Closing {
        verdict: word(diagnosis.verdict).into(),
        effects: named(diagnosis),
        ambiguity: diagnosis.ambiguity.iter().map(|kind| (kind.clone(), key(kind))).collect(),
        candidates: candidates(diagnosis),
        explained_share: diagnosis.explained_share,
        models: models
            .map(|(name, (median_percent, (mean_percent, ci95_percent)))| Model {
                name: (*name).into(),
                median_percent,
                mean_percent,
                ci95_percent,
            })
            .collect(),
        errors: errors.collect(),
        ablation_percent: summary.test_median_ablation_percent,
        changes: summary.changes.iter().filter(|c| c.is_told()).map(change).collect(),
        field: field(summary),
        transfer: transfer(summary),
        declared: diagnosis.declared.iter().map(declared).collect(),
        hidden: diagnosis.hidden.clone(),
        rest: diagnosis.rest.as_ref().map(rest),
        generic,
        notes: diagnosis.notes.clone(),
    }
}

const NAMES: [&str; 7] =
    ["FE declared", "FE recalibrated", "FE corrected", "FLARE-T before", "FLARE-T after", "Noise floor", "Ceiling"];
/// Models of the field's measures with their names for people, in the order of a loop.
const MEASURED: [(&str, &str); 7] = [
    ("declared", "FE declared"),
    ("recalibrated", "FE recalibrated"),
    ("corrected", "FE corrected"),
    ("flare_before", "FLARE-T before"),
    ("flare_after", "FLARE-T after"),
    ("ceiling", "Ceiling"),
    ("other_component", "Other horizontal"),
];

fn field(summary: &Summary) -> Option<Field> {
    let pair = |of: Option<BiasSigma>| of.map(|v| [v.bias, v.sigma]);
    let bands = |of: &LnRatio| of.bias.iter().zip(&of.sigma).map(|(b, s)| Some([(*b)?, (*s)?])).collect();
    let row = |(key, name): &(&str, &str)| {
        let of = summary.test_measures.get(*key)?;
        Some(FieldRow {
            model: (*name).into(),
            fourier_rms: of.ln_fourier_by_hz.rms,
            psa_rms: of.ln_psa_by_s.rms,
            ratios: [of.ln_pga, of.ln_pgv, of.ln_arias, of.ln_duration_5_75, of.ln_duration_5_95].map(pair).to_vec(),
            anderson: of.anderson,
            fourier: bands(&of.ln_fourier_by_hz),
            psa: bands(&of.ln_psa_by_s),
        })
    };
    let rows: Vec<FieldRow> = MEASURED.iter().filter_map(row).collect();
    let (fourier_bands_hz, psa_bands_s) = (summary.fourier_bands_hz.clone(), summary.psa_bands_s.clone());
    (!rows.is_empty()).then_some(Field { fourier_bands_hz, psa_bands_s, rows })
}

fn transfer(summary: &Summary) -> Vec<TransferRow> {
    let of = |place: &SensorTransfer| {
        let row = |(key, name): &(&str, &str)| {
            let fit = place.models.get(*key)?.clone()?;
            Some(TransferRow {
                component: place.component.clone(),
                sensor: place.sensor.clone(),
                model: (*name).into(),
                letters: fit.letters,
                r: fit.r,
                sigma: fit.sigma,
                n_event: fit.n_event,
            })
        };
        MEASURED.iter().filter_map(row).collect::<Vec<_>>()
    };
    summary.transfer.iter().flat_map(of).collect()
}

fn change(c: &crate::diagnosis::Change) -> Change {
    Change {
        measure: c.measure,
        from: c.from.clone(),
        to: c.to.clone(),
        mean: c.mean,
        ci95: c.ci95,
        sign_test_p: c.sign_test_p,
        is_improved: c.is_improved,
        n_event: c.n_event,
    }
}

fn list<T: Copy>(six: &Six<T>) -> Vec<T> {
    six.named().iter().map(|(_, value)| **value).collect()
}

fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::None => "none",
        Verdict::Known => "known",
        Verdict::Ambiguous => "ambiguous",
        Verdict::Unknown => "unknown",
    }
}

fn class(class: Class) -> String {
    match class {
        Class::Soil => "soil",
        Class::Boundary => "boundary",
        Class::Sensor => "sensor",
        Class::Field => "field",
    }
    .into()
}

fn about(kind: &str) -> String {
    effects::find(kind).map_or(String::new(), |entry| entry.about.into())
}

fn phrases(kind: &str) -> Vec<String> {
    effects::find(kind).map_or_else(|_| Vec::new(), |entry| entry.phrases.iter().map(|p| (*p).into()).collect())
}

fn key(kind: &str) -> String {
    effects::find(kind).map_or(String::new(), |entry| entry.catalogue.key.into())
}

fn interval(estimate: &Estimate) -> Interval {
    let Estimate { value, ci95, by_prior, .. } = *estimate;
    Interval { value, unit: estimate.unit.clone(), ci95, by_prior }
}

fn declared(found: &DeclaredValue) -> DeclaredRow {
    DeclaredRow {
        kind: found.kind.clone(),
        target: found.target.clone(),
        parameter: found.parameter.clone(),
        is_at_end: found.is_at_end,
        estimate: interval(&found.estimate),
        by_records: found.by_records.as_ref().map(interval),
    }
}

fn named(diagnosis: &Diagnosis) -> Vec<NamedEffect> {
    let effect = |e: &crate::diagnosis::Found| NamedEffect {
        kind: e.kind.clone(),
        about: about(&e.kind),
        phrases: phrases(&e.kind),
        target: e.target.clone(),
        class: class(e.class),
        parameters: e.parameters.iter().map(|(name, estimate)| (name.clone(), interval(estimate))).collect(),
        p_value: e.p_value,
    };
    diagnosis.effects.iter().map(effect).collect()
}

fn candidates(diagnosis: &Diagnosis) -> Vec<Candidate> {
    let candidate = |c: &crate::diagnosis::Candidate| Candidate {
        kind: c.kind.clone(),
        target: c.target.clone(),
        class: class(c.class),
        round: c.round,
        gain: c.gain,
        validation_gain: c.validation_gain,
        explained_share: c.explained_share,
    };
    diagnosis.candidates.iter().map(candidate).collect()
}

fn rest(rest: &crate::diagnosis::Rest) -> Rest {
    Rest {
        sentence: rest.sentence(),
        share: rest.share,
        repeatable_share: rest.repeatable_share,
        coherence: rest.coherence.iter().map(|(sensor, c)| (sensor.clone(), c.clone())).collect(),
    }
}
