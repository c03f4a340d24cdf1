//! Arrays that belong together must agree before anything is drawn.

use super::content::{Content, Losses, Series, Trace};
use crate::{Error, Result};

/// Reports the first disagreement, with its place.
pub(super) fn lengths(content: &Content) -> Result<()> {
    if let Some(motions) = &content.motions {
        for (label, example) in &motions.examples {
            series(example, &format!("motion `{label}`"))?;
        }
    }
    if let Some(stage) = &content.pretrain {
        if let Some(field) = &stage.field {
            let place = format!("field of case `{}`", field.case);
            positive(field.step_s, &place)?;
            let n_depth = field.depth_m.len();
            if n_depth == 0 || field.fe_m_s2.len() % n_depth != 0 {
                return Err(unequal(field.fe_m_s2.len(), "values", n_depth, "depths", &place));
            }
            same(field.fe_m_s2.len(), "finite-element values", field.model_m_s2.len(), "predicted values", &place)?;
        }
        losses(stage.losses.as_ref(), "stage 1")?;
    }
    if let Some(stage) = &content.distill {
        for trace in &stage.traces {
            traces(trace, "stage 2")?;
        }
        losses(stage.losses.as_ref(), "stage 2")?;
    }
    for stage in &content.calibrate {
        let place = format!("calibration of component `{}`", stage.component);
        same(stage.before.len(), "equations before", stage.after.len(), "after", &place)?;
        for row in stage.before.iter().chain(&stage.after) {
            same(row.len(), "coefficients", stage.terms.len(), "library terms", &place)?;
        }
        losses(stage.losses.as_ref(), &place)?;
    }
    for prediction in &content.held_out {
        for trace in &prediction.traces {
            traces(trace, &format!("event `{}`, component `{}`", prediction.event, prediction.component))?;
        }
    }
    Ok(())
}

fn traces(trace: &Trace, place: &str) -> Result<()> {
    let place = format!("sensor `{}` of {place}", trace.sensor);
    for one in [&trace.record, &trace.fe, &trace.flare_t].into_iter().flatten() {
        series(one, &place)?;
    }
    if let Some(spectrum) = &trace.spectrum {
        for values in [&spectrum.record_m_s2, &spectrum.fe_m_s2, &spectrum.flare_t_m_s2] {
            if !values.is_empty() {
                same(values.len(), "spectral values", spectrum.period_s.len(), "periods", &place)?;
            }
        }
        if let Some(period) = spectrum.period_s.iter().find(|p| !(p.is_finite() && **p > 0.0)) {
            return Err(Error::new(format!("a period must be positive, got {period} s")).at(place));
        }
    }
    Ok(())
}

fn losses(losses: Option<&Losses>, place: &str) -> Result<()> {
    match losses.into_iter().flat_map(|l| &l.terms).find(|t| t.points.iter().any(|p| !p.0.is_finite())) {
        Some(term) => {
            Err(Error::new("the counter of a loss must be finite").at(format!("loss `{}` of {place}", term.name)))
        }
        None => Ok(()),
    }
}

fn series(series: &Series, place: &str) -> Result<()> {
    positive(series.step_s, place)
}

fn positive(step_s: f64, place: &str) -> Result<()> {
    if step_s.is_finite() && step_s > 0.0 {
        return Ok(());
    }
    Err(Error::new(format!("the time step must be positive, got {step_s} s")).at(place))
}

fn same(n: usize, what: &str, m: usize, other: &str, place: &str) -> Result<()> {
    if n == m { Ok(()) } else { Err(unequal(n, what, m, other, place)) }
}

fn unequal(n: usize, what: &str, m: usize, other: &str, place: &str) -> Error {
    Error::new(format!("{n} {what} do not fit {m} {other}")).at(place).at("the report")
}
