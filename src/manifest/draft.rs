//! The first manifest of a site: its layers from a table, its sensors and events from a folder of records, comments for the rest.

use super::table::LayerRow;
use crate::units::AccelerationUnit;
use std::fmt::Write as _;

/// Frequency up to which the elements of a first manifest carry waves with [`ELEMENTS`] each, Hz.
const HIGHEST_HZ: f64 = 20.0;
/// Elements in a wavelength.
const ELEMENTS: f64 = 20.0;
/// Share of the events that calibrate, and of those that validate; the others are held out.
const SHARES: [f64; 2] = [0.5, 0.25];

/// What a first manifest is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// Name of the site.
    pub name: String,
    /// Layers from the surface down.
    pub layers: Vec<LayerRow>,
    /// Whether these are a guess.
    pub is_guess: bool,
    /// Depth of the water table, m.
    pub water_table_m: Option<f64>,
    /// Sensors with their depths in m; the deepest is the input.
    pub sensors: Vec<(String, f64)>,
    /// Records, if there are any yet.
    pub records: Option<DraftRecords>,
}

/// Records of a first manifest.
#[derive(Debug, Clone, PartialEq)]
pub struct DraftRecords {
    /// Format of the files.
    pub format: String,
    /// Their folder, as written.
    pub dir: String,
    /// Unit, where the files do not say it.
    pub unit: Option<AccelerationUnit>,
    /// Horizontal components.
    pub components: Vec<String>,
    /// Sensor, component and the name of its channel, where the names of files do not say it.
    pub channels: Vec<[String; 3]>,
    /// Events, in the order in which they are split.
    pub events: Vec<String>,
}

