//! Names, colours and dashes of the record and the models, everywhere the same.

use super::chart;
use super::figure::Key;

/// How a model is drawn and called.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    pub key: &'static str,
    pub name: &'static str,
    pub color: &'static str,
    pub dash: Option<&'static str>,
    pub width: f64,
    /// Whether it is shown until a reader chooses otherwise.
    pub is_shown: bool,
}

impl Model {
    /// What a legend shows for it.
    pub(super) fn key(&self) -> Key<'static> {
        Key { name: self.name, color: self.color, dash: self.dash }
    }
}

const fn model(key: &'static str, name: &'static str, color: &'static str, dash: Option<&'static str>) -> Model {
    Model { key, name, color, dash, width: 1.1, is_shown: false }
}

/// Okabe and Ito's colours, apart in lightness, and dashes for who does not tell colours.
pub(super) const MODELS: [Model; 6] = [
    Model { width: 1.5, is_shown: true, ..model("record", "Record", chart::RECORD, None) },
    Model { is_shown: true, ..model("declared", "FE as declared", chart::FE, Some("5 2")) },
    model("recalibrated", "FE recalibrated", "#b8860b", Some("2 2")),
    Model { is_shown: true, ..model("corrected", "FE corrected", "#009e73", None) },
    model("flare_before", "FLARE-T before", "#56b4e9", Some("5 2")),
    Model { is_shown: true, ..model("flare_after", "FLARE-T after", chart::FLARE_T, None) },
];

/// The model of that key.
pub(super) fn of(key: &str) -> Option<Model> {
    MODELS.into_iter().find(|model| model.key == key)
}

/// The models among `keys`, in their order.
pub(super) fn among<'a>(keys: impl Iterator<Item = &'a str>) -> Vec<Model> {
    let keys: Vec<&str> = keys.collect();
    MODELS.into_iter().filter(|model| keys.contains(&model.key)).collect()
}
