//! Effects a declared site model may lack: one effect a file, registered in [`EFFECTS`].
//!
//! A soil or boundary effect edits the set-up of the column; a sensor effect acts between the true motion and the
//! record. One definition serves twin truths, diagnosis and corrected manifests; an effect of zero strength leaves
//! everything bit-identical.

mod catalogue;
mod layers;
mod observation;
mod operator;
mod situation;

mod ageing;
mod baseline_tilt;
mod clock_offset;
mod compliant_base;
mod container_boundary;
mod contractancy;
mod curve_shape;
mod directional_anisotropy;
mod downgoing_wave;
mod frequency_dependent_damping;
mod incoherence;
mod instrument_high_pass;
mod instrument_low_pass;
mod interface_depth;
mod interface_slip;
mod layer_velocity;
mod machine_hum;
mod nonlinearity;
mod pore_pressure;
mod rate_dependence;
mod sensor_depth;
mod sensor_gain;
mod sensor_orientation;
mod sensor_polarity;
mod small_strain_damping;
mod stiff_crust;
mod structure_interaction;
mod surface_wave;
mod swapped_channels;
mod thin_seam;
mod tolerances;
mod unnamed_response;
mod water_table;

pub use catalogue::{Array, Catalogue, Class, Free, Instance, Parameter, Scale, place};
pub use frequency_dependent_damping::FREQUENCY_DEPENDENT_DAMPING;
pub use layer_velocity::{LAYER_VELOCITY_LN, velocity_between};
pub use layers::Laws;
pub use observation::{Channels, Direction, Recording, depth_m, observe, operator};
pub use operator::{Operator, Place};
pub use situation::Situation;
pub use tolerances::{Tolerances, Tolerated, tolerated};

/// Kinds that other rooms name.
pub mod kind {
    use super::{clock_offset, layer_velocity, nonlinearity, sensor_gain, small_strain_damping};

    /// Of the file of that name.
    pub const CLOCK_OFFSET: &str = clock_offset::ENTRY.name;
    /// Of the file of that name.
    pub const LAYER_VELOCITY: &str = layer_velocity::ENTRY.name;
    /// Of the file of that name.
    pub const NONLINEARITY: &str = nonlinearity::ENTRY.name;
    /// Of the file of that name.
    pub const SENSOR_GAIN: &str = sensor_gain::ENTRY.name;
    /// Of the file of that name.
    pub const SMALL_STRAIN_DAMPING: &str = small_strain_damping::ENTRY.name;
}

use crate::column::Profile;
use crate::error::{Error, Result};
use crate::registry::{self, Named};
use realfft::num_complex::Complex;

/// Something that acts on the column or on what its sensors record; each effect overrides what it does and no more.
pub trait Effect: Send + Sync {
    /// Names of the sensors it sits at.
    fn sensors(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Name of the component it is restricted to.
    fn component(&self) -> Option<&str> {
        None
    }

    /// Edits the set-up of the column.
    fn edit(&self, _profile: &mut Profile, _situation: &Situation) {}

    /// The laws that it acts on, where it does not act on every law.
    fn laws(&self) -> Option<Laws> {
        None
    }

    /// Why it has nothing to act on in `profile`, where that is so.
    fn refusal(&self, profile: &Profile) -> Option<String> {
        self.laws()?.refusal(profile)
    }

    /// The depth at which `sensor` really sits when it is declared at `depth_m`.
    fn depth_m(&self, _sensor: &str, depth_m: f64) -> f64 {
        depth_m
    }

    /// Whether it moves a sensor in the column.
    fn moves_sensor(&self) -> bool {
        false
    }

    /// What the sensor makes of the motion; `None` where it is untouched.
    fn response(&self, _place: &Place<'_>, _frequency_hz: f64) -> Option<Operator> {
        None
    }

    /// Two sensors whose channels are exchanged; one twice where its two components are.
    fn exchange(&self) -> Option<(&str, &str)> {
        None
    }

    /// Whether a further arrival is all it is: the column is shaken as without it.
    fn is_arrival(&self) -> bool {
        false
    }

    /// A further arrival at depth `depth_m`, as a factor on the spectrum of the true base motion.
    fn arrival(&self, _depth_m: f64, _frequency_hz: f64) -> Option<Complex<f64>> {
        None
    }

    /// What the instrument adds to one channel, beside and after its response.
    fn interference(&self, _channel: &Channel<'_>) -> Option<Vec<f64>> {
        None
    }

    /// The same, estimated from the record that carries it.
    fn estimated_interference(&self, _channel: &Channel<'_>) -> Option<Vec<f64>> {
        None
    }

    /// Numbers that it takes from each record that carries it, besides its parameters.
    fn hidden(&self) -> usize {
        0
    }
}

/// One history of one sensor.
#[derive(Debug, Clone, Copy)]
pub struct Channel<'a> {
    /// Name of the sensor.
    pub sensor: &'a str,
    /// Name of the component.
    pub component: &'a str,
    /// Name of the event.
    pub event: &'a str,
    /// Time step, s.
    pub dt_s: f64,
    /// Acceleration, m/s².
    pub acceleration_m_s2: &'a [f64],
}

