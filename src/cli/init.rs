//! `flare-pipe init`: the first manifest of a site, from a profile and a folder of records.

use super::output::{data, say, write_json};
use crate::error::{Context, Error, Result};
use crate::manifest::{self, Draft, DraftRecords, LayerRow, profile_table, strata};
use crate::records::{self, RecordSettings, Source, csv, kiknet};
use crate::units::AccelerationUnit;
use clap::Args;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Events of a manifest: one to learn from and one to validate with.
const LEAST_EVENTS: usize = 2;

/// Name, profile and records.
#[derive(Debug, Args)]
pub struct InitArguments {
    /// Name of the site: lower-case letters, digits and hyphens
    name: String,
    /// Table of the layers: `thickness_m` (or `depth_m` of their tops), `vs_m_s`, `density_kg_m3`, …, text of PySeismoSoil, or JSON of
    /// Strata; without one the manifest has one layer that is a guess
    #[arg(long, value_name = "FILE", required_unless_present = "records")]
    profile: Option<PathBuf>,
    /// Folder of records: `EVENT.COMPONENT.csv`, raw KiK-net files, or a file, folder or archive an event in any other format
    #[arg(long, value_name = "DIR")]
    records: Option<PathBuf>,
    /// Channel of a sensor's component where file names do not say it, for example --channel surface.NS='*.HNN' (repeatable)
    #[arg(long = "channel", value_name = "SENSOR.COMPONENT=NAME")]
    channels: Vec<String>,
    /// Unit of CSV records that do not say it: g, gal or m/s2
    #[arg(long, value_name = "UNIT")]
    unit: Option<String>,
    /// Depth of a sensor in m, for example --sensor borehole=115 (repeatable); the deepest is the input
    #[arg(long = "sensor", value_name = "NAME=DEPTH")]
    sensors: Vec<String>,
    /// Depth of the water table, m [default: dry]
    #[arg(long, value_name = "DEPTH")]
    water_table_m: Option<f64>,
    /// Where the manifest goes [default: NAME.toml]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Writes the manifest, and says what to do next.
///
/// # Errors
/// When profile or records cannot be read, the depths of sensors are not known, or the manifest is there already.
pub fn init(arguments: &InitArguments, as_json: bool) -> Result<()> {
    if !manifest::is_site_name(&arguments.name) {
        let what = format!(
            "a site is named by 1…{} lower-case letters, digits and hyphens, got `{}`",
            manifest::LONGEST_NAME,
            arguments.name
        );
        return Err(Error::new(what).hint("it names the manifest and the run folder: `lotung`, `fksh11-ns`").usage());
    }
    let path = arguments.output.clone().unwrap_or_else(|| PathBuf::from(format!("{}.toml", arguments.name)));
    if path.exists() {
        let hint = "take another name, another `--output`, or remove the file";
        return Err(Error::new(format!("`{}` is there already", path.display())).hint(hint).usage());
    }
    let profile = arguments.profile.as_deref().map(Profile::read).transpose()?;
    let unit = arguments.unit.as_deref().map(AccelerationUnit::named).transpose().map_err(Error::usage)?;
    let mut depths = arguments.sensors.iter().map(|text| depth(text)).collect::<Result<Vec<_>>>()?;
    let named = arguments.channels.iter().map(|text| channel(text)).collect::<Result<Vec<_>>>()?;
    let folder = arguments.records.as_deref().map(|dir| scan(dir, &named, unit)).transpose()?;
    if let Some(folder) = &folder {
        depths = folder.sensors(depths)?;
    }
    if !depths.is_empty() && depths.iter().all(|s| s.1 <= 0.0) {
        let hint = "the deepest sensor is the input, at the base of the column: `--sensor borehole=115`";
        return Err(Error::new("no sensor is below the surface").hint(hint).usage());
    }
    let base_m = depths.iter().map(|s| s.1).fold(None, |deepest: Option<f64>, d| Some(deepest.map_or(d, |m| m.max(d))));
    let layers = match &profile {
        Some(profile) => profile.layers(base_m)?,
        None => vec![LayerRow { thickness_m: base_m.unwrap_or_default(), ..LayerRow::GUESS }],
    };
    if depths.is_empty() {
        let depth_m = layers.iter().map(|l| l.thickness_m).sum();
        depths = vec![("base".into(), depth_m), ("surface".into(), 0.0)];
    }
    if let Some(folder) = folder.as_ref().filter(|folder| !folder.says_unit && unit.is_none()) {
        let hint = "add `--unit g`, `--unit gal` or `--unit m/s2`";
        let what = format!("the records in `{}` do not say their unit", folder.dir.display());
        return Err(Error::new(what).hint(hint).usage());
    }
    if let Some(folder) = folder.as_ref().filter(|folder| folder.events.len() < LEAST_EVENTS) {
        let what = format!("the records in `{}` are of {} event", folder.dir.display(), folder.events.len());
        let hint = "at least two are needed, one to learn from and one to validate with, and a third, held out, to tell what \
                    a correction is worth";
        return Err(Error::new(what).hint(hint).usage());
    }
    if let Some(folder) = folder.as_ref().filter(|folder| !folder.vertical.is_empty()) {
        say!("left out, because it is vertical: {}", Vec::from_iter(folder.vertical.iter().cloned()).join(", "));
    }
    let records = folder.map(|folder| DraftRecords {
        format: folder.format.into(),
        dir: relative(&folder.dir, path.parent().unwrap_or(Path::new(""))),
        unit: unit.filter(|_| !folder.says_unit),
        channels: named,
        components: folder.components.into_iter().collect(),
        events: folder.events.into_iter().collect(),
    });
    let draft = Draft {
        name: arguments.name.clone(),
        layers,
        is_guess: profile.is_none(),
        water_table_m: arguments.water_table_m.or_else(|| profile.as_ref()?.water_table_m()),
        sensors: depths,
        records,
    };
    crate::atomic::write(&path, |out| std::io::Write::write_all(out, draft.text().as_bytes()))?;
    say!(
        "look at the lines of it with a question mark, then: flare-pipe check {0} && flare-pipe run {0}",
        path.display()
    );
    if as_json { write_json(&json!({ "manifest": path })) } else { data!("{}", path.display()) }
}

/// The file of a profile.
struct Profile<'a> {
    path: &'a Path,
    text: String,
}

