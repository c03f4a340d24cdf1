//! What is known about an effect before any data: its parameters, where it can sit in an array, and what it is taken for.
//!
//! The same data serve twin truths, screening, fitting, corrected manifests and the report.

use crate::column::Profile;
use rand::{Rng, RngExt};
use toml::Value;

/// What an effect acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// The soil of the column.
    Soil,
    /// What the column is fixed to, loaded by or shaken with.
    Boundary,
    /// What the sensors make of the motion; never the soil.
    Sensor,
    /// What strays in the field or has no name: nothing that a diagnosis names or a correction is made of.
    Field,
}

impl Class {
    /// Whether it changes how the column is shaken.
    pub fn moves_column(self) -> bool {
        matches!(self, Self::Soil | Self::Boundary)
    }
}

/// How a parameter's value is turned into the coordinate in which it is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// The value itself.
    Linear,
    /// Its natural logarithm.
    Log,
    /// One over it: zero is a value beyond all bounds.
    Inverse,
}

/// One parameter of an effect; `low`, `high`, `zero` and `draw` in the unit of its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Key in `[[effects]]`.
    pub name: &'static str,
    /// Unit for people; empty where there is none.
    pub unit: &'static str,
    /// The value at which the effect vanishes; `None` where the parameter only shapes it.
    pub zero: Option<f64>,
    /// Smallest plausible value.
    pub low: f64,
    /// Largest plausible value.
    pub high: f64,
    /// Coordinate in which it is estimated.
    pub scale: Scale,
    /// Prior standard deviation of the coordinate.
    pub prior_sd: f64,
    /// Range of a twin's draw.
    pub draw: [f64; 2],
    /// Whether a draw takes either sign.
    pub is_signed: bool,
}

impl Parameter {
    /// The coordinate of `value`.
    pub fn coordinate(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => value,
            Scale::Log => value.ln(),
            Scale::Inverse => 1.0 / value,
        }
    }

    /// Its prior in words, in the coordinate in which it is estimated: normal about nothing, or its typical size where it only shapes the
    /// effect.
    pub fn prior(&self) -> String {
        let of = match self.scale {
            Scale::Linear => "",
            Scale::Log => "ln of it ",
            Scale::Inverse => "1 over it ",
        };
        match self.zero {
            Some(zero) => format!("{of}normal about {}, sd {}", self.coordinate(zero), self.prior_sd),
            None => format!("{of}shapes the effect, typical size {}", self.prior_sd),
        }
    }

    /// The value at `coordinate`.
    pub fn value(&self, coordinate: f64) -> f64 {
        match self.scale {
            Scale::Linear => coordinate,
            Scale::Log => coordinate.exp(),
            Scale::Inverse => 1.0 / coordinate,
        }
    }

    /// Smallest and largest coordinate; where the scale is inverse, the effect's absence is the smallest.
    pub fn bounds(&self) -> [f64; 2] {
        match self.scale {
            Scale::Inverse => [0.0, 1.0 / self.low],
            _ => [self.coordinate(self.low), self.coordinate(self.high)],
        }
    }

    fn drawn(&self, random: &mut impl Rng) -> f64 {
        let [low, high] = self.draw.map(|v| self.coordinate(v));
        let drawn = self.value(low + (high - low) * random.random::<f64>());
        if self.is_signed && random.random::<bool>() { -drawn } else { drawn }
    }
}

/// Catalogue data of one effect.
pub struct Catalogue {
    /// Number in the catalogue of `closing the loop`.
    pub number: u8,
    /// What it acts on.
    pub class: Class,
    /// Its parameters, the strength first.
    pub parameters: &'static [Parameter],
    /// The places of an array where it may sit, a fit started at each.
    pub instances: fn(&Array) -> Vec<Instance>,
    /// Kinds that look alike at few sensors.
    pub confused_with: &'static [&'static str],
    /// What tells it from those.
    pub key: &'static str,
}

/// The array and the declared column it stands on.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// The declared column, without effects.
    pub profile: Profile,
    /// Name of the input sensor, at the base.
    pub input: String,
    /// Names of the output sensors.
    pub outputs: Vec<String>,
    /// Their depths, m.
    pub depths_m: Vec<f64>,
    /// Horizontal components.
    pub components: Vec<String>,
}

