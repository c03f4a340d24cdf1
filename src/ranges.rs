//! Ranges of values in a manifest: one list for what is checked and for what its JSON Schema says.

use schemars::JsonSchema;
use serde_json::{Value as Json, json};

/// The range of one value of `T`, or of every value of a list.
pub struct Range<T> {
    /// Its key, dotted where it is in a table of its own.
    pub key: &'static str,
    /// Its unit; empty where it has none.
    pub unit: &'static str,
    /// Smallest and largest value.
    pub ends: [f64; 2],
    /// Whether it is of every value of a list.
    pub is_list: bool,
    /// The values of that key.
    pub values: fn(&T) -> Vec<f64>,
}

/// A [`Range`] of a field: `range!(step_s, "s", 1e-4, 10.0)`, and with `each` that of the values of a list.
macro_rules! range {
    (each $($part:ident).+, $unit:literal, $low:expr, $high:expr) => {
        $crate::ranges::Range {
            key: $crate::ranges::joined!($($part).+),
            unit: $unit,
            ends: [$low, $high],
            is_list: true,
            values: |of| of.$($part).+.iter().map(|value| *value as f64).collect(),
        }
    };
    ($($part:ident).+, $unit:literal, $low:expr, $high:expr) => {
        $crate::ranges::Range {
            key: $crate::ranges::joined!($($part).+),
            unit: $unit,
            ends: [$low, $high],
            is_list: false,
            values: |of| vec![of.$($part).+ as f64],
        }
    };
}

/// A dotted key.
macro_rules! joined {
    ($first:ident $(. $rest:ident)*) => { concat!(stringify!($first) $(, ".", stringify!($rest))*) };
}

pub(crate) use {joined, range};

/// Settings whose values have ranges.
pub trait Ranged: JsonSchema + Sized + 'static {
    /// The ranges of those that do not hang on others.
    const RANGES: &'static [Range<Self>];

    /// What is beyond its range, as (key, sentence).
    fn beyond(&self) -> Vec<(String, String)> {
        let of = |range: &Range<Self>| {
            let beyond = |(i, value): (usize, f64)| {
                let place = if range.is_list { format!("[{}]", i + 1) } else { String::new() };
                problem(&format!("{}{place}", range.key), range.ends, range.unit, value)
            };
            (range.values)(self).into_iter().enumerate().filter_map(beyond).collect::<Vec<_>>()
        };
        Self::RANGES.iter().flat_map(of).collect()
    }
}

/// The value of `key` beyond `ends`, as (key, sentence); none for one within.
pub fn problem(key: &str, ends: [f64; 2], unit: &str, value: f64) -> Option<(String, String)> {
    outside(ends, unit, value).map(|what| (key.to_string(), format!("must be {what}")))
}

/// What a number beyond `ends` must be, in words with its unit; none for one within.
pub fn outside([low, high]: [f64; 2], unit: &str, value: f64) -> Option<String> {
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let range = match (low.is_finite(), high.is_finite()) {
        (true, true) => format!("in {low}…{high}{unit}"),
        (true, false) => format!("at least {low}{unit}"),
        (false, true) => format!("at most {high}{unit}"),
        (false, false) => format!("a number{unit}"),
    };
    (!(low..=high).contains(&value)).then(|| format!("{range}, got {value}"))
}

/// Ends and unit that the schema of a number has; infinite where it has no such end.
pub fn of_schema(schema: &Json) -> ([f64; 2], &str) {
    let end = |key: &str, none: f64| schema.get(key).and_then(Json::as_f64).unwrap_or(none);
    let unit = schema.get(UNIT).and_then(Json::as_str).unwrap_or_default();
    ([end("minimum", f64::NEG_INFINITY), end("maximum", f64::INFINITY)], unit)
}

/// Key of the unit in a schema.
pub const UNIT: &str = "x-unit";

/// Writes the ranges of `T` into the definition called `name` of a `schema`.
///
/// # Panics
/// When the schema has no such definition, or `T` a range of a key that it does not have.
pub fn describe<T: Ranged>(schema: &mut Json, name: &str) {
    for range in T::RANGES {
        let mut definition = name.to_string();
        let mut parts = range.key.split('.').peekable();
        while let Some(part) = parts.next() {
            let place = format!("/$defs/{definition}/properties/{part}");
            let property = schema.pointer_mut(&place).unwrap_or_else(|| panic!("the schema has `{place}`"));
            if parts.peek().is_none() {
                let value = if property.get("items").is_some() { &mut property["items"] } else { property };
                limit(value, range.ends, range.unit);
            } else if let Some(inner) = property["$ref"].as_str().and_then(|r| r.rsplit('/').next()) {
                definition = inner.to_string();
            }
        }
    }
}

/// Writes a range into the schema of a number.
fn limit(value: &mut Json, [low, high]: [f64; 2], unit: &str) {
    let is_whole = value["type"] == "integer";
    let number = |end: f64| if is_whole { json!(end as i64) } else { json!(end) };
    for (key, end) in [("minimum", low), ("maximum", high)] {
        if end.is_finite() {
            value[key] = number(end);
        }
    }
    if !unit.is_empty() {
        value[UNIT] = unit.into();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Serialize;

    #[derive(JsonSchema, Serialize)]
    struct Outer {
        step_s: f64,
        inner: Inner,
    }

    #[derive(JsonSchema, Serialize)]
    struct Inner {
        widths: Vec<usize>,
    }

    impl Ranged for Outer {
        const RANGES: &'static [Range<Self>] =
            &[range!(step_s, "s", 0.1, 2.0), range!(each inner.widths, "", 1.0, 9.0)];
    }

    #[test]
    fn what_is_checked_is_what_the_schema_says() {
        let of = |step_s: f64, widths: &[usize]| Outer { step_s, inner: Inner { widths: widths.to_vec() } }.beyond();
        assert!(of(0.1, &[1, 9]).is_empty());
        let texts: Vec<String> =
            of(f64::NAN, &[3, 10]).into_iter().map(|(key, what)| format!("{key} {what}")).collect();
        assert_eq!(texts, ["step_s must be in 0.1…2 s, got NaN", "inner.widths[2] must be in 1…9, got 10"]);
        let mut schema = schemars::schema_for!(Vec<Outer>).to_value();
        describe::<Outer>(&mut schema, "Outer");
        assert_eq!(of_schema(&schema["$defs"]["Outer"]["properties"]["step_s"]), ([0.1, 2.0], "s"));
        let widths = &schema["$defs"]["Inner"]["properties"]["widths"]["items"];
        assert_eq!((&widths["minimum"], &widths["maximum"]), (&json!(1), &json!(9)));
    }
}
