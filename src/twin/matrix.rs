//! Many twins of one array: truths drawn at random over effect, place, size, tolerances and noise.

use super::foreign::{Foreign, drawn};
use super::{Truth, draw};
use crate::effects::{self, Array, Instance, Tolerances};
use crate::error::{Context, Error, Result};
use crate::numerics::random;
use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;
use toml::Table;

/// A matrix file: what is drawn, cell by cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Matrix {
    /// A sentence about this matrix.
    #[serde(default)]
    pub about: String,
    /// Truth file, relative to this one, whose events, mesh and time step every twin takes; its own effects play no part.
    pub truth: String,
    /// Range of the noise, as a share of each channel's RMS.
    #[serde(default = "default_noise")]
    pub noise_rms_share: [f64; 2],
    /// What the truths of foreign cells are drawn from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub foreign: Option<Foreign>,
    /// Cells.
    pub cell: Vec<Cell>,
}

fn default_noise() -> [f64; 2] {
    [0.02, 0.04]
}

/// Twins of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Name, for the tables.
    pub name: String,
    /// Twins.
    pub count: usize,
    /// Effects of the catalogue in each twin, of different kinds.
    #[serde(default)]
    pub effects: usize,
    /// Kinds to draw from; all that fit the array, if not given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub kinds: Vec<String>,
    /// Whether the truth is drawn from `[foreign]`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub foreign: bool,
    /// Tables of `[[outside]]`, one to a twin in turn: what no effect of the catalogue describes. `[a, b]` is drawn evenly.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(with = "Vec<serde_json::Map<String, serde_json::Value>>")]
    pub outside: Vec<Table>,
}

/// One twin to be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Its cell.
    pub cell: String,
    /// Number within the cell, from 1.
    pub number: usize,
    /// Whether its truth was drawn from `[foreign]`: then the declared law is not that of the truth.
    pub is_foreign: bool,
    /// What holds.
    pub truth: Truth,
}

impl Matrix {
    /// Reads a matrix file, and the truth file it starts from.
    ///
    /// # Errors
    /// When either cannot be read or holds something else.
    pub fn load(path: &Path) -> Result<(Self, Truth)> {
        let place = || format!("`{}`", path.display());
        let text =
            std::fs::read_to_string(path).context(|| format!("cannot read {}", place())).map_err(Error::usage)?;
        let matrix: Self =
            toml::from_str(&text).map_err(|e| Error::new(e.to_string().trim().to_string()).at(place()).usage())?;
        if let Some(cell) = matrix.cell.iter().find(|c| c.count == 0 || c.effects > 3) {
            let what = "`count` must be at least 1 and `effects` at most 3";
            return Err(Error::new(what).at(format!("cell `{}`", cell.name)).at(place()).usage());
        }
        let truth = Truth::load(&path.parent().unwrap_or(Path::new(".")).join(&matrix.truth))?;
        matrix.check(&truth).map_err(|e| e.at(place()).usage())?;
        Ok((matrix, truth))
    }

    /// Refuses foreign cells without `[foreign]`, and ends of ranges that no truth may have.
    fn check(&self, truth: &Truth) -> Result<()> {
        if let Some(cell) = self.cell.iter().find(|c| c.foreign && self.foreign.is_none()) {
            let what = "`foreign = true` needs a section `[foreign]` to draw from";
            return Err(Error::new(what).at(format!("cell `{}`", cell.name)));
        }
        for extreme in self.foreign.iter().flat_map(|foreign| foreign.extremes(truth)) {
            extreme.check().map_err(|e| e.at("`[foreign]`"))?;
        }
        Ok(())
    }

