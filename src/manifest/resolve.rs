//! From the sections to what the domain works with: the profile of the column.

use super::{ColumnSections, LayerSection, OutputSection, SiteSection};
use crate::column::{Features, Layer, Profile};
use crate::effects::{self, Array, Effect, Situation};
use crate::error::{Error, Result};

/// Depth of the water table that means a dry column, m.
const DRY_M: f64 = 1e6;

impl SiteSection {
    /// The column of this section, with kind and parameters of each layer's law from `law`.
    ///
    /// # Errors
    /// Those of `law`.
    pub(super) fn column(&self, law: impl Fn(&LayerSection) -> Result<(String, toml::Table)>) -> Result<Profile> {
        let layers = self.layer.iter().map(|layer| {
            let (law_kind, law) = law(layer)?;
            Ok(Layer {
                thickness_m: layer.thickness_m,
                density_kg_m3: layer.density_kg_m3,
                vs_m_s: layer.vs_m_s,
                k0: layer.k0,
                fineness: layer.fineness,
                law_kind,
                law: law.into(),
            })
        });
        Ok(Profile {
            layers: layers.collect::<Result<_>>()?,
            water_table_m: self.water_table_m.unwrap_or(DRY_M),
            vertical: self.vertical,
            rayleigh: self.rayleigh,
            elements: self.elements,
            features: Features::default(),
        })
    }
}

impl ColumnSections {
    /// Law kind and parameters of `layer`: the table under `[law]` with the layer's own keys laid over it.
    ///
    /// # Errors
    /// When there is no such law or it has no `kind`.
    pub fn layer_law(&self, layer: &LayerSection) -> Result<(String, toml::Table)> {
        let missing = || Error::new(format!("there is no `[law.{}]` with a `kind`", layer.law)).usage();
        let mut table = self.law.get(&layer.law).ok_or_else(missing)?.clone();
        let kind = match table.remove("kind") {
            Some(toml::Value::String(kind)) => kind,
            _ => return Err(missing()),
        };
        table.extend(layer.parameters.clone());
        Ok((kind, table))
    }

    /// The column as declared, without `[[effects]]`.
    ///
    /// # Errors
    /// When a layer names an unknown law.
    pub fn declared_profile(&self) -> Result<Profile> {
        self.site.column(|layer| self.layer_law(layer))
    }

    /// The column with the manifest's `[[effects]]` applied, for motions that belong to no record.
    ///
    /// # Errors
    /// When a layer or an effect cannot be built.
    pub fn profile(&self) -> Result<Profile> {
        self.profile_for(&Situation::default())
    }

    /// The column with the manifest's `[[effects]]` applied, in the given component and event.
    ///
    /// # Errors
    /// When a layer or an effect cannot be built.
    pub fn profile_for(&self, situation: &Situation) -> Result<Profile> {
        let mut profile = self.declared_profile()?;
        effects::apply(&self.effects, &mut profile, situation)?;
        Ok(profile)
    }

    /// Depths at which the output sensors really sit under `effects`, m.
    pub fn sensor_depths_m(&self, effects: &[Box<dyn Effect>]) -> Vec<f64> {
        let real = |s: &OutputSection| effects::depth_m(effects, &s.name, s.depth_m, self.site.depth_m);
        self.sensors.output.iter().map(real).collect()
    }

    /// The array on the declared column, with horizontal `components`.
    ///
    /// # Errors
    /// When a layer names an unknown law.
    pub fn array(&self, components: &[String]) -> Result<Array> {
        Ok(Array {
            profile: self.declared_profile()?,
            input: self.sensors.input.clone(),
            outputs: self.sensors.names(),
            depths_m: self.sensors.depths_m(),
            components: components.to_vec(),
        })
    }
}