impl Array {
    /// Names of all sensors, the input sensor first.
    pub fn sensors(&self) -> impl Iterator<Item = &str> {
        std::iter::once(self.input.as_str()).chain(self.outputs.iter().map(String::as_str))
    }

    /// One instance of `kind` at every sensor, the input sensor first.
    pub fn one_each(&self, kind: &'static str, free: &[Free]) -> Vec<Instance> {
        self.sensors().map(|s| Instance::new(kind, [("sensor", s.into())], free.to_vec())).collect()
    }

    /// One instance of `kind` at every output sensor.
    pub fn one_each_output(&self, kind: &'static str, free: &[Free]) -> Vec<Instance> {
        self.outputs.iter().map(|s| Instance::new(kind, [("sensor", s.as_str().into())], free.to_vec())).collect()
    }

    /// Depths that cut the column at its sensors: 0, the output sensors' depths rising, the base.
    pub fn cuts_m(&self) -> Vec<f64> {
        let mut cuts = self.depths_m.clone();
        cuts.extend([0.0, self.profile.depth_m()]);
        cuts.sort_by(f64::total_cmp);
        cuts.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
        cuts
    }

    /// Whether a layer follows one of the law `kinds`.
    pub fn has_law(&self, kinds: &[&str]) -> bool {
        self.profile.layers.iter().any(|l| kinds.contains(&l.law_kind.as_str()))
    }
}

/// An effect at one place of the array, its parameters still free.
#[derive(Debug, Clone, PartialEq)]
pub struct Instance {
    /// Name of the effect.
    pub kind: &'static str,
    /// Where it sits and what is held fixed.
    pub target: toml::Table,
    /// Parameters to estimate, the strength first; none for a discrete effect.
    pub free: Vec<Free>,
}

/// A free parameter of an instance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// The parameter.
    pub parameter: &'static Parameter,
    /// The value at which the effect vanishes in this array; `None` where the parameter only shapes it.
    pub zero: Option<f64>,
    /// A value to start from.
    pub start: f64,
    /// Typical size of the coordinate at this place.
    pub size: f64,
}

impl Free {
    /// A parameter whose fit starts at `start`, with its own zero and prior deviation.
    pub const fn new(parameter: &'static Parameter, start: f64) -> Self {
        Self { parameter, zero: parameter.zero, start, size: parameter.prior_sd }
    }
}

impl Instance {
    /// An instance of `kind` at `target` with the given free parameters.
    pub fn new<const N: usize>(kind: &'static str, target: [(&str, Value); N], free: Vec<Free>) -> Self {
        Self { kind, target: target.into_iter().map(|(k, v)| (k.to_string(), v)).collect(), free }
    }

    /// One of `kind` between two depths, m.
    pub fn between(kind: &'static str, [top_m, bottom_m]: [f64; 2], free: Vec<Free>) -> Self {
        Self::new(kind, [("top_m", top_m.into()), ("bottom_m", bottom_m.into())], free)
    }

    /// Whether it is the same kind at the same place.
    pub fn is_same(&self, other: &Self) -> bool {
        self.kind == other.kind && self.target == other.target
    }

    /// Whether it is the same effect at whatever place: the value of one parameter says nothing of another's.
    pub fn is_alike(&self, other: &Self) -> bool {
        let names = |i: &Self| i.free.iter().map(|f| f.parameter.name).collect::<Vec<_>>();
        self.kind == other.kind && names(self) == names(other)
    }

    /// Whether it is the same parameters of the same effect at the same place.
    pub fn is_one(&self, other: &Self) -> bool {
        self.is_same(other) && self.is_alike(other)
    }

    /// Depth of its place, m, where that is a depth.
    pub fn depth_m(&self) -> Option<f64> {
        self.target.get("depth_m").and_then(Value::as_float)
    }

    /// The same at another depth, m.
    #[must_use]
    pub fn at_depth(&self, depth_m: f64) -> Self {
        let mut other = self.clone();
        other.target.insert("depth_m".into(), depth_m.into());
        other
    }

    /// Whether it has something to act on in a column of `profile` at these coordinates.
    pub fn acts_on(&self, profile: &Profile, coordinates: &[f64]) -> bool {
        super::build(&self.at(coordinates)).is_ok_and(|effect| effect.refusal(profile).is_none())
    }

