//! Manifest section `[records]`: which events, where, in what unit and split.

use crate::units::AccelerationUnit;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Measured (or twin) records (manifest section `[records]`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordSettings {
    /// `csv`, `kiknet`, `cosmos`, … (`flare-pipe list formats`), `any` where files are told by their content, or `twin`, whose records are
    /// computed from `truth`.
    pub format: String,
    /// Folder of the files, relative to the manifest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dir: Option<String>,
    /// Unit of the files: `g`, `gal` or `m/s2`; not needed where the files say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<AccelerationUnit>,
    /// Truth file, relative to this manifest: what holds at the twin, or what to do to measured records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<String>,
    /// Horizontal components, each calibrated by itself.
    pub components: Vec<String>,
    /// Events to calibrate on.
    pub train: Vec<String>,
    /// Events to select on.
    pub validation: Vec<String>,
    /// Events held out from everything.
    pub test: Vec<String>,
    /// Noise of the sensors where it is known (`[records.noise]`); otherwise it is read off what was recorded before each event.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<DeclaredNoise>,
    /// Which channel is which component of a sensor, where the names of the files do not say it (`[records.channels]`): for example
    /// `surface = { NS = "*.HNN", EW = "*.HNE" }`. A pattern (`*`, `?`, `[ab]`) is for the name of a channel, that of a file, or
    /// `FILE:CHANNEL`; a list of patterns where they differ between events.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub channels: BTreeMap<String, BTreeMap<String, Names>>,
    /// Parameters of the format (`[records.options]`).
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    #[schemars(with = "std::collections::BTreeMap<String, serde_json::Value>")]
    pub options: toml::Table,
}

/// Patterns for the name of a channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "OneOrMore", into = "OneOrMore")]
#[schemars(with = "OneOrMore")]
pub struct Names(Vec<glob::Pattern>);

impl Names {
    /// The patterns.
    pub fn patterns(&self) -> &[glob::Pattern] {
        &self.0
    }
}

#[derive(Clone, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
enum OneOrMore {
    One(String),
    More(Vec<String>),
}

impl TryFrom<OneOrMore> for Names {
    type Error = String;

    fn try_from(names: OneOrMore) -> std::result::Result<Self, String> {
        let texts = match names {
            OneOrMore::One(text) => vec![text],
            OneOrMore::More(texts) => texts,
        };
        let pattern = |text: String| glob::Pattern::new(&text).map_err(|e| format!("`{text}` is no pattern: {e}"));
        texts.into_iter().map(pattern).collect::<std::result::Result<_, _>>().map(Self)
    }
}

impl From<Names> for OneOrMore {
    fn from(names: Names) -> Self {
        Self::More(names.0.iter().map(|pattern| pattern.as_str().to_string()).collect())
    }
}

/// White noise of every sensor: one of the two.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DeclaredNoise {
    /// Standard deviation as a share of the RMS of each channel, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_share: Option<f64>,
    /// Standard deviation, m/s².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub floor_m_s2: Option<f64>,
}

impl DeclaredNoise {
    /// Standard deviation of the noise of a channel whose record has this RMS, m/s².
    pub fn deviation_m_s2(self, rms_m_s2: f64) -> f64 {
        self.floor_m_s2.unwrap_or_else(|| self.rms_share.unwrap_or(0.0) * rms_m_s2)
    }

    fn problem(self) -> Option<String> {
        match (self.rms_share, self.floor_m_s2) {
            (Some(share), None) if share > 0.0 && share < 1.0 => None,
            (None, Some(floor)) if floor > 0.0 && floor.is_finite() => None,
            (Some(share), None) => Some(format!("`noise.rms_share` must be between 0 and 1, got {share}")),
            (None, Some(floor)) => Some(format!("`noise.floor_m_s2` must be above 0 m/s², got {floor}")),
            _ => Some("`noise` needs either `rms_share` or `floor_m_s2`, and not both".into()),
        }
    }
}

/// What an event may be used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Coefficients are fitted on it.
    Train,
    /// The model is selected on it.
    Validation,
    /// Nothing is chosen by it.
    Test,
}

impl RecordSettings {
    /// Settings by which the channels of any file are read.
    pub fn any() -> Self {
        Self {
            format: super::ANY.into(),
            dir: None,
            unit: None,
            truth: None,
            components: Vec::new(),
            train: Vec::new(),
            validation: Vec::new(),
            test: Vec::new(),
            noise: None,
            channels: BTreeMap::new(),
            options: toml::Table::new(),
        }
    }

    /// All events with their split, in the order train, validation, test.
    pub fn events(&self) -> impl Iterator<Item = (&str, Split)> {
        [(&self.train, Split::Train), (&self.validation, Split::Validation), (&self.test, Split::Test)]
            .into_iter()
            .flat_map(|(events, split)| events.iter().map(move |event| (event.as_str(), split)))
    }

