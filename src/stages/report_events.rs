//! From what a closed loop left to the report's sections on the site, its events and spectra.

use super::closed::{Closed, over_depth, residuals, transfers};
use super::{compare, diagnose};
use crate::diagnosis::DeclaredValue;
use crate::equivalent_linear::{Curves, EquivalentColumn};
use crate::error::Result;
use crate::metrics::peak;
use crate::pipeline::Task;
use crate::records::{Record, Split};
use crate::report::content::{
    Content, DepthView, EventRow, EventView, LayerView, ProfileView, SensorPlace, SiteView, SoilCurve, VelocityBand,
};
use crate::units::G_M_S2;

/// Depth over which velocities are averaged to class a site, m.
const CLASS_DEPTH_M: f64 = 30.0;
/// Strain amplitudes between which soil curves are drawn, and steps between them.
const STRAINS: [f64; 2] = [1e-6, 1e-2];
const STRAIN_STEPS: u32 = 24;
/// Frequency of their small-strain damping, Hz.
const DAMPING_AT_HZ: f64 = 1.0;
/// Lowest Vs30 of the classes A to D of Eurocode 8 (EN 1998-1:2004, table 3.1) and of A to D of NEHRP (ASCE 7-16, table 20.3-1), m/s.
const EUROCODE_M_S: [(f64, &str); 3] = [(800.0, "A"), (360.0, "B"), (180.0, "C")];
const NEHRP_M_S: [(f64, &str); 4] = [(1500.0, "A"), (760.0, "B"), (360.0, "C"), (180.0, "D")];

/// `content` with the site, its events and spectra, where the pipeline closes the loop.
///
/// # Errors
/// When an output cannot be read.
pub fn added(task: &Task<'_>, content: Content) -> Result<Content> {
    let Some(closed) = Closed::of(task)? else { return Ok(content) };
    let found = compare::read(&closed.compare)?;
    let events = closed.events(&found)?;
    let strongest = events.iter().max_by(|a, b| peak(&a.input.values).total_cmp(&peak(&b.input.values)));
    let over_depth = |e: &EventView| -> Result<DepthView> {
        Ok(over_depth(&e.event, &e.component, &closed.shaken(&e.event, &e.component)?))
    };
    let depth = strongest.map(over_depth).transpose()?;
    let transfers = transfers(&found);
    let soil_curves = soil_curves(&closed, depth.as_ref())?;
    let values = diagnose::read(task.input("diagnose")?)?.declared;
    let site_view = Some(site(&closed, &values)?);
    Ok(Content { depth, soil_curves, site_view, residuals: residuals(&events), events, transfers, ..content })
}

/// Modulus reduction and damping of the declared and the corrected column: in the first and the last layer, and where the strongest motion
/// strains the soil most.
fn soil_curves(closed: &Closed, strongest: Option<&DepthView>) -> Result<Vec<SoilCurve>> {
    let declared = closed.declared().declared_profile()?;
    let [first, last] = [declared.layers.first(), declared.layers.last()].map(|l| l.map_or(0.0, |l| l.thickness_m));
    let mut depths_m = vec![0.5 * first, declared.depth_m() - 0.5 * last];
    depths_m.extend(strongest.and_then(|view| view.models.last()).map(|model| model.loop_depth_m));
    let amplitudes: Vec<f64> = (0..=STRAIN_STEPS)
        .map(|k| STRAINS[0] * (STRAINS[1] / STRAINS[0]).powf(f64::from(k) / f64::from(STRAIN_STEPS)))
        .collect();
    let (mut found, curves) = (Vec::new(), Curves::default());
    for (model, sections) in closed.models.iter().filter(|(model, _)| *model != "recalibrated") {
        let profile = sections.profile()?;
        let column = EquivalentColumn::new(&profile, profile.elements, &curves)?;
        found.extend(depths_m.iter().map(|depth_m| {
            let of = amplitudes.iter().map(|gamma| column.modulus_and_damping(*depth_m, *gamma, DAMPING_AT_HZ));
            let (modulus_ratio, damping): (Vec<f64>, Vec<f64>) = of.unzip();
            SoilCurve {
                model: (*model).into(),
                law: profile.layer_at(*depth_m).map(|layer| layer.law_kind.clone()).unwrap_or_default(),
                depth_m: *depth_m,
                strain_percent: amplitudes.iter().map(|gamma| 100.0 * gamma).collect(),
                modulus_ratio,
                damping_percent: damping.into_iter().map(|d| 100.0 * d).collect(),
            }
        }));
    }
    Ok(found)
}

fn site(closed: &Closed, values: &[DeclaredValue]) -> Result<SiteView> {
    let declared = closed.declared();
    let profile = declared.declared_profile()?;
    let mut depth_m = 0.0;
    let mut layers = Vec::new();
    for layer in &profile.layers {
        let top_m = depth_m;
        depth_m += layer.thickness_m;
        layers.push(LayerView { top_m, bottom_m: depth_m, law: layer.law_kind.clone() });
    }
    let mut profiles = Vec::new();
    for (model, sections) in &closed.models {
        let mut top_m = 0.0;
        let tops = sections.profile()?.layers.into_iter().map(|layer| {
            let top = [top_m, layer.vs_m_s];
            top_m += layer.thickness_m;
            top
        });
        profiles.push(ProfileView { model: (*model).into(), tops: tops.collect(), bands: Vec::new() });
    }
    // Intervals of declared values are those of the model that goes furthest.
    if let Some(last) = profiles.last_mut() {
        last.bands = velocity_bands(&last.tops, depth_m, values);
    }
    let sensors = &declared.sensors;
    let input = SensorPlace { name: sensors.input.clone(), depth_m: profile.depth_m(), is_input: true };
    let outputs =
        sensors.output.iter().map(|s| SensorPlace { name: s.name.clone(), depth_m: s.depth_m, is_input: false });
    Ok(SiteView {
        depth_m,
        layers,
        facts: facts(&profile),
        profiles,
        sensors: std::iter::once(input).chain(outputs).collect(),
        water_table_m: Some(profile.water_table_m).filter(|w| *w > 0.0 && *w < depth_m),
        events: rows(closed),
    })
}