impl Draft {
    /// The text of the manifest.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let mut say = |line: std::fmt::Arguments<'_>| {
            let _ = writeln!(text, "{line}");
        };
        say(format_args!(
            "# Written by `flare-pipe init`. Look at every line with a question mark, then: flare-pipe check"
        ));
        say(format_args!("name = {}", quoted(&self.name)));
        say(format_args!("about = \"\" # ? a sentence about the site, and where its records come from"));
        say(format_args!("# What `flare-pipe run` does: `diagnose`, or `close-loop`, which trains FLARE-T as well."));
        say(format_args!("pipeline = \"diagnose\"\n"));
        let counts = self.elements();
        let depth_m: f64 = self.layers.iter().map(|l| l.thickness_m).sum();
        say(format_args!("[site]"));
        say(format_args!("depth_m = {} # of the input sensor, which is the base of the column", number(depth_m)));
        say(format_args!("# {ELEMENTS} elements in a wavelength up to {HIGHEST_HZ} Hz."));
        say(format_args!("elements = {}", counts.iter().sum::<usize>()));
        match self.water_table_m {
            Some(depth_m) => say(format_args!("water_table_m = {}\n", number(depth_m))),
            None => say(format_args!("# water_table_m = 2.0 # ? dry without it\n")),
        }
        let finest = self.layers.iter().zip(&counts).map(|(l, n)| *n as f64 / l.thickness_m).fold(0.0, f64::max);
        for (layer, count) in self.layers.iter().zip(&counts) {
            say(format_args!("[[site.layer]]"));
            say(format_args!("thickness_m = {}", number(layer.thickness_m)));
            let guess = if self.is_guess { " # ? no profile was given: put its layers here" } else { "" };
            say(format_args!("vs_m_s = {}{guess}", number(layer.vs_m_s)));
            let guess = if layer.density_kg_m3.is_none() { " # ? of wet soil" } else { "" };
            say(format_args!("density_kg_m3 = {}{guess}", number(layer.density_kg_m3.unwrap_or(1900.0))));
            say(format_args!("fineness = {:.3}", *count as f64 / layer.thickness_m / finest));
            say(format_args!("law = \"soil\""));
            if let Some(index) = layer.plasticity_index {
                say(format_args!("plasticity_index = {}", number(index)));
            }
            if let Some(ratio) = layer.damping_ratio {
                say(format_args!("damping_ratio = {}", number(ratio)));
            }
            say(format_args!(""));
        }
        say(format_args!(
            "# Modulus and damping by strain: `flare-pipe list laws`. What the law has may be said of a single layer, too."
        ));
        say(format_args!("[law.soil]"));
        say(format_args!("kind = \"hyperbolic\""));
        say(format_args!("plasticity_index = 15.0 # ? %; the curves are those of Darendeli (2001)\n"));
        self.write_sensors(&mut say);
        self.write_records(&mut say);
        say(format_args!(
            "# How well what is declared is known, as standard deviations: `flare-pipe schema` has all of them."
        ));
        say(format_args!("[tolerances]"));
        let vs_ln = if self.is_guess { 0.3 } else { 0.05 };
        say(format_args!(
            "vs_ln = {vs_ln} # ? of ln Vs of a layer; 0.1 to 0.3 where it was not measured in a borehole"
        ));
        say(format_args!("model = 0.05 # error of the column itself, as a share of what it adds to its base"));
        text
    }

    fn write_sensors(&self, say: &mut impl FnMut(std::fmt::Arguments<'_>)) {
        let deepest = self.sensors.iter().map(|s| s.1).fold(0.0, f64::max);
        let input = self.sensors.iter().find(|s| s.1 == deepest);
        say(format_args!("[sensors]"));
        say(format_args!("input = {} # at the base of the column", quoted(input.map_or("base", |s| &s.0))));
        say(format_args!(""));
        for (name, depth_m) in self.sensors.iter().filter(|s| Some(*s) != input) {
            say(format_args!("[[sensors.output]]"));
            say(format_args!("name = {}", quoted(name)));
            say(format_args!("depth_m = {}\n", number(*depth_m)));
        }
    }

    fn write_records(&self, say: &mut impl FnMut(std::fmt::Arguments<'_>)) {
        let Some(records) = &self.records else {
            say(format_args!(
                "# [records] # ? one file an event and component, columns `time_s` and the names of the sensors"
            ));
            say(format_args!(
                "# format = \"csv\"\n# dir = \"records\"\n# unit = \"m/s2\"\n# components = [\"EW\", \"NS\"]"
            ));
            say(format_args!("# train = [\"E1\", \"E2\"]\n# validation = [\"E3\"]\n# test = [\"E4\"]\n"));
            return;
        };
        let list = |names: &[String]| names.iter().map(|n| quoted(n)).collect::<Vec<_>>().join(", ");
        let [train, validation, test] = split(&records.events);
        say(format_args!("[records]"));
        say(format_args!("format = {}", quoted(&records.format)));
        say(format_args!("dir = {}", quoted(&records.dir)));
        if let Some(unit) = records.unit {
            say(format_args!("unit = {}", quoted(unit.name())));
        }
        say(format_args!("components = [{}] # ? horizontal", list(&records.components)));
        say(format_args!(
            "# ? Every fourth event or so to each of the last two, by name; strong ones should be in all three."
        ));
        say(format_args!("train = [{}]", list(&train)));
        say(format_args!("validation = [{}]", list(&validation)));
        say(format_args!("# Held out: opened once, when errors before and after are compared."));
        say(format_args!("test = [{}]\n", list(&test)));
        if !records.channels.is_empty() {
            say(format_args!(
                "# Which channel is which: its name, that of its file, or FILE:CHANNEL; `*` stands for anything."
            ));
            say(format_args!("[records.channels]"));
            let mut sensors: Vec<&String> = records.channels.iter().map(|[sensor, ..]| sensor).collect();
            sensors.dedup();
            for sensor in sensors {
                let of = records.channels.iter().filter(|[s, ..]| s == sensor);
                let pairs: Vec<String> =
                    of.map(|[_, component, name]| format!("{} = {}", key(component), quoted(name))).collect();
                say(format_args!("{} = {{ {} }}", key(sensor), pairs.join(", ")));
            }
            say(format_args!(""));
        }
    }

    /// Elements of each layer.
    fn elements(&self) -> Vec<usize> {
        let of = |l: &LayerRow| (l.thickness_m * ELEMENTS * HIGHEST_HZ / l.vs_m_s).ceil().max(1.0) as usize;
        self.layers.iter().map(of).collect()
    }
}

/// Events to calibrate, to validate and held out, evenly spread over their order; at least one for each of the first two.
fn split(events: &[String]) -> [Vec<String>; 3] {
    let n = events.len();
    let mut parts: [Vec<String>; 3] = Default::default();
    let mut taken = [0usize; 3];
    let shares = [SHARES[0], SHARES[1], 1.0 - SHARES[0] - SHARES[1]];
    for (i, event) in events.iter().enumerate() {
        let behind = |p: &usize| shares[*p] * (i + 1) as f64 - taken[*p] as f64;
        let part = if n < 3 {
            i.min(1)
        } else {
            (0..3).max_by(|a, b| behind(a).total_cmp(&behind(b)).then(b.cmp(a))).unwrap_or(0)
        };
        taken[part] += 1;
        parts[part].push(event.clone());
    }
    parts
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// A name as TOML reads it as a key.
fn key(text: &str) -> String {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if text.chars().all(is_bare) { text.into() } else { quoted(text) }
}

/// A number as TOML reads it as one.
fn number(value: f64) -> String {
    toml::Value::from((value * 1e6).round() / 1e6).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_spread_over_the_split() {
        let names = |n: usize| (1..=n).map(|i| format!("E{i}")).collect::<Vec<_>>();
        for n in 2..20 {
            let [train, validation, test] = split(&names(n));
            assert!(!train.is_empty() && !validation.is_empty() && (n < 3 || !test.is_empty()), "{n}");
            assert_eq!(train.len() + validation.len() + test.len(), n);
        }
        let [train, validation, test] = split(&names(8));
        assert_eq!((train.len(), validation.len(), test.len()), (4, 2, 2));
    }
}
