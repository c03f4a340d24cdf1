//! The profile in a project file of Strata (JSON, metric units).
//!
//! Layers are `siteProfile.soilLayers` with `thickness` (m), `avg` (Vs, m/s) and the number of their soil in `soilTypeCatalog` or `soilTypes`:
//! `untWt` (kN/m³), `damping` (%), `pi` (%). Modulus and damping curves are not taken over.

use super::table::LayerRow;
use crate::error::{Error, Result};
use crate::units::G_M_S2;
use serde_json::Value;

/// Layers and depth of the water table, m.
#[derive(Debug, Clone, PartialEq)]
pub struct Project {
    /// Layers from the surface down, the half-space not among them.
    pub layers: Vec<LayerRow>,
    /// Depth of the water table, m, where it is below the surface.
    pub water_table_m: Option<f64>,
}

/// Whether `text` is a project file and no table.
pub fn is_project(text: &str) -> bool {
    text.trim_start_matches('\u{feff}').trim_start().starts_with('{')
}

/// The profile in a project file.
///
/// # Errors
/// When it is no JSON, is in English units, or lacks a thickness or velocity.
pub fn project(text: &str) -> Result<Project> {
    let unsound = |e| Error::new("the profile is no JSON").cause(e).hint("save the project of Strata again, as JSON");
    let json: Value = serde_json::from_str(text.trim_start_matches('\u{feff}')).map_err(unsound)?;
    if json["system"].as_i64().unwrap_or(0) != 0 {
        return Err(Error::new("the project is in English units").hint("switch Strata to metric units and save again"));
    }
    let profile = &json["siteProfile"];
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let soils = [list(&profile["soilTypeCatalog"]), list(&profile["soilTypes"])].concat();
    let layers = list(&profile["soilLayers"]);
    if layers.is_empty() {
        return Err(
            Error::new("the project has no `siteProfile.soilLayers`").hint("give Strata a profile and save again")
        );
    }
    let layer = |(i, layer): (usize, &Value)| -> Result<LayerRow> {
        let number = |key: &str| {
            let value = layer[key].as_f64().filter(|v| v.is_finite() && *v > 0.0);
            value.ok_or_else(|| Error::new(format!("`siteProfile.soilLayers[{}].{key}` must be above 0", i + 1)))
        };
        let soil = layer["soilType"].as_u64().and_then(|row| soils.get(row as usize)).unwrap_or(&Value::Null);
        let of_soil = |key: &str| soil[key].as_f64().filter(|v| v.is_finite() && *v > 0.0);
        Ok(LayerRow {
            thickness_m: number("thickness")?,
            vs_m_s: number("avg")?,
            density_kg_m3: of_soil("untWt").map(|kn_m3| kn_m3 * 1000.0 / G_M_S2),
            damping_ratio: of_soil("damping").map(|percent| 0.01 * percent),
            plasticity_index: of_soil("pi"),
        })
    };
    Ok(Project {
        layers: layers.iter().enumerate().map(layer).collect::<Result<_>>()?,
        water_table_m: profile["waterTableDepth"].as_f64().filter(|depth_m| depth_m.is_finite() && *depth_m > 0.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn layers_soils_and_water_are_taken_over() {
        let soil = json!({ "name": "sand", "untWt": 18.6326, "damping": 1.5, "pi": 12.0 });
        let layers = json!([
            { "soilType": 0, "thickness": 4.0, "avg": 180.0, "depth": 0.0 },
            { "soilType": -1, "thickness": 6.0, "avg": 260.0, "depth": 4.0 },
        ]);
        for catalog in ["soilTypeCatalog", "soilTypes"] {
            let text = json!({ "system": 0, "siteProfile": { catalog: [soil], "soilLayers": layers, "waterTableDepth": 2.5 } });
            let found = project(&text.to_string()).unwrap();
            assert_eq!(found.water_table_m, Some(2.5));
            assert!((found.layers[0].density_kg_m3.unwrap() - 1900.0).abs() < 0.01);
            assert_eq!((found.layers[0].damping_ratio, found.layers[0].plasticity_index), (Some(0.015), Some(12.0)));
            assert_eq!((found.layers[1].vs_m_s, found.layers[1].density_kg_m3), (260.0, None));
        }
        let text = |profile: Value, system: i64| json!({ "system": system, "siteProfile": profile }).to_string();
        let thin = json!({ "soilLayers": [{ "soilType": 0, "thickness": 0.0, "avg": 180.0 }] });
        for (text, part) in [
            ("{".into(), "is no JSON"),
            (text(json!({}), 0), "no `siteProfile.soilLayers`"),
            (text(json!({ "soilLayers": layers }), 1), "English units"),
            (text(thin, 0), "`siteProfile.soilLayers[1].thickness` must be above 0"),
        ] {
            let message = project(&text).unwrap_err().to_string();
            assert!(message.contains(part), "`{part}` in {message}");
        }
    }
}
