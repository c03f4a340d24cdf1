//! What is declared, most probable within its tolerances.

use super::forward::Forward;
use super::parameters::{Declared, Model};
use super::posterior::{Fitter, Start, Stop};
use super::weights::Expected;
use crate::diagnosis::{DiagnoseSettings, Motions, Problem, Replay};
use crate::effects::Instance;
use crate::error::Result;
use std::sync::Arc;
use toml::Table;

/// Most rounds, and the change of the column's level (ln) below which they end.
const ROUNDS: usize = 4;
const STILL: f64 = 0.1;

/// Replays of a column with some effects more.
struct With<'a> {
    effects: &'a [Table],
    replay: &'a dyn Replay,
}

impl With<'_> {
    fn and(&self, effects: &[Table]) -> Vec<Table> {
        self.effects.iter().chain(effects).cloned().collect()
    }
}

impl Replay for With<'_> {
    fn replay(&self, effects: &[Table]) -> Result<Motions> {
        self.replay.replay(&self.and(effects))
    }

    fn replay_roughly(&self, effects: &[Table]) -> Result<Motions> {
        self.replay.replay_roughly(&self.and(effects))
    }

    fn replay_in_halves(&self, effects: &[Table], is_wanted: &[bool]) -> Result<Option<[Motions; 2]>> {
        self.replay.replay_in_halves(&self.and(effects), is_wanted)
    }
}

/// `[[effects]]` of the declared values that are most probable beside `known` effects on top of what is declared.
///
/// # Errors
/// When an event is unusable, the column cannot be built or replayed.
pub fn recalibrate(
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    known: &[Table],
) -> Result<Vec<Table>> {
    let mut problem = problem.clone();
    problem.declared.extend_from_slice(known);
    let replay = With { effects: known, replay };
    let forward = Forward::new(&problem, &replay, settings)?;
    let declared = Declared::new(&problem)?;
    forward.anchor(&[])?;
    let (_, (model, x)) = recalibrated(&forward, &declared, Vec::new())?;
    Ok(model.declared.tables(&x))
}

/// What is declared, most probable within its tolerances beside `effects` without a strength: what the records say of the field and of the
/// column's error is read off beside it, until that stands still.
pub(super) fn recalibrated<'a>(
    forward: &'a Forward<'a>,
    declared: &'a Declared,
    effects: Vec<Instance>,
) -> Result<(Expected, (Model<'a>, Vec<f64>))> {
    let model = Model { declared, effects };
    let mut x = vec![0.0; model.len()];
    let mut expected = Expected::of(forward, Arc::new(forward.predict(&model.tables(&x))?));
    for round in 0..ROUNDS {
        let fitter = Fitter::new(forward, expected.clone());
        let start = Start::at(model.clone(), x);
        let fit =
            if round == 0 { fitter.fit_from_afar(start, Stop::CLOSE)? } else { fitter.fit(start, Stop::CLOSE)? };
        let found = Expected::of(forward, fit.prediction);
        let is_still = (found.spread.level / expected.spread.level).ln().abs() < STILL;
        (x, expected) = (fit.x, found);
        if is_still {
            break;
        }
    }
    Ok((expected, (model, x)))
}