    /// All twins under `seed`, each with draws of its own that no other twin changes.
    ///
    /// # Errors
    /// When a kind is unknown or none fits the array.
    pub fn cases(&self, truth: &Truth, array: &Array, seed: u64) -> Result<Vec<Case>> {
        let mut cases = Vec::new();
        for cell in &self.cell {
            let foreign = self.foreign.as_ref().filter(|_| cell.foreign);
            let own = foreign.map(|foreign| foreign.array(array));
            let kinds =
                cell.fitting(own.as_ref().unwrap_or(array)).map_err(|e| e.at(format!("cell `{}`", cell.name)))?;
            for number in 1..=cell.count {
                let mut random = random::stream(seed, &format!("twin {} {number}", cell.name));
                let mut truth = Truth {
                    // A TOML integer has 63 bits.
                    seed: random.random::<u64>() >> 1,
                    noise: self.noise(&mut random),
                    effects: cell.draw(&kinds, number, &mut random),
                    ..truth.clone()
                };
                let outside = cell.outside.get((number - 1) % cell.outside.len().max(1));
                truth.outside = outside.map(|table| drawn(table, &mut random)).into_iter().collect();
                if let Some(foreign) = foreign {
                    truth = foreign.of(&truth, &mut random);
                }
                cases.push(Case { cell: cell.name.clone(), number, is_foreign: cell.foreign, truth });
            }
        }
        Ok(cases)
    }

    fn noise(&self, random: &mut impl Rng) -> crate::records::Noise {
        let [low, high] = self.noise_rms_share;
        crate::records::Noise { rms_share: low + (high - low) * random.random::<f64>(), ..Default::default() }
    }
}

impl Cell {
    /// The places of each kind to draw from.
    fn fitting(&self, array: &Array) -> Result<Vec<Vec<Instance>>> {
        if self.effects == 0 {
            return Ok(Vec::new());
        }
        for kind in &self.kinds {
            effects::find(kind)?;
        }
        // A field that strays is no candidate: it is drawn where it is asked for.
        let is_wanted = |entry: &effects::Entry| match self.kinds.is_empty() {
            true => entry.catalogue.class != effects::Class::Field,
            false => self.kinds.iter().any(|kind| kind == entry.name),
        };
        let places: Vec<Vec<Instance>> = effects::EFFECTS
            .iter()
            .filter(|entry| is_wanted(entry))
            .map(|entry| (entry.catalogue.instances)(array))
            .filter(|places| !places.is_empty())
            .collect();
        if places.len() < self.effects {
            let what = format!("{} kinds of effects fit the array, {} are asked for", places.len(), self.effects);
            return Err(Error::new(what).usage());
        }
        Ok(places)
    }

    /// Kinds in turn, so that each comes about equally often; further ones, places and sizes at random.
    fn draw(&self, kinds: &[Vec<Instance>], number: usize, random: &mut impl Rng) -> Vec<Table> {
        if kinds.is_empty() {
            return Vec::new();
        }
        let first = (number - 1) % kinds.len();
        let mut others: Vec<usize> = (0..kinds.len()).filter(|k| *k != first).collect();
        others.shuffle(random);
        let chosen = std::iter::once(first).chain(others).take(self.effects);
        chosen.map(|k| kinds[k][random.random_range(0..kinds[k].len())].draw(random)).collect()
    }
}

impl Case {
    /// Everything that moves this twin from the declared model: drawn tolerances, then effects.
    pub fn tables(&self, array: &Array, tolerances: &Tolerances) -> Vec<Table> {
        let mut tables = self.drawn(array, tolerances);
        tables.extend(self.truth.effects.clone());
        tables
    }