    /// Whether it is something that a diagnosis names.
    pub fn is_named(&self) -> bool {
        self.class() != Class::Field
    }

    /// What it acts on.
    pub fn class(&self) -> Class {
        super::find(self.kind).map_or(Class::Soil, |e| e.catalogue.class)
    }

    /// Whether it changes how the column is shaken, or where in it a sensor sits.
    pub fn changes_column(&self) -> bool {
        super::changes_column(&self.at(&self.start()))
    }

    /// The `[[effects]]` table at the given values of the free parameters.
    pub fn table(&self, values: &[f64]) -> toml::Table {
        let mut table = toml::Table::from_iter([("kind".to_string(), Value::from(self.kind))]);
        table.extend(self.target.clone());
        for (free, value) in self.free.iter().zip(values) {
            table.insert(free.parameter.name.into(), Value::Float(*value));
        }
        table
    }

    /// The `[[effects]]` table at the given coordinates.
    pub fn at(&self, coordinates: &[f64]) -> toml::Table {
        let values: Vec<f64> = self.free.iter().zip(coordinates).map(|(f, x)| f.parameter.value(*x)).collect();
        self.table(&values)
    }

    /// Coordinates from which to fit.
    pub fn start(&self) -> Vec<f64> {
        self.free.iter().map(|f| f.parameter.coordinate(f.start)).collect()
    }

    /// Coordinates at which the effect vanishes; what only shapes it stays at its start. `None` for a discrete effect.
    pub fn zero(&self) -> Option<Vec<f64>> {
        let zero = |f: &Free| f.parameter.coordinate(f.zero.unwrap_or(f.start));
        self.free.iter().any(|f| f.zero.is_some()).then(|| self.free.iter().map(zero).collect())
    }

    /// Numbers that it takes from each record that carries it, besides its parameters.
    pub fn hidden(&self) -> usize {
        super::build(&self.at(&self.start())).map_or(0, |effect| effect.hidden())
    }

    /// Whether it exchanges the labels of two sensors, or of the components of one.
    pub fn exchanges_labels(&self) -> bool {
        self.free.is_empty() && super::build(&self.at(&[])).is_ok_and(|effect| effect.exchange().is_some())
    }

    /// Index of the free parameter that is the frequency of a line: its phase is taken from each record.
    pub fn line(&self) -> Option<usize> {
        let is_frequency = |f: &Free| f.zero.is_none() && f.parameter.unit == "Hz";
        self.free.iter().position(is_frequency).filter(|_| self.hidden() > 0)
    }

    /// Index of the free parameter that is a delay, if it has one.
    pub fn delay(&self) -> Option<usize> {
        self.free.iter().position(|f| f.zero.is_none() && f.parameter.unit == "s")
    }

    /// Smallest and largest coordinate of each free parameter.
    pub fn bounds(&self) -> Vec<[f64; 2]> {
        self.free.iter().map(|f| f.parameter.bounds()).collect()
    }

    /// A table with drawn parameters, for a twin.
    pub fn draw(&self, random: &mut impl Rng) -> toml::Table {
        let values: Vec<f64> = self.free.iter().map(|f| f.parameter.drawn(random)).collect();
        self.table(&values)
    }

    /// Where it sits, for people: `surface`, `0–6 m`, `EW`; empty for the whole column.
    pub fn place(&self) -> String {
        place(&self.target)
    }
}

/// Where an `[[effects]]` table sits, for people; empty for the whole column.
pub fn place(table: &toml::Table) -> String {
    let text = |key: &str| table.get(key).and_then(Value::as_str);
    let number = |key: &str| table.get(key).and_then(|v| v.as_float().or(v.as_integer().map(|i| i as f64)));
    let mut parts: Vec<String> = Vec::new();
    parts.extend(text("sensor").map(String::from));
    parts.extend(text("with").map(|name| format!("↔ {name}")));
    parts.extend(text("component").map(String::from));
    if let Some(bottom) = number("bottom_m") {
        parts.push(format!("{:.1}–{bottom:.1} m", number("top_m").unwrap_or(0.0)));
    } else if let Some(depth) = number("depth_m") {
        parts.push(format!("at {depth:.1} m"));
    }
    parts.extend(text("material").or(text("law")).map(String::from));
    parts.join(" ")
}