impl<'a> Profile<'a> {
    fn read(path: &'a Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).context(|| format!("cannot read the profile `{}`", path.display()));
        let profile = Self { path, text: text.map_err(Error::usage)? };
        profile_table(&profile.text, None).map_err(|e| profile.place(e))?;
        Ok(profile)
    }

    fn place(&self, error: Error) -> Error {
        error.at(format!("`{}`", self.path.display())).usage()
    }

    /// Its layers down to `base_m`, where that is known.
    fn layers(&self, base_m: Option<f64>) -> Result<Vec<LayerRow>> {
        let layers = profile_table(&self.text, base_m).map_err(|e| self.place(e))?;
        if layers.is_empty() {
            let hint = "a last line of no thickness, or the last of `depth_m`, is the half-space: add a layer above it";
            return Err(self.place(Error::new("the profile has no layer").hint(hint)));
        }
        Ok(layers)
    }

    /// Depth of the water table that a project file of Strata says, m.
    fn water_table_m(&self) -> Option<f64> {
        strata::is_project(&self.text).then(|| strata::project(&self.text).ok())??.water_table_m
    }
}

fn depth(text: &str) -> Result<(String, f64)> {
    let read = |(name, depth): (&str, &str)| {
        let depth_m = depth.trim().parse().ok().filter(|d: &f64| d.is_finite() && *d >= 0.0)?;
        Some((name.trim().to_string(), depth_m))
    };
    let wrong = || {
        Error::new(format!("`--sensor {text}` is no sensor")).hint("write `--sensor surface=0`, depths in m").usage()
    };
    text.split_once('=').and_then(read).ok_or_else(wrong)
}

fn channel(text: &str) -> Result<[String; 3]> {
    let parts = text.split_once('=').and_then(|(role, name)| Some((role.rsplit_once('.')?, name)));
    let part = |text: &str| text.trim().to_string();
    match parts {
        Some(((sensor, component), name)) if ![sensor, component, name].iter().any(|text| text.trim().is_empty()) => {
            Ok([part(sensor), part(component), part(name)])
        }
        _ => {
            let what = format!("`--channel {text}` is of no sensor and component");
            Err(Error::new(what).hint("write `--channel surface.NS='*.HNN'`").usage())
        }
    }
}

/// What a folder of records holds.
struct Folder {
    dir: PathBuf,
    format: &'static str,
    events: BTreeSet<String>,
    components: BTreeSet<String>,
    /// Components that are left out.
    vertical: BTreeSet<String>,
    says_unit: bool,
    /// Names of the sensors, with depths in m where the files say them.
    channels: Vec<(String, Option<f64>)>,
}

fn scan(dir: &Path, named: &[[String; 3]], unit: Option<AccelerationUnit>) -> Result<Folder> {
    if !named.is_empty() {
        return by_channel(dir, named, unit);
    }
    let folder = records::Folder::open(dir).map_err(Error::usage)?;
    let csv_name = |source: &Source| {
        let (event, component) = source.name.strip_suffix(".csv")?.rsplit_once('.')?;
        Some((event.to_string(), component.to_string()))
    };
    let kiknet_name = |source: &Source| {
        let (event, channel) = source.name.rsplit_once('.')?;
        let component = channel.strip_suffix(['1', '2'])?;
        ["NS", "EW"].contains(&component).then(|| (event.to_string(), component.to_string()))
    };
    let names = |of: &dyn Fn(&Source) -> Option<(String, String)>| folder.sources().iter().filter_map(of).unzip();
    let (events, components): (BTreeSet<String>, BTreeSet<String>) = names(&csv_name);
    let (vertical, components): (BTreeSet<String>, _) = components.into_iter().partition(|c| is_vertical(c));
    if let Some(first) = folder.sources().iter().find(|source| csv_name(source).is_some()) {
        let channels = csv::channel_names(&first.path)?.into_iter().map(|name| (name, None)).collect();
        let says_unit = csv::unit_in(&first.path).map_err(Error::usage)?.is_some();
        return Ok(Folder { dir: dir.into(), format: "csv", events, components, vertical, says_unit, channels });
    }
    let (events, components): (BTreeSet<String>, BTreeSet<String>) = names(&kiknet_name);
    if let Some(first) = folder.sources().iter().find(|source| kiknet_name(source).is_some()) {
        let depth_m = kiknet::borehole_depth_m(&first.path);
        let channels = vec![("borehole".to_string(), depth_m), ("surface".to_string(), Some(0.0))];
        return Ok(Folder {
            dir: dir.into(),
            format: "kiknet",
            events,
            components,
            vertical: BTreeSet::new(),
            says_unit: true,
            channels,
        });
    }
    by_channel(dir, named, unit)
}