    /// All that is wrong with the values: (dotted key, what is wrong).
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        let mut say = |key: &str, what: String| found.push((key.to_string(), what));
        let names: Vec<&str> = super::FORMATS.iter().map(|e| e.name).chain([super::ANY, "twin"]).collect();
        if self.format == "twin" {
            if self.truth.is_none() {
                say("truth", "records of format `twin` need `truth`, the manifest of the twin".into());
            }
        } else if !names.contains(&self.format.as_str()) {
            let known = crate::registry::known(&names, &self.format);
            say("format", format!("unknown record format `{}`; {known}", self.format));
        } else if self.dir.is_none() {
            say("dir", format!("records of format `{}` need `dir`, the folder of their files", self.format));
        }
        for (key, list) in [("components", &self.components), ("train", &self.train), ("validation", &self.validation)]
        {
            if list.is_empty() {
                say(key, format!("`{key}` must name at least one"));
            }
        }
        if let Some(what) = self.noise.and_then(DeclaredNoise::problem) {
            say("noise", what);
        }
        let mut seen: Vec<(&str, Split)> = Vec::new();
        for (event, split) in self.events() {
            let key = |s: Split| ["train", "validation", "test"][s as usize];
            if let Some(bad) = bad_character(event) {
                say(key(split), format!("event `{event}` holds `{bad}`, which a file name cannot"));
            }
            match seen.iter().find(|(name, _)| *name == event) {
                Some((_, first)) if *first == split => say(key(split), format!("event `{event}` comes twice")),
                Some((_, first)) => say(
                    key(split),
                    format!(
                        "event `{event}` is in both `{}` and `{}`; an event belongs to one",
                        key(*first),
                        key(split)
                    ),
                ),
                None => seen.push((event, split)),
            }
        }
        for (sensor, of) in &self.channels {
            for component in of.keys().filter(|name| !self.components.contains(name)) {
                let names: Vec<&str> = self.components.iter().map(String::as_str).collect();
                let known = crate::registry::known(&names, component);
                say(
                    "channels",
                    format!("`channels.{sensor}` has a component `{component}` that is not in `components`; {known}"),
                );
            }
        }
        for (i, component) in self.components.iter().enumerate() {
            if let Some(bad) = bad_character(component) {
                say("components", format!("component `{component}` holds `{bad}`, which a file name cannot"));
            }
            if self.components[..i].contains(component) {
                say("components", format!("component `{component}` comes twice"));
            }
        }
        found
    }
}

fn bad_character(name: &str) -> Option<char> {
    if name.is_empty() || name.starts_with('.') {
        return Some(name.chars().next().unwrap_or(' '));
    }
    name.chars().find(|c| !(c.is_alphanumeric() || "-_.+ ".contains(*c)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(extra: &str) -> RecordSettings {
        let text = format!(
            "format = 'csv'\ndir = 'x'\nunit = 'g'\ncomponents = ['NS', 'EW']\ntrain = ['A']\nvalidation = ['B']\ntest = ['C']\n{extra}"
        );
        toml::from_str(&text).unwrap()
    }

    #[test]
    fn a_sound_section_has_no_problems_and_lists_events_by_split() {
        let s = settings("");
        assert!(s.problems().is_empty());
        let events: Vec<_> = s.events().collect();
        assert_eq!(events, [("A", Split::Train), ("B", Split::Validation), ("C", Split::Test)]);
    }

    #[test]
    fn every_problem_is_reported_at_its_key() {
        let mut s = settings("");
        s.format = "cvs".into();
        s.test = vec!["A".into(), "../x".into()];
        s.components.push("NS".into());
        let keys: Vec<String> = s.problems().into_iter().map(|(k, _)| k).collect();
        assert_eq!(keys, ["format", "test", "test", "components"]);
        let twin = RecordSettings { format: "twin".into(), ..settings("") };
        assert_eq!(twin.problems()[0].0, "truth");
        for (table, is_sound) in [
            ("rms_share = 0.02", true),
            ("floor_m_s2 = 0.001", true),
            ("", false),
            ("rms_share = 0.02, floor_m_s2 = 0.001", false),
            ("rms_share = 2.0", false),
            ("floor_m_s2 = 0.0", false),
        ] {
            let keys: Vec<String> =
                settings(&format!("noise = {{ {table} }}")).problems().into_iter().map(|(k, _)| k).collect();
            assert_eq!(keys.is_empty(), is_sound, "{table}: {keys:?}");
        }
        let nowhere = RecordSettings { dir: None, ..settings("") };
        assert_eq!(nowhere.problems()[0].0, "dir");
    }
}
