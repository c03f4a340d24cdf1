//! Reads all records a manifest names, and lists the components that are missing.

use super::align::{aligned, azimuth_deg, turned};
use super::channel::{Channel, Orientation};
use super::folder::{Folder, Source};
use super::record::{Record, Sensor};
use super::settings::{Names, RecordSettings, Split};
use super::stationxml::{self, Responses};
use super::{ANY, FORMATS, Format, Reading, Role, Usual};
use crate::error::{Error, Result};
use crate::registry;
use jiff::civil::DateTime;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Bytes by which a format is told.
const HEAD: usize = 4096;

/// A component that an event lacks.
#[derive(Debug, Clone, PartialEq)]
pub struct Missing {
    /// Event name.
    pub event: String,
    /// Component name.
    pub component: String,
    /// The first file, or file and channel, that is not there.
    pub file: PathBuf,
}

/// What the files of a record say of it, and what was done to them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Origin {
    /// Time of the first sample, UTC, where the files say it.
    pub start: Option<DateTime>,
    /// What is odd about the files, and how they were brought together.
    pub remarks: Vec<String>,
}

/// The records of a site, with the gaps.
#[derive(Debug, Clone, PartialEq)]
pub struct Records {
    /// Records with their split, in the order of the manifest (train, validation, test; component by component).
    pub records: Vec<(Split, Record)>,
    /// What their files say, in the same order.
    pub origins: Vec<Origin>,
    /// Components that are missing, in the same order.
    pub missing: Vec<Missing>,
}

impl Records {
    /// Records of one component and split.
    pub fn select<'a>(&'a self, component: &'a str, split: Split) -> impl Iterator<Item = &'a Record> {
        self.records.iter().filter(move |(s, r)| *s == split && r.component == component).map(|(_, r)| r)
    }
}

/// What was found of one component of one event.
enum Found {
    /// A sound record.
    Record(Record, Origin),
    /// This is not there.
    Missing(PathBuf),
    /// What is there is no sound record.
    Unsound(Error),
}

/// Reads every event and component of `settings` from `dir`; `input` and `outputs` are the sensor names of the manifest.
///
/// # Errors
/// Everything that is wrong at once: the format, the folder or all components of an event are missing, or files are no sound records.
pub fn load(settings: &RecordSettings, dir: &Path, input: &str, outputs: &[String]) -> Result<Records> {
    let reader = Reader::new(settings, dir, input, outputs)?;
    let events: Vec<(&str, Split)> = settings.events().collect();
    let found: Vec<Vec<Found>> = events.par_iter().map(|(event, _)| reader.event(event)).collect();
    let mut read = Records { records: Vec::new(), origins: Vec::new(), missing: Vec::new() };
    let mut wrong = Vec::new();
    for ((event, split), found) in events.into_iter().zip(found) {
        let is_empty = found.iter().all(|found| matches!(found, Found::Missing(_)));
        let before = read.missing.len();
        for (component, found) in settings.components.iter().zip(found) {
            match found {
                Found::Record(record, origin) => {
                    read.records.push((split, record));
                    read.origins.push(origin);
                }
                Found::Missing(file) => {
                    read.missing.push(Missing { event: event.into(), component: component.clone(), file });
                }
                Found::Unsound(error) => wrong.push(error),
            }
        }
        if is_empty {
            wrong.push(reader.nothing_found(event, &read.missing[before..]));
        }
    }
    Error::all(wrong).map(|()| read)
}

/// All files that [`load()`] may read, those of sensors that the manifest does not name included.
///
/// # Errors
/// When the format is not known or the folder cannot be read.
pub fn files(settings: &RecordSettings, dir: &Path) -> Result<Vec<PathBuf>> {
    let reader = Reader::new(settings, dir, "", &[])?;
    let mut files: Vec<PathBuf> = settings
        .events()
        .flat_map(|(event, _)| reader.sources(event))
        .chain(reader.companions())
        .map(|source| source.path.clone())
        .collect();
    files.sort();
    files.dedup();
    Ok(files)
}

