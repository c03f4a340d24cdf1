//! `flare-pipe check`: every problem in a manifest at once.

use super::SiteArguments;
use super::workspace::Workspace;
use crate::column::Column;
use crate::effects;
use crate::error::Result;

/// Checks the manifest and says, where it is right, what it declares.
///
/// # Errors
/// One usage error that shows every problem.
pub fn check(arguments: &SiteArguments) -> Result<()> {
    let workspace = Workspace::open(arguments)?;
    let site = &workspace.manifest.site;
    eprintln!(
        "`{}` is right: site `{}`, {} layers over {} m, {} elements, {} base motions, {} events",
        arguments.site.display(),
        site.name,
        site.site.layer.len(),
        site.site.depth_m,
        site.site.elements,
        site.motions.count,
        site.records.as_ref().map_or(0, |r| r.events().count()),
    );
    let profile = site.column().profile()?;
    let column = Column::new(&profile, &site.analysis)?;
    eprintln!("  frequency from the travel time of shear waves: {:.2} Hz", column.frequency_hz());
    let moduli = column.shear_modulus_pa();
    let range = |values: &[f64]| values.iter().fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
    let (least, largest) = range(&moduli);
    eprintln!("  small-strain shear modulus: {:.1}–{:.1} MPa", least / 1e6, largest / 1e6);
    for sentence in effects::left_alone(&site.effects, &profile) {
        eprintln!("  {sentence}");
    }
    Ok(())
}