/// 95 % intervals of the velocities of layers with these `tops` down to `depth_m`, by what the records say of the declared `values`.
fn velocity_bands(tops: &[[f64; 2]], depth_m: f64, values: &[DeclaredValue]) -> Vec<VelocityBand> {
    let bottoms = tops.iter().skip(1).map(|top| top[0]).chain([depth_m]);
    let within = |([top_m, vs_m_s], bottom_m): (&[f64; 2], f64)| {
        let (top_m, vs_m_s) = (*top_m, *vs_m_s);
        let part = move |value: &DeclaredValue| {
            let [from_m, to_m] = value.vs_range_m?;
            let of = |end: f64| vs_m_s * (end - value.estimate.value).exp();
            let band = VelocityBand {
                top_m: top_m.max(from_m),
                bottom_m: bottom_m.min(to_m),
                vs_m_s: value.estimate.ci95.map(of),
            };
            (band.top_m < band.bottom_m).then_some(band)
        };
        values.iter().filter_map(part).collect::<Vec<_>>()
    };
    tops.iter().zip(bottoms).flat_map(within).collect()
}

fn facts(profile: &crate::column::Profile) -> Vec<(String, String)> {
    let depth_m = profile.depth_m();
    let mut facts = vec![
        ("Depth of the column".to_string(), format!("{depth_m} m")),
        (
            "Fundamental frequency f₀ by travel time".to_string(),
            format!("{:.2} Hz as declared", profile.fundamental_hz()),
        ),
    ];
    let (mut top_m, mut travel_s) = (0.0, 0.0);
    for layer in &profile.layers {
        let within_m = (CLASS_DEPTH_M - top_m).clamp(0.0, layer.thickness_m);
        travel_s += within_m / layer.vs_m_s;
        top_m += layer.thickness_m;
    }
    if depth_m < CLASS_DEPTH_M {
        let mean_m_s = depth_m / profile.travel_time_s();
        facts.push((
            format!("Mean Vs of {depth_m} m"),
            format!("{mean_m_s:.0} m/s; no Vs30: the column ends above 30 m"),
        ));
        return facts;
    }
    let vs30_m_s = CLASS_DEPTH_M / travel_s;
    let class = |limits: &[(f64, &'static str)], last: &'static str| {
        limits.iter().find(|(from, _)| vs30_m_s > *from).map_or(last, |(_, class)| class)
    };
    facts.push(("Vs30".into(), format!("{vs30_m_s:.0} m/s as declared")));
    let classes = format!("{} (Eurocode 8), {} (NEHRP)", class(&EUROCODE_M_S, "D"), class(&NEHRP_M_S, "E"));
    facts.push(("Site class by Vs30".into(), classes));
    facts
}

fn rows(closed: &Closed) -> Vec<EventRow> {
    let row = |(split, record): &(Split, Record)| EventRow {
        event: record.event.clone(),
        component: record.component.clone(),
        split: match split {
            Split::Train => "calibration",
            Split::Validation => "selection",
            Split::Test => "held out",
        }
        .into(),
        pga_g: record.sensors().map(|s| peak(&s.acceleration_m_s2) / G_M_S2).collect(),
        duration_s: record.duration_s(),
    };
    closed.records.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::Estimate;

    #[test]
    fn bands_are_cut_at_layers_and_at_ranges() {
        let value = |range_m: Option<[f64; 2]>, value: f64, half: f64| DeclaredValue {
            kind: String::new(),
            target: String::new(),
            parameter: String::new(),
            vs_range_m: range_m,
            deviations: 0.0,
            is_at_end: false,
            estimate: Estimate { value, unit: String::new(), ci95: [value - half, value + half], by_prior: None },
            by_records: None,
        };
        let values = [value(Some([0.0, 3.0]), 0.1, 0.05), value(Some([3.0, 9.0]), 0.0, 0.2), value(None, 1.0, 9.0)];
        let bands = velocity_bands(&[[0.0, 100.0], [2.0, 200.0]], 9.0, &values);
        let of = |top_m: f64, bottom_m: f64, vs_m_s: f64, half: f64| VelocityBand {
            top_m,
            bottom_m,
            vs_m_s: [vs_m_s * (-half).exp(), vs_m_s * half.exp()],
        };
        let expected = [of(0.0, 2.0, 100.0, 0.05), of(2.0, 3.0, 200.0, 0.05), of(3.0, 9.0, 200.0, 0.2)];
        assert_eq!(bands.len(), expected.len());
        for (band, expected) in bands.iter().zip(&expected) {
            assert_eq!([band.top_m, band.bottom_m], [expected.top_m, expected.bottom_m]);
            assert!(
                band.vs_m_s.iter().zip(&expected.vs_m_s).all(|(a, b)| (a - b).abs() < 1e-9),
                "{band:?} {expected:?}"
            );
        }
    }
}