/// All channels in `dir` by event, a file, a folder or an archive being an event, whatever the format; events without channels are left out.
///
/// # Errors
/// When a file that is of a known format is not sound.
pub fn channels(settings: &RecordSettings, dir: &Path) -> Result<BTreeMap<String, Vec<Channel>>> {
    let reader = Reader::new(settings, dir, "", &[])?;
    let mut found: BTreeMap<String, Vec<Channel>> = BTreeMap::new();
    for source in reader.folder.sources() {
        if let Some(channels) = reader.read(source, &|_| true)?.filter(|channels| !channels.is_empty()) {
            found.entry(source.event().to_string()).or_default().extend(channels);
        }
    }
    Ok(found)
}

/// How the files of a site are read.
struct Reader<'a> {
    settings: &'a RecordSettings,
    dir: &'a Path,
    folder: Folder,
    formats: Vec<Box<dyn Format>>,
    sensors: Vec<&'a str>,
    responses: OnceLock<Responses>,
}

/// Where the channel of a role may be.
struct Places<'a> {
    declared: &'a [glob::Pattern],
    usual: Vec<Usual>,
}

impl Places<'_> {
    fn fits(&self, channel: &Channel) -> bool {
        let path = channel.path();
        let names = [channel.name.as_str(), channel.file.as_str(), path.as_str()];
        self.declared.iter().any(|pattern| names.iter().any(|name| pattern.matches(name)))
            || self.usual.iter().any(|u| u.file == channel.file && u.channel == channel.name)
    }

    /// Whether it may be in a file of this name.
    fn may_be_in(&self, file: &str) -> bool {
        !self.declared.is_empty() || self.usual.iter().any(|usual| usual.file == file)
    }

    /// Whether a channel of this name in some file may be it.
    fn may_be_called(&self, name: &str) -> bool {
        let last =
            |pattern: &glob::Pattern| pattern.as_str().rsplit(':').next().and_then(|p| glob::Pattern::new(p).ok());
        self.usual.iter().any(|usual| usual.channel == name)
            || self
                .declared
                .iter()
                .any(|pattern| pattern.matches(name) || last(pattern).is_some_and(|p| p.matches(name)))
    }

    /// The place for a message.
    fn shown(&self) -> String {
        let usual = |u: &Usual| u.file.clone();
        let declared = self.declared.iter().map(|pattern| pattern.as_str().to_string());
        declared.chain(self.usual.iter().map(usual)).next().unwrap_or_default()
    }
}

impl<'a> Reader<'a> {
    fn new(settings: &'a RecordSettings, dir: &'a Path, input: &'a str, outputs: &'a [String]) -> Result<Self> {
        let name = if settings.format == "twin" { "csv" } else { &settings.format };
        let built = |entry: &registry::Entry<dyn Format>, options| {
            (entry.build)(options).map_err(|e| e.at("`records.options`"))
        };
        let formats = if name == ANY {
            if !settings.options.is_empty() {
                let what = "`records.options` are those of one format, and `records.format` is `any`";
                return Err(Error::new(what).hint("name the format, or leave `[records.options]` out").usage());
            }
            FORMATS.iter().map(|entry| built(entry, toml::Table::new())).collect::<Result<_>>()?
        } else {
            vec![built(registry::find("record format", FORMATS, name)?, settings.options.clone())?]
        };
        let sensors: Vec<&str> = std::iter::once(input).chain(outputs.iter().map(String::as_str)).collect();
        if let Some(unknown) =
            settings.channels.keys().find(|name| !input.is_empty() && !sensors.contains(&name.as_str()))
        {
            let what = format!("`records.channels.{unknown}` is of no sensor");
            return Err(Error::new(what).hint(registry::known(&sensors, unknown)).usage());
        }
        Ok(Self { settings, dir, folder: Folder::open(dir)?, formats, sensors, responses: OnceLock::new() })
    }

    fn sources(&self, event: &str) -> Vec<&Source> {
        let mut stems: Vec<String> = self.formats.iter().map(|format| format.stem(event)).collect();
        stems.dedup();
        let mut sources: Vec<&Source> = stems.iter().flat_map(|stem| self.folder.of_event(stem)).collect();
        sources.sort();
        sources.dedup();
        sources
    }

    fn is_companion(&self, source: &Source) -> bool {
        self.formats.iter().any(|format| format.is_companion(&source.name))
    }

