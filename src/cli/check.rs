//! `flare-pipe check`: every problem in a manifest at once.

use super::SiteArguments;
use super::workspace::Workspace;
use crate::error::Result;
use crate::manifest::Manifest;
use crate::soil;

/// Checks the manifest and says, where it is right, what it declares.
///
/// # Errors
/// One usage error that shows every problem.
pub fn check(arguments: &SiteArguments) -> Result<()> {
    let manifest = Manifest::load(&arguments.site, &arguments.set)?;
    Workspace::open(arguments)?;
    let site = &manifest.site;
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
    for line in soil::describe(&manifest.site.profile()?)? {
        eprintln!("  {line}");
    }
    Ok(())
}