    /// The drawn tolerances.
    pub fn drawn(&self, array: &Array, tolerances: &Tolerances) -> Vec<Table> {
        draw(array, tolerances, self.truth.seed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    fn shipped() -> (Matrix, Truth, Array) {
        let configs = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("configs");
        let (matrix, truth) = Matrix::load(&configs.join("matrix/smoke.toml")).expect("a sound matrix");
        let site = crate::manifest::Manifest::load(&configs.join("smoke.toml"), &[]).expect("a sound site").site;
        let array = site.column().array(&["EW".to_string(), "NS".to_string()]).expect("an array");
        (matrix, truth, array)
    }

    #[test]
    fn every_twin_has_draws_of_its_own_that_a_longer_matrix_keeps() {
        let (matrix, truth, array) = shipped();
        let cases = matrix.cases(&truth, &array, 1).expect("cases");
        assert_eq!(cases.len(), matrix.cell.iter().map(|c| c.count).sum::<usize>());
        assert_eq!(cases, matrix.cases(&truth, &array, 1).expect("cases"));
        let mut longer = matrix.clone();
        longer.cell[0].count += 5;
        let again = longer.cases(&truth, &array, 1).expect("cases");
        assert!(cases.iter().all(|case| again.contains(case)));
        let other = matrix.cases(&truth, &array, 2).expect("cases");
        assert!(cases.iter().zip(&other).all(|(a, b)| a.truth.seed != b.truth.seed));
    }

    #[test]
    fn a_cell_says_how_many_effects_its_twins_lack_and_of_what_kind() {
        let (mut matrix, truth, array) = shipped();
        matrix.cell[0].kinds = vec!["sensor_gain".into(), "thin_seam".into()];
        for case in matrix.cases(&truth, &array, 3).expect("cases") {
            let kinds: Vec<&str> = case.truth.effects.iter().filter_map(|t| t["kind"].as_str()).collect();
            let expected = matrix.cell.iter().find(|c| c.name == case.cell).expect("its cell");
            assert_eq!(kinds.len(), expected.effects, "{kinds:?}");
            assert!(kinds.len() < 2 || kinds[0] != kinds[1], "{kinds:?}");
            assert!(case.cell != "single" || kinds[0] == "sensor_gain" || kinds[0] == "thin_seam");
            assert_eq!(case.truth.outside.len(), usize::from(!expected.outside.is_empty()));
            effects::build_all(&case.truth.effects).expect("draws are within their ranges");
        }
        let foreign = |case: &Case| matrix.cell.iter().find(|c| c.name == case.cell).is_some_and(|c| c.foreign);
        for case in matrix.cases(&truth, &array, 3).expect("cases") {
            assert_eq!(case.truth.damping.is_some(), foreign(&case));
            assert_eq!(case.truth.processing.low_pass_hz, foreign(&case).then_some(20.0));
            case.truth.check().expect("draws are within their ranges");
        }
        // A power of the frequency needs damping that laws remember, which foreign truths do not have.
        let all = (0..20).flat_map(|seed| matrix.cases(&truth, &array, seed).expect("cases"));
        let mut powers = [0, 0];
        for case in all {
            let is_power = |t: &Table| t.contains_key("exponent") && t["kind"].as_str() != Some("pore_pressure");
            powers[usize::from(foreign(&case))] += case.truth.effects.iter().filter(|t| is_power(t)).count();
        }
        assert!(powers[0] > 0 && powers[1] == 0, "{powers:?}");
        matrix.cell[0].kinds = vec!["sensor_gains".into()];
        let error = matrix.cases(&truth, &array, 3).expect_err("no such kind");
        assert!(error.hint_text().is_some_and(|hint| hint.contains("nearest: `sensor_gain`")));
    }

    #[test]
    fn foreign_cells_need_something_to_draw_from_and_ranges_that_a_truth_may_have() {
        let configs = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("configs");
        let text = std::fs::read_to_string(configs.join("matrix/smoke.toml")).expect("there");
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::create_dir_all(folder.path().join("matrix")).expect("made");
        std::fs::create_dir_all(folder.path().join("truth")).expect("made");
        std::fs::copy(configs.join("truth/smoke.toml"), folder.path().join("truth/smoke.toml")).expect("copied");
        let says = |text: &str| {
            let path = folder.path().join("matrix/m.toml");
            std::fs::write(&path, text).expect("written");
            Matrix::load(&path).map(|_| ()).map_err(|e| format!("{e:#}"))
        };
        assert_eq!(says(&text), Ok(()));
        let none = text.replace("[foreign]", "[cell_foreign]").replace("[foreign.", "[cell_foreign.");
        assert!(says(&none).is_err());
        let wide = text.replace("ratio = [0.009, 0.014]", "ratio = [-0.1, 0.9]");
        assert!(says(&wide).unwrap_err().contains("`damping.ratio` must be in 0…0.3"), "{:?}", says(&wide));
        let corner = text.replace("low_pass_hz = 20.0", "low_pass_hz = 400.0");
        assert!(says(&corner).unwrap_err().contains("1…45 Hz, got 400"), "{:?}", says(&corner));
        let cell = "truth = \"../truth/smoke.toml\"\n[[cell]]\nname = 'a'\ncount = 1\nforeign = true\n";
        assert!(says(cell).unwrap_err().contains("needs a section `[foreign]`"), "{:?}", says(cell));
    }
}
