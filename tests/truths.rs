//! The truths that ship: all of them fit their sites, and every effect of the catalogue has one.

use flare_pipe::effects::EFFECTS;
use flare_pipe::manifest::Manifest;
use flare_pipe::twin::{OUTSIDE, Truth, recorder};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn truths() -> Vec<(PathBuf, Truth)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/truth");
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "toml"));
    paths.sort();
    paths.into_iter().map(|p| (p.clone(), Truth::load(&p).unwrap_or_else(|e| panic!("{e}")))).collect()
}

fn kinds(tables: &[toml::Table]) -> Vec<String> {
    tables.iter().map(|t| t["kind"].as_str().unwrap().to_string()).collect()
}

#[test]
fn every_truth_fits_its_site() {
    let mut sites: BTreeMap<PathBuf, Manifest> = BTreeMap::new();
    for (path, truth) in truths() {
        let site = path.parent().unwrap().join(&truth.site);
        let manifest = sites.entry(site.clone()).or_insert_with(|| Manifest::load(&site, &[]).unwrap());
        let sections = manifest.site.column();
        if manifest.site.records.as_ref().is_some_and(|r| r.format != "twin") {
            truth.check_alters().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            continue;
        }
        if let Err(error) = recorder(&sections, &manifest.site.tolerances, &truth) {
            panic!("{}: {error}", path.display());
        }
        let recorded: BTreeSet<&str> = truth.event.iter().map(|e| e.name.as_str()).collect();
        for (event, _) in manifest.site.records.as_ref().unwrap().events() {
            assert!(recorded.contains(event), "{} has no event {event}", path.display());
        }
    }
}

#[test]
fn every_effect_has_a_truth_and_so_have_pairs_nothing_and_what_is_outside() {
    let truths = truths();
    let alone: BTreeSet<String> =
        truths.iter().map(|(_, t)| kinds(&t.effects)).filter(|k| k.len() == 1).flatten().collect();
    let missing: Vec<&str> = EFFECTS.iter().map(|e| e.name).filter(|name| !alone.contains(*name)).collect();
    assert!(missing.is_empty(), "no truth with {missing:?} alone");
    let outside: BTreeSet<String> = truths.iter().flat_map(|(_, t)| kinds(&t.outside)).collect();
    assert!(OUTSIDE.iter().all(|o| outside.contains(o.name)));
    assert!(truths.iter().filter(|(_, t)| t.effects.len() == 2).count() >= 3);
    assert!(truths.iter().any(|(_, t)| t.effects.is_empty() && t.outside.is_empty()));
}

#[test]
fn a_truth_like_another_takes_its_events_and_not_its_effects() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/truth");
    let [null, lotung] = ["lotung-null", "lotung"].map(|n| Truth::load(&folder.join(format!("{n}.toml"))).unwrap());
    assert_eq!((null.event.len(), null.site.as_str()), (lotung.event.len(), lotung.site.as_str()));
    assert!(null.effects.is_empty() && !lotung.effects.is_empty());
    assert_ne!(null.seed, lotung.seed);
    assert_eq!(Truth::files(&folder.join("lotung-null.toml")).len(), 2);
}