/// A registered effect.
pub struct Entry {
    /// Name as typed in `[[effects]]` and printed by `flare-pipe list effects`.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// What is said of one that was found, for each of its forms: of these the first whose parameters it has. `{place}` is where it sits,
    /// `{name}` the value of a parameter, `{name|lower|higher}` its size and the word for its sign.
    pub phrases: &'static [&'static str],
    /// Builds the effect from its table; unknown keys are refused.
    pub build: fn(toml::Table) -> Result<Box<dyn Effect>>,
    /// JSON Schema of that table.
    pub schema: fn() -> schemars::Schema,
    /// What is known about it before any data.
    pub catalogue: Catalogue,
}

impl Named for Entry {
    fn name(&self) -> &'static str {
        self.name
    }
}

/// All effects, by their name in `[[effects]]`.
pub const EFFECTS: &[Entry] = &[
    layer_velocity::ENTRY,
    thin_seam::ENTRY,
    small_strain_damping::ENTRY,
    frequency_dependent_damping::ENTRY,
    nonlinearity::ENTRY,
    pore_pressure::ENTRY,
    interface_slip::ENTRY,
    compliant_base::ENTRY,
    structure_interaction::ENTRY,
    directional_anisotropy::ENTRY,
    sensor_gain::ENTRY,
    sensor_polarity::ENTRY,
    clock_offset::ENTRY,
    sensor_orientation::ENTRY,
    sensor_depth::ENTRY,
    swapped_channels::ENTRY,
    instrument_high_pass::ENTRY,
    instrument_low_pass::ENTRY,
    baseline_tilt::ENTRY,
    machine_hum::ENTRY,
    surface_wave::ENTRY,
    ageing::ENTRY,
    water_table::ENTRY,
    stiff_crust::ENTRY,
    container_boundary::ENTRY,
    rate_dependence::ENTRY,
    contractancy::ENTRY,
    curve_shape::ENTRY,
    interface_depth::ENTRY,
    downgoing_wave::ENTRY,
    incoherence::ENTRY,
    unnamed_response::ENTRY,
];

/// The registered effect `kind`.
///
/// # Errors
/// When there is none of this name.
pub fn find(kind: &str) -> Result<&'static Entry> {
    registry::find("effect", EFFECTS, kind)
}

/// Every place in `array` of every effect that is a candidate.
pub fn instances(array: &Array) -> Vec<Instance> {
    EFFECTS.iter().filter(|e| e.catalogue.class != Class::Field).flat_map(|e| (e.catalogue.instances)(array)).collect()
}

/// Responses of the output sensors of `array` that have no name: what named effects are compared with.
pub fn unnamed(array: &Array) -> Vec<Instance> {
    (unnamed_response::ENTRY.catalogue.instances)(array)
}

/// Builds one `[[effects]]` table.
///
/// # Errors
/// When `kind` is missing or unknown, or a parameter is missing, unknown or out of range.
pub fn build(table: &toml::Table) -> Result<Box<dyn Effect>> {
    let mut table = table.clone();
    match table.remove("kind") {
        Some(toml::Value::String(kind)) => (find(&kind)?.build)(table),
        _ => {
            let names: Vec<&str> = EFFECTS.iter().map(|e| e.name).collect();
            Err(Error::new("an effect needs a `kind`").hint(registry::known(&names, "")).usage())
        }
    }
}

/// Whether the effect of `table` changes the motion where sensors sit, and not only what they make of it; one that cannot be built does
/// not.
pub fn changes_motion(table: &toml::Table) -> bool {
    let kind = table.get("kind").and_then(toml::Value::as_str).unwrap_or_default();
    let class = find(kind).map(|entry| entry.catalogue.class);
    class.is_ok_and(Class::moves_column) || build(table).is_ok_and(|effect| effect.moves_sensor())
}

