//! A profile as a table: thickness or depth, shear-wave velocity and what else is known of each layer.
//!
//! A header names the columns, in any order: `thickness_m`, or `depth_m` of the top of each layer, `vs_m_s`, and, where known,
//! `density_kg_m3`, `damping_ratio` and `plasticity_index`. Without a header the columns are those of PySeismoSoil: thickness (m), Vs (m/s),
//! damping ratio, density (kg/m³), number of the material; a last line of no thickness is the half-space. Lines that start with `#` are
//! comments; commas, semicolons, tabs and spaces separate. A project file of Strata ([`strata`]) is taken as well.

use super::strata;
use crate::error::{Error, Result};
use crate::registry::known;

/// What a table says of one layer.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LayerRow {
    /// Thickness, m.
    pub thickness_m: f64,
    /// Shear-wave velocity, m/s.
    pub vs_m_s: f64,
    /// Density, kg/m³.
    pub density_kg_m3: Option<f64>,
    /// Small-strain damping ratio.
    pub damping_ratio: Option<f64>,
    /// Plasticity index, %.
    pub plasticity_index: Option<f64>,
}

impl LayerRow {
    /// Stiff soil of no thickness, where nothing is known.
    pub const GUESS: Self =
        Self { thickness_m: 0.0, vs_m_s: 300.0, density_kg_m3: None, damping_ratio: None, plasticity_index: None };
}

const COLUMNS: [&str; 6] = ["thickness_m", "depth_m", "vs_m_s", "density_kg_m3", "damping_ratio", "plasticity_index"];
/// Columns without a header.
const PLAIN: [&str; 4] = ["thickness_m", "vs_m_s", "damping_ratio", "density_kg_m3"];
/// Densities below this are in g/cm³.
const LEAST_KG_M3: f64 = 10.0;
/// Damping ratios above this are in percent.
const LARGEST_RATIO: f64 = 0.5;

/// Layers from the surface down; with tops of layers the last one reaches down to `base_m`, and nothing is kept below that.
///
/// # Errors
/// When a column is not known, a value is no number, or a layer has no thickness; the line is named.
pub fn layers(text: &str, base_m: Option<f64>) -> Result<Vec<LayerRow>> {
    if strata::is_project(text) {
        return cut(strata::project(text)?.layers, base_m);
    }
    let rows: Vec<(usize, Vec<&str>)> = text
        .trim_start_matches('\u{feff}')
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'))
        .map(|(i, line)| (i + 1, cells(line)))
        .collect();
    let Some((_, first)) = rows.first() else {
        return Err(Error::new("the profile is empty")
            .hint("one line a layer, under the header `thickness_m,vs_m_s,density_kg_m3`"));
    };
    let is_plain = first.iter().all(|cell| cell.parse::<f64>().is_ok());
    let (names, rows) = if is_plain { (PLAIN.to_vec(), &rows[..]) } else { (first.clone(), &rows[1..]) };
    if let Some(name) = names.iter().find(|name| !COLUMNS.contains(name)) {
        return Err(Error::new(format!("unknown column `{name}` of a profile")).hint(known(&COLUMNS, name)));
    }
    let mut all = Vec::new();
    for (line, cells) in rows {
        let value = |name: &str| -> Result<Option<f64>> {
            let Some(cell) = names.iter().position(|n| *n == name).and_then(|i| cells.get(i)) else { return Ok(None) };
            let number = cell.parse().ok().filter(|v: &f64| v.is_finite() && *v >= 0.0);
            let wrong = || Error::new(format!("`{name}` is `{cell}` on line {line}, a number of at least 0 is needed"));
            number.ok_or_else(wrong).map(Some)
        };
        let needed = |name: &str| {
            let missing = || Error::new(format!("line {line} has no `{name}`")).hint("every layer needs it");
            value(name)?.filter(|v| *v > 0.0).ok_or_else(missing)
        };
        let in_si = |v: f64| if v < LEAST_KG_M3 { 1000.0 * v } else { v };
        all.push(Row {
            line: *line,
            top_m: value("depth_m")?,
            layer: LayerRow {
                thickness_m: value("thickness_m")?.unwrap_or(0.0),
                vs_m_s: needed("vs_m_s")?,
                density_kg_m3: value("density_kg_m3")?.map(in_si),
                damping_ratio: value("damping_ratio")?,
                plasticity_index: value("plasticity_index")?,
            },
        });
    }
    // A column is in percent as a whole: 0.4 beside 2.0 is 0.4 %.
    let is_percent = all.iter().any(|row| row.layer.damping_ratio.is_some_and(|ratio| ratio > LARGEST_RATIO));
    let beyond = |row: &&Row| row.layer.damping_ratio.is_some_and(|percent| percent > 100.0 * LARGEST_RATIO);
    if let Some(row) = all.iter().find(beyond) {
        let what = format!("`damping_ratio` is {} on line {}", row.layer.damping_ratio.unwrap_or_default(), row.line);
        let hint = "a ratio of up to 0.5 or up to 50 % is possible; without a header the columns are thickness, Vs, damping ratio, density";
        return Err(Error::new(what).hint(hint));
    }
    if is_percent {
        all.iter_mut().filter_map(|row| row.layer.damping_ratio.as_mut()).for_each(|ratio| *ratio *= 0.01);
    }
    let has_tops = names.contains(&"depth_m") && !names.contains(&"thickness_m");
    if has_tops {
        thicken(&mut all, base_m)?;
    } else if all.last().is_some_and(|row| row.layer.thickness_m == 0.0) {
        all.pop();
    }
    if let Some(row) = all.iter().find(|row| row.layer.thickness_m <= 0.0) {
        let hint = "every layer but a half-space at the end needs a `thickness_m` above 0, or `depth_m` of its top";
        return Err(Error::new(format!("the layer on line {} has no thickness", row.line)).hint(hint));
    }
    cut(all.into_iter().map(|row| row.layer).collect(), base_m)
}