    fn companions(&self) -> impl Iterator<Item = &Source> {
        self.folder.sources().iter().filter(|source| self.is_companion(source))
    }

    /// What companions say of channels.
    fn responses(&self) -> Result<&Responses> {
        if let Some(known) = self.responses.get() {
            return Ok(known);
        }
        let read = stationxml::read(self.companions())?;
        Ok(self.responses.get_or_init(|| read))
    }

    fn places(&self, event: &str, component: &str, sensor: &'a str) -> Result<Places<'_>> {
        let declared = self.settings.channels.get(sensor).and_then(|of| of.get(component)).map(Names::patterns);
        if let Some(declared) = declared {
            return Ok(Places { declared, usual: Vec::new() });
        }
        let (is_input, n_output) = (self.sensors.first() == Some(&sensor), self.sensors.len() - 1);
        let role = Role { event, component, sensor, is_input, n_output };
        let usual: Vec<Usual> = match &self.formats[..] {
            [only] => only.usual(&role)?.into_iter().collect(),
            all => all.iter().filter_map(|format| format.usual(&role).ok().flatten()).collect(),
        };
        if usual.is_empty() {
            let what = format!("nothing says which channel is `{sensor}` in `{component}`");
            let hint =
                format!("add `{sensor} = {{ {component} = \"…\" }}` to `[records.channels]`: {}", self.seen(event));
            return Err(Error::new(what).hint(hint).usage());
        }
        Ok(Places { declared: &[], usual })
    }

    /// The channels of an event, for a hint.
    fn seen(&self, event: &str) -> String {
        let read = |source: &Source| self.read(source, &|_| true).ok().flatten();
        let found: Vec<String> =
            self.sources(event).into_iter().filter_map(read).flatten().map(|c| c.described()).collect();
        if found.is_empty() {
            format!("event `{event}` has no channels")
        } else {
            format!("there are {}", found.join(", "))
        }
    }

    /// The channels of a file; none where it is of no format that is asked for.
    fn read(&self, source: &Source, is_wanted: &dyn Fn(&str) -> bool) -> Result<Option<Vec<Channel>>> {
        if self.is_companion(source) {
            return Ok(None);
        }
        let bytes = source.bytes()?;
        let head = &bytes[..bytes.len().min(HEAD)];
        let Some(format) = self.formats.iter().find(|format| format.recognises(&source.name, head)) else {
            return Ok(None);
        };
        let responses = || self.responses();
        let reading = Reading { unit: self.settings.unit, is_wanted, responses: &responses };
        format.read(source, &bytes, &reading).map(Some).map_err(|e| e.at(format!("`{}`", source.shown())))
    }

    /// What there is of an event, component by component.
    fn event(&self, event: &str) -> Vec<Found> {
        let components = &self.settings.components;
        let places: Vec<Result<Vec<Places<'_>>>> = components
            .iter()
            .map(|component| self.sensors.iter().map(|sensor| self.places(event, component, sensor)).collect())
            .collect();
        let all = || places.iter().flatten().flatten();
        let is_wanted = |name: &str| all().any(|place| place.may_be_called(name));
        let mut channels = Vec::new();
        let mut unsound: Vec<(String, Error)> = Vec::new();
        for source in self.sources(event).into_iter().filter(|source| all().any(|place| place.may_be_in(&source.name)))
        {
            match self.read(source, &is_wanted) {
                Ok(found) => channels.extend(found.into_iter().flatten()),
                Err(error) => unsound.push((source.name.clone(), error)),
            }
        }
        let mut found = Vec::new();
        for (component, places) in components.iter().zip(places) {
            let place = |e: Error| e.at(format!("event `{event}`, component `{component}`"));
            found.push(
                match places.and_then(|places| self.component(event, component, &places, &channels, &mut unsound)) {
                    Ok(found) => found,
                    Err(error) => Found::Unsound(place(error)),
                },
            );
        }
        found
    }

    fn component(
        &self,
        event: &str,
        component: &str,
        places: &[Places<'_>],
        channels: &[Channel],
        unsound: &mut Vec<(String, Error)>,
    ) -> Result<Found> {
        let mut chosen: Vec<&Channel> = Vec::new();
        for (sensor, place) in self.sensors.iter().zip(places) {
            let mut fitting = channels.iter().filter(|channel| place.fits(channel));
            match (fitting.next(), fitting.next()) {
                (Some(only), None) => chosen.push(only),
                (Some(one), Some(other)) => {
                    let what = format!("two channels fit `{sensor}`: {} and {}", one.described(), other.described());
                    return Err(
                        Error::new(what).hint("say which in `[records.channels]`, as `FILE:CHANNEL` if need be")
                    );
                }
                (None, _) => {
                    if let Some(i) = unsound.iter().position(|(file, _)| place.may_be_in(file)) {
                        return Err(unsound.remove(i).1);
                    }
                    let in_file: Vec<&str> = channels
                        .iter()
                        .filter(|c| place.usual.iter().any(|u| u.file == c.file))
                        .map(|c| c.name.as_str())
                        .collect();
                    if let (Some(usual), false) = (place.usual.first(), in_file.is_empty()) {
                        let hint = format!(
                            "it is named as the sensor, or in `[records.channels]`; {}",
                            registry::known(&in_file, sensor)
                        );
                        let what = format!("there is no channel `{}`", usual.channel);
                        return Err(Error::new(what).at(format!("`{}`", usual.file)).hint(hint));
                    }
                    return Ok(Found::Missing(self.dir.join(place.shown())));
                }
            }
        }
        self.record(event, component, &chosen, channels)
    }

    fn record(&self, event: &str, component: &str, chosen: &[&Channel], channels: &[Channel]) -> Result<Found> {
        let of_input = chosen.first().and_then(|c| match c.orientation {
            Orientation::AzimuthDeg(deg) => Some(deg),
            _ => None,
        });
        let turned = |(sensor, channel): (&&str, &&Channel)| match azimuth_deg(component).or(of_input) {
            Some(target_deg) => turned(channel, self.other(event, component, sensor, channels), target_deg),
            None => turned(channel, None, 0.0),
        };
        let turned: Vec<Channel> = self.sensors.iter().zip(chosen).map(turned).collect::<Result<_>>()?;
        let aligned = aligned(&turned)?;
        let mut remarks = aligned.remarks;
        remarks.extend(turned.iter().flat_map(|channel| channel.remarks.iter().cloned()));
        let mut sensors = self.sensors.iter().zip(aligned.acceleration_m_s2);
        let mut sensor = || sensors.next().map(|(name, a)| Sensor { name: (*name).into(), acceleration_m_s2: a });
        let input = sensor().ok_or_else(|| Error::new("a record needs an input sensor"))?;
        let outputs = std::iter::from_fn(sensor).collect();
        let record = Record { event: event.into(), component: component.into(), dt_s: aligned.dt_s, input, outputs };
        let files = chosen.first().map_or_else(String::new, |channel| format!("`{}`", channel.file));
        record.check_plausible().map_err(|e| e.at(files))?;
        Ok(Found::Record(record, Origin { start: aligned.start, remarks }))
    }

    /// The other horizontal channel of a sensor.
    fn other<'c>(&self, event: &str, component: &str, sensor: &'a str, channels: &'c [Channel]) -> Option<&'c Channel> {
        let other = self.settings.components.iter().find(|name| *name != component)?;
        let places = self.places(event, other, sensor).ok()?;
        channels.iter().find(|channel| places.fits(channel))
    }

    /// That none of the files of an event, those of the `missing` components, is there.
    fn nothing_found(&self, event: &str, missing: &[Missing]) -> Error {
        let names = missing.iter().map(|m| format!("`{}`", m.file.strip_prefix(self.dir).unwrap_or(&m.file).display()));
        let names: Vec<String> = names.collect();
        let dir = self.dir.display();
        let hint = if self.sources(event).is_empty() {
            "check `records.dir`, or take the event out of the split".to_string()
        } else {
            format!("name channels in `[records.channels]`, or check `records.format`; {}", self.seen(event))
        };
        Error::new(format!("event `{event}` has no record: none of {} is in `{dir}`", names.join(", "))).hint(hint)
    }
}
