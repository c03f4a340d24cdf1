//! Motions of one column side by side, each in a lane with its own increments. A lane that has finished its motion takes the next one.
//! What comes of a motion does not depend on the others, nor on the number of lanes: it is that of the column shaken by it alone.

mod stepper;

use super::run::{BaseMotion, Clock, Due, Frame, Frames, Input, RunSummary};
use super::{Column, Failure};
use crate::error::Result;
use crate::numerics::lanes::Width;
use stepper::{Outcome, Stepper};

/// All motions of a column that does not move vertically; results in their order.
pub(super) fn run(
    column: &Column,
    motions: &[BaseMotion<'_>],
    width: Width,
    sink: &mut dyn FnMut(usize, &Frame) -> Result<()>,
) -> Vec<Result<RunSummary, Failure>> {
    let mut results: Vec<Option<Result<RunSummary, Failure>>> = motions.iter().map(|_| None).collect();
    let mut stepper = Stepper::new(column, width);
    let mut frames = Frames::new(column);
    let mut waiting = 0..motions.len();
    let mut lanes: Vec<Option<Run<'_>>> = (0..width.lanes()).map(|_| None).collect();
    loop {
        for (lane, run) in lanes.iter_mut().enumerate() {
            loop {
                let Some(active) = run else {
                    let Some(next) = waiting.next() else { break };
                    let input = Input::new(column, motions[next]);
                    match input.base().clock(&column.analysis) {
                        Ok(clock) => {
                            stepper.restart(lane, input.base().acceleration_m_s2[0]);
                            *run = Some(Run { motion: next, input, clock, increment: None });
                        }
                        Err(failure) => results[next] = Some(Err(failure)),
                    }
                    continue;
                };
                let number = active.motion;
                match active.advance(&mut stepper, lane, &mut frames, &mut |f| sink(number, f)) {
                    Ok(true) => break,
                    Ok(false) => results[number] = Some(Ok(active.clock.summary)),
                    Err(failure) => results[number] = Some(Err(failure)),
                }
                stepper.rest(lane);
                *run = None;
            }
        }
        if lanes.iter().all(Option::is_none) {
            return results.into_iter().flatten().collect();
        }
        stepper.iterate();
    }
}

/// A motion on its way.
struct Run<'m> {
    motion: usize,
    input: Input<'m>,
    clock: Clock,
    /// Length and end of the increment that is being solved, s.
    increment: Option<[f64; 2]>,
}

impl Run<'_> {
    /// Takes what the last iteration brought, shows what there is to show, and begins the next increment; false at the end.
    fn advance(
        &mut self,
        stepper: &mut Stepper<'_>,
        lane: usize,
        frames: &mut Frames,
        sink: &mut dyn FnMut(&Frame) -> Result<()>,
    ) -> Result<bool, Failure> {
        let analysis = &stepper.column.analysis;
        if let Some([dt_s, end_s]) = self.increment {
            match stepper.outcome(lane) {
                Outcome::Open => return Ok(true),
                Outcome::Accepted(iterations) => self.clock.accepted(end_s, iterations, analysis),
                Outcome::Cut(cut) => self.clock.cut(cut, dt_s, stepper.column)?,
            }
        }
        loop {
            match self.clock.due(analysis) {
                Due::Nothing => return Ok(false),
                Due::Frame(time_s) => {
                    stepper.show(lane, frames);
                    frames.hand_out(time_s, &self.input, sink)?;
                    self.clock.shown(time_s);
                }
                Due::Increment { dt_s, end_s } => {
                    self.increment = Some([dt_s, end_s]);
                    stepper.begin(lane, dt_s, self.input.base().at(end_s));
                    return Ok(true);
                }
            }
        }
    }
}