/// Whether the effect of `table` changes how the column is shaken, or where in it a sensor sits.
pub fn changes_column(table: &toml::Table) -> bool {
    changes_motion(table) && build(table).is_ok_and(|effect| !effect.is_arrival())
}

/// Builds every table, in order.
///
/// # Errors
/// As [`build`].
pub fn build_all(tables: &[toml::Table]) -> Result<Vec<Box<dyn Effect>>> {
    tables.iter().enumerate().map(|(i, table)| build(table).map_err(|e| e.at(format!("effect {}", i + 1)))).collect()
}

/// Builds `tables` and edits `profile` by them, in order.
///
/// # Errors
/// As [`build`].
pub fn apply(tables: &[toml::Table], profile: &mut Profile, situation: &Situation) -> Result<()> {
    for effect in build_all(tables)? {
        effect.edit(profile, situation);
    }
    Ok(())
}

/// Checks that `tables` name sensors and components of `array` only and that each has something to act on.
///
/// # Errors
/// As [`build`], when a name is unknown, and when an effect would change nothing whatever its strength.
pub fn check(tables: &[toml::Table], array: &Array) -> Result<()> {
    let mut profile = array.profile.clone();
    let sensors: Vec<&str> = array.sensors().collect();
    let components: Vec<&str> = array.components.iter().map(String::as_str).collect();
    for (i, effect) in build_all(tables)?.iter().enumerate() {
        let known = |what: &str, names: &[&str], name: &str| {
            if names.contains(&name) {
                return Ok(());
            }
            let error = Error::new(format!("there is no {what} `{name}`")).hint(registry::known(names, name));
            Err(error.usage().at(format!("effect {}", i + 1)))
        };
        effect.sensors().into_iter().try_for_each(|name| known("sensor", &sensors, name))?;
        effect.component().map_or(Ok(()), |name| known("component", &components, name))?;
        if let Some(why) = effect.refusal(&profile) {
            let kind = tables[i].get("kind").and_then(toml::Value::as_str).unwrap_or_default();
            let error = Error::new(format!("`{kind}` has nothing to act on: {why}")).hint("take it out");
            return Err(error.usage().at(format!("effect {}", i + 1)));
        }
        effect.edit(&mut profile, &Situation::default());
    }
    Ok(())
}

/// Which layers of `profile` the effects of `tables` stop short of, in sentences.
pub fn left_alone(tables: &[toml::Table], profile: &Profile) -> Vec<String> {
    let of = |table: &toml::Table| {
        let kind = table.get("kind")?.as_str()?;
        Some(format!("`{kind}`: {}.", build(table).ok()?.laws()?.left_alone(profile)?))
    };
    tables.iter().filter_map(of).collect()
}

/// `tables` without those that have nothing to act on in `profile`: what a diagnosis recalibrates is asked of every column.
///
/// # Errors
/// As [`build`].
pub fn acting(tables: &[toml::Table], profile: &Profile) -> Result<Vec<toml::Table>> {
    let mut profile = profile.clone();
    let mut kept = Vec::with_capacity(tables.len());
    for (table, effect) in tables.iter().zip(build_all(tables)?) {
        if effect.refusal(&profile).is_none() {
            effect.edit(&mut profile, &Situation::default());
            kept.push(table.clone());
        }
    }
    Ok(kept)
}

/// Checks ranges of a table's numbers: (name, value, lowest, highest, unit).
fn ranges(checks: &[(&str, f64, f64, f64, &str)]) -> Result<()> {
    let mut problems = checks
        .iter()
        .filter(|(_, value, low, high, _)| !(value >= low && value <= high))
        .map(|(name, value, low, high, unit)| {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            format!("`{name}` must be in {low}…{high}{unit}, got {value}")
        })
        .peekable();
    if problems.peek().is_none() {
        return Ok(());
    }
    Err(Error::new(problems.collect::<Vec<_>>().join("; ")).usage())
}

fn depth_range(top_m: f64, bottom_m: f64) -> Result<()> {
    if top_m >= 0.0 && bottom_m > top_m {
        return Ok(());
    }
    let what = format!("`bottom_m` must be larger than `top_m` ≥ 0 m, got {top_m}…{bottom_m} m");
    Err(Error::new(what).usage())
}

/// `bottom_m` where a table does not give it: below every base.
fn bottomless() -> f64 {
    1e4
}

#[cfg(test)]
mod tests;