struct Row {
    line: usize,
    top_m: Option<f64>,
    layer: LayerRow,
}

fn cells(line: &str) -> Vec<&str> {
    let separator = [',', ';', '\t'].into_iter().find(|c| line.contains(*c));
    match separator {
        Some(c) => line.split(c).map(|cell| cell.trim().trim_matches('"')).collect(),
        None => line.split_whitespace().collect(),
    }
}

/// Thicknesses from the tops of layers.
fn thicken(rows: &mut Vec<Row>, base_m: Option<f64>) -> Result<()> {
    let tops: Vec<f64> = rows.iter().map(|row| row.top_m.unwrap_or(0.0)).collect();
    if let Some(i) = (1..tops.len()).find(|i| tops[*i] <= tops[i - 1]) {
        return Err(Error::new(format!(
            "`depth_m` falls from {} to {} m on line {}",
            tops[i - 1],
            tops[i],
            rows[i].line
        ))
        .hint("`depth_m` is the depth of the top of each layer, from the surface down"));
    }
    if tops.first().is_some_and(|top| *top != 0.0) {
        return Err(Error::new(format!("the first layer begins at {} m", tops[0]))
            .hint("`depth_m` is of the top of each layer: 0 for the first"));
    }
    let last = tops.last().copied().unwrap_or(0.0);
    match base_m {
        Some(base_m) if base_m > last => {}
        // The last line is the half-space.
        _ => _ = rows.pop(),
    }
    let ends = tops.iter().skip(1).copied().chain(base_m);
    rows.iter_mut().zip(tops.iter().zip(ends)).for_each(|(row, (top, end))| row.layer.thickness_m = end - top);
    Ok(())
}

/// The layers above `base_m`.
fn cut(layers: Vec<LayerRow>, base_m: Option<f64>) -> Result<Vec<LayerRow>> {
    let Some(base_m) = base_m else { return Ok(layers) };
    let total: f64 = layers.iter().map(|l| l.thickness_m).sum();
    if total < base_m - 1e-6 {
        return Err(Error::new(format!("the layers end at {total} m, above the deepest sensor at {base_m} m"))
            .hint("add the layers down to the deepest sensor, which is the base of the column"));
    }
    let mut top_m = 0.0;
    let mut kept = Vec::new();
    for mut layer in layers {
        let end_m = top_m + layer.thickness_m;
        if top_m < base_m - 1e-6 {
            layer.thickness_m = end_m.min(base_m) - top_m;
            kept.push(layer);
        }
        top_m = end_m;
    }
    Ok(kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thicknesses(text: &str, base_m: Option<f64>) -> Vec<f64> {
        layers(text, base_m).unwrap().iter().map(|l| (l.thickness_m * 1e9).round() / 1e9).collect()
    }

    #[test]
    fn tables_of_every_form_give_the_same_layers() {
        let named = "# a comment\nthickness_m,vs_m_s,density_kg_m3\n4,130,1900\n6,180,1950\n";
        let tops = "depth_m;vs_m_s;density_kg_m3\n0;130;1900\n4;180;1950\n10;400;2100\n";
        let plain = "4 130 2.0 1.9 1\n6 180 0.4 1.95 1\n0 400 1.0 2.1 0\n";
        for text in [named, tops, plain] {
            let found = layers(text, None).unwrap();
            assert_eq!(thicknesses(text, None), [4.0, 6.0], "{text}");
            assert_eq!(found.iter().map(|l| l.vs_m_s).collect::<Vec<_>>(), [130.0, 180.0]);
            assert_eq!(found[1].density_kg_m3, Some(1950.0));
        }
        let ratios = layers(plain, None).unwrap().iter().map(|l| l.damping_ratio.unwrap()).collect::<Vec<_>>();
        assert_eq!(ratios, [0.02, 0.004]);
        assert_eq!(thicknesses(named, Some(7.5)), [4.0, 3.5]);
        assert_eq!(thicknesses(tops, Some(12.0)), [4.0, 6.0, 2.0]);
    }

    #[test]
    fn what_is_wrong_with_a_table_is_named() {
        for (text, base_m, part) in [
            ("", None, "is empty"),
            ("thickness_m,vs\n4,130\n", None, "unknown column `vs`"),
            ("thickness_m,vs_m_s\n4,fast\n", None, "`vs_m_s` is `fast` on line 2"),
            ("thickness_m,density_kg_m3\n4,1900\n", None, "line 2 has no `vs_m_s`"),
            ("4,130,1900\n6,180,1950\n", None, "`damping_ratio` is 1900 on line 1"),
            ("thickness_m,vs_m_s\n0,100\n4,130\n", None, "the layer on line 2 has no thickness"),
            ("depth_m,vs_m_s\n0,130\n5,150\n4,180\n", None, "falls from 5 to 4 m on line 4"),
            ("depth_m,vs_m_s\n4,130\n5,150\n", None, "the first layer begins at 4 m"),
            ("thickness_m,vs_m_s\n4,130\n", Some(17.0), "end at 4 m, above the deepest sensor at 17 m"),
        ] {
            let message = layers(text, base_m).unwrap_err().to_string();
            assert!(message.contains(part), "`{part}` in {message}");
        }
    }
}
