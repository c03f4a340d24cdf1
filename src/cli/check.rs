//! `flare-pipe check`: every problem in a manifest and its record files at once.

use super::SiteArguments;
use super::output::{say, write_json};
use super::records::{doubted_unit, inventory};
use super::reporter::clock;
use super::workspace::Workspace;
use crate::column::{self, Column};
use crate::diagnosis::HIGHEST_SHARE;
use crate::effects;
use crate::error::Result;
use crate::stages::cost::Cost;
use crate::twin::Truth;
use serde_json::{Value, json};

/// Elements in a wavelength that are enough.
const ELEMENTS: f64 = 10.0;

/// A layer with what its elements can carry.
struct Layer {
    thickness_m: f64,
    element_m: f64,
    /// Where a wavelength has [`ELEMENTS`].
    highest_hz: f64,
}

/// Checks the manifest, opens every record, and says, where all is right, what is declared.
///
/// # Errors
/// One usage error that shows every problem.
pub fn check(arguments: &SiteArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(arguments)?;
    let site = &workspace.manifest.site;
    let profile = site.column().profile()?;
    let column = Column::new(&profile, &site.analysis)?;
    let left_alone = effects::left_alone(&site.effects, &profile);
    let rows = inventory(&workspace.manifest)?;
    let mut remarks: Vec<String> = rows.iter().flat_map(super::records::Row::sentences).collect();
    remarks.extend(doubted_unit(&workspace.manifest, &rows));
    match &workspace.manifest.truth {
        Some(truth) if truth.exists() => _ = Truth::load(truth).map_err(|e| e.at("`records.truth`").usage())?,
        Some(truth) => remarks.push(format!(
            "`records.truth`: `{}` is not there; a run needs it unless its records are stored",
            truth.display()
        )),
        None => {}
    }
    remarks.extend(beyond_step(site.diagnose.band_hz[1], &rows));
    let layer = |(l, count): (&column::Layer, usize)| {
        let element_m = l.thickness_m / count as f64;
        Layer { thickness_m: l.thickness_m, element_m, highest_hz: l.vs_m_s / (ELEMENTS * element_m) }
    };
    let declared = site.column().declared_profile()?;
    let layers: Vec<Layer> = declared.layers.iter().zip(declared.elements_per_layer()).map(layer).collect();
    remarks.extend(beyond_elements(site.diagnose.band_hz[1], &layers));
    let cost = Cost::of(site, &column);
    cost.check()?;
    let n_event = site.records.as_ref().map_or(0, |r| r.events().count());
    if json {
        let layer =
            |l: &Layer| json!({ "thickness_m": l.thickness_m, "element_m": l.element_m, "f_max_hz": l.highest_hz });
        return write_json(&json!({
            "manifest": arguments.site, "site": site.name, "pipeline": workspace.pipeline, "depth_m": site.site.depth_m,
            "layers": layers.iter().map(layer).collect::<Vec<Value>>(), "frequency_hz": column.frequency_hz(),
            "time_s": cost.time_s, "memory_bytes": cost.memory_bytes, "disk_bytes": cost.disk_bytes, "events": n_event, "records": rows, "notes": left_alone.iter().chain(&remarks).collect::<Vec<_>>(),
        }));
    }
    say!(
        "`{}` is right: site `{}`, {} layers over {} m, {} elements, {} base motions, {n_event} events",
        arguments.site.display(),
        site.name,
        layers.len(),
        site.site.depth_m,
        site.site.elements,
        site.motions.count,
    );
    say!("  pipeline: {}", workspace.pipeline);
    say!(
        "  its columns take some {}, {:.0} MB of memory and {:.0} MB on disk",
        clock(cost.time_s),
        cost.memory_bytes / 1e6,
        cost.disk_bytes / 1e6
    );
    say!("  frequency from the travel time of shear waves: {:.2} Hz", column.frequency_hz());
    let moduli = column.shear_modulus_pa();
    let range = |values: &[f64]| values.iter().fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
    let (least, largest) = range(&moduli);
    say!("  small-strain shear modulus: {:.1}–{:.1} MPa", least / 1e6, largest / 1e6);
    say!("  ten elements in a wavelength up to");
    for (i, layer) in layers.iter().enumerate() {
        say!(
            "    {:.1} Hz in `site.layer[{}]`: {} m thick, elements of {:.2} m",
            layer.highest_hz,
            i + 1,
            layer.thickness_m,
            layer.element_m
        );
    }
    left_alone.iter().chain(&remarks).for_each(|sentence| say!("  {sentence}"));
    Ok(())
}

/// A sentence where the band that is diagnosed ends beyond what the steps of records show.
fn beyond_step(high_hz: f64, rows: &[super::records::Row]) -> Option<String> {
    let shown_hz = |row: &super::records::Row| row.step_s().map(|step_s| HIGHEST_SHARE / step_s);
    let coarser: Vec<f64> = rows.iter().filter_map(shown_hz).filter(|shown| *shown < high_hz).collect();
    let least_hz = coarser.iter().copied().fold(f64::INFINITY, f64::min);
    (!coarser.is_empty()).then(|| {
        format!(
            "`diagnose.band_hz` ends at {high_hz} Hz; {} records are compared up to {least_hz:.1} Hz, which their time steps show",
            coarser.len()
        )
    })
}

/// A sentence where it ends beyond what the elements carry.
fn beyond_elements(high_hz: f64, layers: &[Layer]) -> Option<String> {
    let coarsest = layers.iter().enumerate().min_by(|a, b| a.1.highest_hz.total_cmp(&b.1.highest_hz));
    let (i, layer) = coarsest.filter(|(_, layer)| layer.highest_hz < high_hz)?;
    Some(format!(
        "`diagnose.band_hz` ends at {high_hz} Hz; with the elements of `site.layer[{}]` waves are ten elements long up to {:.1} Hz: raise \
         `site.elements`, or end the band there",
        i + 1,
        layer.highest_hz
    ))
}