/// A folder whose channels are `named`, each event being a file, a folder or an archive.
fn by_channel(dir: &Path, named: &[[String; 3]], unit: Option<AccelerationUnit>) -> Result<Folder> {
    let settings = RecordSettings { unit, ..RecordSettings::any() };
    let events = records::channels(&settings, dir).map_err(Error::usage)?;
    let Some(first) = events.values().next() else {
        let hint = "`flare-pipe list formats` names what can be read; CSV files are called `EVENT.COMPONENT.csv`";
        return Err(Error::new(format!("there are no records in `{}`", dir.display())).hint(hint).usage());
    };
    if named.is_empty() {
        let seen: Vec<String> = first.iter().map(records::Channel::described).collect();
        let hint = format!(
            "add `--channel SENSOR.COMPONENT=NAME` for each sensor and component; there are {}",
            seen.join(", ")
        );
        return Err(Error::new("the records do not say which channel is which sensor").hint(hint).usage());
    }
    let depth_m = |sensor: &str| {
        let mut of_sensor =
            named.iter().filter(|[s, ..]| s == sensor).filter_map(|[.., name]| glob::Pattern::new(name).ok());
        of_sensor
            .find_map(|pattern| first.iter().find(|c| pattern.matches(&c.name) || pattern.matches(&c.path()))?.depth_m)
    };
    let sensors: BTreeSet<&String> = named.iter().map(|[sensor, ..]| sensor).collect();
    Ok(Folder {
        dir: dir.into(),
        format: records::ANY,
        events: events.keys().cloned().collect(),
        components: named.iter().map(|[_, component, _]| component.clone()).collect(),
        vertical: BTreeSet::new(),
        says_unit: unit.is_none(),
        channels: sensors.into_iter().map(|sensor| (sensor.clone(), depth_m(sensor))).collect(),
    })
}

/// Whether a component is vertical by the names in use: `UD`, `Z`, `UP`, `HNZ`, …
fn is_vertical(component: &str) -> bool {
    let name = component.to_uppercase();
    ["UD", "U", "UP", "V", "VER", "VERT", "VERTICAL", "DWN"].contains(&name.as_str()) || name.ends_with('Z')
}

impl Folder {
    /// The sensors with the depths that were given or that the files say.
    fn sensors(&self, given: Vec<(String, f64)>) -> Result<Vec<(String, f64)>> {
        let names: Vec<&str> = self.channels.iter().map(|c| c.0.as_str()).collect();
        if let Some((name, _)) = given.iter().find(|(name, _)| !names.contains(&name.as_str())) {
            let hint = crate::registry::known(&names, name);
            return Err(Error::new(format!("the records have no sensor `{name}`")).hint(hint).usage());
        }
        let depth_m = |name: &str| given.iter().find(|(n, _)| n == name).map(|(_, depth_m)| *depth_m);
        let all = self.channels.iter().map(|(name, own)| (name, depth_m(name).or(*own)));
        let (known, open): (Vec<_>, Vec<_>) = all.partition(|(_, depth_m)| depth_m.is_some());
        if open.is_empty() {
            return Ok(known.into_iter().filter_map(|(name, depth_m)| Some((name.clone(), depth_m?))).collect());
        }
        let open: Vec<String> = open.into_iter().map(|(name, _)| format!("--sensor {name}=…")).collect();
        let hint = format!("add {}, depths in m, 0 at the surface; the deepest is the input", open.join(" "));
        Err(Error::new("the records do not say how deep their sensors are").hint(hint).usage())
    }
}

/// `dir` as a manifest in `from` names it: below that where it is, otherwise absolute.
fn relative(dir: &Path, from: &Path) -> String {
    let absolute = |path: &Path| std::env::current_dir().map(|here| here.join(path)).and_then(|p| p.canonicalize());
    match (absolute(dir), absolute(from)) {
        (Ok(dir), Ok(from)) if dir == from => ".".into(),
        (Ok(dir), Ok(from)) => dir.strip_prefix(&from).unwrap_or(&dir).display().to_string(),
        _ => dir.display().to_string(),
    }
}
