//! A whole motion: increments that grow and shrink, and a frame at every output time.

use super::step::{Cut, Stepper};
use super::{Analysis, Cause, Column, Downgoing, Failure, batch};
use crate::error::Result;
use crate::numerics::lanes::Width;
use std::sync::Arc;

/// What the column shows at one output time.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Time, s.
    pub time_s: f64,
    /// Horizontal acceleration handed in, m/s²: that of a rigid base, of the outcrop of a compliant one, or what is recorded there
    /// where down-going waves have lost coherence.
    pub base_m_s2: f64,
    /// Absolute horizontal acceleration at the element centres, surface down, m/s².
    pub elements_m_s2: &'a [f64],
    /// Absolute horizontal acceleration where elements meet, from the surface to the base, m/s².
    pub nodes_m_s2: &'a [f64],
    /// Shear strain of the elements.
    pub gamma: &'a [f64],
    /// Shear stress of the elements, without what Rayleigh damping and containers carry, Pa.
    pub tau_pa: &'a [f64],
    /// Vertical effective stress of the elements, Pa, compression positive.
    pub vertical_effective_pa: &'a [f64],
    /// Excess pore pressure of the elements, Pa.
    pub excess_pore_pa: &'a [f64],
}

impl Frame<'_> {
    /// Absolute horizontal acceleration of the surface, m/s².
    pub fn surface_m_s2(&self) -> f64 {
        self.nodes_m_s2[0]
    }
}

/// How much work a run was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RunSummary {
    /// Accepted increments.
    pub steps: u64,
    /// Increments that had to be shortened to be solved.
    pub cuts: u64,
    /// Increments that were shortened to follow an acceleration front.
    pub fronts: u64,
    /// Newton iterations: law evaluations of the whole column in accepted increments.
    pub newton_iterations: u64,
}

/// A motion of the base.
#[derive(Debug, Clone, Copy)]
pub struct BaseMotion<'m> {
    /// Time step of the samples, s; linear between them.
    pub dt_s: f64,
    /// Horizontal acceleration, m/s².
    pub acceleration_m_s2: &'m [f64],
}

impl BaseMotion<'_> {
    /// Acceleration at `time_s`.
    pub(super) fn at(&self, time_s: f64) -> f64 {
        let base = self.acceleration_m_s2;
        let x = time_s / self.dt_s;
        let i = (x.floor() as usize).min(base.len() - 1);
        let j = (i + 1).min(base.len() - 1);
        base[i] + (x - i as f64).clamp(0.0, 1.0) * (base[j] - base[i])
    }

    /// The way through the motion.
    pub(super) fn clock(&self, analysis: &Analysis) -> Result<Clock, Failure> {
        let Self { dt_s, acceleration_m_s2: base } = *self;
        if base.is_empty() || base.iter().any(|a| !a.is_finite()) || !(dt_s.is_finite() && dt_s > 0.0) {
            let what = "the base motion must have finite samples and a positive time step";
            return Err(Failure { time_s: 0.0, depth_m: 0.0, cause: Cause::Input(what.into()) });
        }
        let duration_s = (base.len() - 1) as f64 * dt_s;
        let n_output = (duration_s / analysis.output_step_s + 1e-6).floor() as usize;
        let step_s = analysis.initial_step_s;
        Ok(Clock { output: 0, n_output, time_s: 0.0, step_s, easy: 0, summary: RunSummary::default() })
    }
}

/// A motion as it is handed in, and what it makes the base do.
pub(super) struct Input<'m> {
    recorded: BaseMotion<'m>,
    /// Acceleration of the base, m/s², where that is another one.
    base_m_s2: Option<Vec<f64>>,
}

impl<'m> Input<'m> {
    pub fn new(column: &Column, recorded: BaseMotion<'m>) -> Self {
        let is_sound = !recorded.acceleration_m_s2.is_empty() && recorded.dt_s > 0.0;
        let of = |d: &Arc<Downgoing>| d.base(recorded.acceleration_m_s2, recorded.dt_s);
        Self { recorded, base_m_s2: column.downgoing.as_ref().filter(|_| is_sound).map(of) }
    }

    /// The motion of the base.
    pub fn base(&self) -> BaseMotion<'_> {
        let base = self.base_m_s2.as_deref().unwrap_or(self.recorded.acceleration_m_s2);
        BaseMotion { dt_s: self.recorded.dt_s, acceleration_m_s2: base }
    }
}

/// What a run does next.
pub(super) enum Due {
    /// Show a frame at this time, s.
    Frame(f64),
    /// An increment of this length to this time, s.
    Increment { dt_s: f64, end_s: f64 },
    /// Nothing: it is at its end.
    Nothing,
}

/// Where a run is, and how long its increments are.
pub(super) struct Clock {
    /// The output time that comes next.
    output: usize,
    n_output: usize,
    time_s: f64,
    step_s: f64,
    /// Increments in a row that were solved in few iterations.
    easy: u32,
    pub summary: RunSummary,
}

impl Clock {
    pub fn due(&self, analysis: &Analysis) -> Due {
        if self.output > self.n_output {
            return Due::Nothing;
        }
        let end_s = self.output as f64 * analysis.output_step_s;
        let left_s = end_s - self.time_s;
        if left_s <= 1e-9 * analysis.output_step_s {
            return Due::Frame(end_s);
        }
        let pieces = (left_s / self.step_s * (1.0 - 1e-9)).ceil().max(1.0);
        let dt_s = left_s / pieces;
        Due::Increment { dt_s, end_s: if pieces == 1.0 { end_s } else { self.time_s + dt_s } }
    }

    /// A frame was shown at `time_s`.
    pub fn shown(&mut self, time_s: f64) {
        self.time_s = time_s;
        self.output += 1;
    }

    /// An increment to `end_s` was solved in so many iterations.
    pub fn accepted(&mut self, end_s: f64, iterations: u32, analysis: &Analysis) {
        self.time_s = end_s;
        self.summary.steps += 1;
        self.summary.newton_iterations += u64::from(iterations);
        self.easy = if iterations <= 6 { self.easy + 1 } else { 0 };
        if self.easy >= 3 && self.step_s < analysis.max_step_s {
            self.step_s = (2.0 * self.step_s).min(analysis.max_step_s);
            self.easy = 0;
        }
    }

    /// An increment of `dt_s` has to be halved.
    pub fn cut(&mut self, cut: Cut, dt_s: f64, column: &Column) -> Result<(), Failure> {
        self.easy = 0;
        self.step_s = 0.5 * dt_s;
        let (node, cause) = match cut {
            Cut::Front => {
                self.summary.fronts += 1;
                return Ok(());
            }
            Cut::Law { element, refusal } => (element, Cause::Law(refusal)),
            Cut::Unbalanced { node, share } => (node, Cause::Unbalanced { share, step_s: dt_s }),
            Cut::Singular => (0, Cause::Singular),
        };
        self.summary.cuts += 1;
        if self.step_s >= column.analysis.min_step_s {
            return Ok(());
        }
        // A compliant base is a node without an element below.
        let element = node.min(column.mesh.elements.len() - 1);
        Err(Failure { time_s: self.time_s, depth_m: column.mesh.elements[element].depth_m, cause })
    }
}

impl Column {
    /// Shakes the base with `base_acceleration_m_s2`, sampled every `base_dt_s` and linear between, from rest; `sink` gets a
    /// frame at every output time, t = 0 included.
    ///
    /// # Errors
    /// When the increment would have to be shorter than `min_step_s`, with time, depth and cause.
    pub fn run(
        &self,
        base_dt_s: f64,
        base_acceleration_m_s2: &[f64],
        sink: &mut dyn FnMut(&Frame) -> Result<()>,
    ) -> Result<RunSummary, Failure> {
        let base = BaseMotion { dt_s: base_dt_s, acceleration_m_s2: base_acceleration_m_s2 };
        if self.mesh.moves_vertically { self.run_nodes::<2>(base, sink) } else { self.run_nodes::<1>(base, sink) }
    }

    /// [`Column::run`] of every motion, the same to the last bit, side by side where the column does not move vertically; `sink` gets
    /// the frames of each in order, with its number.
    pub fn run_all(
        &self,
        motions: &[BaseMotion<'_>],
        sink: &mut dyn FnMut(usize, &Frame) -> Result<()>,
    ) -> Vec<Result<RunSummary, Failure>> {
        self.run_all_by(motions, Width::widest(), sink)
    }

    /// Whether [`Column::run_all`] takes motions side by side: nodes that move vertically are stepped motion by motion.
    pub fn is_batched(&self) -> bool {
        !self.mesh.moves_vertically
    }

    /// [`Column::run_all`] with as many motions side by side as `width` has lanes.
    pub fn run_all_by(
        &self,
        motions: &[BaseMotion<'_>],
        width: Width,
        sink: &mut dyn FnMut(usize, &Frame) -> Result<()>,
    ) -> Vec<Result<RunSummary, Failure>> {
        if motions.len() > 1 && self.is_batched() {
            return batch::run(self, motions, width, sink);
        }
        let one = |(i, motion): (usize, &BaseMotion)| {
            self.run(motion.dt_s, motion.acceleration_m_s2, &mut |frame| sink(i, frame))
        };
        motions.iter().enumerate().map(one).collect()
    }

    /// [`Column::run`] of nodes with D degrees of freedom.
    fn run_nodes<const D: usize>(
        &self,
        recorded: BaseMotion<'_>,
        sink: &mut dyn FnMut(&Frame) -> Result<()>,
    ) -> Result<RunSummary, Failure> {
        let input = Input::new(self, recorded);
        let base = input.base();
        let mut clock = base.clock(&self.analysis)?;
        let mut stepper = Stepper::<D>::new(self, base.acceleration_m_s2[0]);
        let mut frames = Frames::new(self);
        loop {
            match clock.due(&self.analysis) {
                Due::Nothing => return Ok(clock.summary),
                Due::Frame(time_s) => {
                    stepper.show(&mut frames);
                    frames.hand_out(time_s, &input, sink)?;
                    clock.shown(time_s);
                }
                Due::Increment { dt_s, end_s } => match stepper.advance(dt_s, base.at(end_s)) {
                    Ok(iterations) => clock.accepted(end_s, iterations, &self.analysis),
                    Err(cut) => clock.cut(cut, dt_s, self)?,
                },
            }
        }
    }
}

/// A frame in the making: accelerations relative to the base.
pub(super) struct Frames {
    pub nodes_m_s2: Vec<f64>,
    elements_m_s2: Vec<f64>,
    pub gamma: Vec<f64>,
    pub tau_pa: Vec<f64>,
    pub vertical_pa: Vec<f64>,
    pub pore_pa: Vec<f64>,
}

impl Frames {
    pub fn new(column: &Column) -> Self {
        let zero = vec![0.0; column.mesh.elements.len()];
        Self {
            nodes_m_s2: vec![0.0; zero.len() + 1],
            elements_m_s2: zero.clone(),
            gamma: zero.clone(),
            tau_pa: zero.clone(),
            vertical_pa: zero.clone(),
            pore_pa: zero,
        }
    }

    /// Hands the frame to `sink`, accelerations made absolute.
    pub fn hand_out(
        &mut self,
        time_s: f64,
        input: &Input<'_>,
        sink: &mut dyn FnMut(&Frame) -> Result<()>,
    ) -> Result<(), Failure> {
        let base_m_s2 = input.base().at(time_s);
        for (mean, ends) in self.elements_m_s2.iter_mut().zip(self.nodes_m_s2.windows(2)) {
            *mean = 0.5 * (ends[0] + ends[1]) + base_m_s2;
        }
        self.nodes_m_s2.iter_mut().for_each(|a| *a += base_m_s2);
        let frame = Frame {
            time_s,
            base_m_s2: input.recorded.at(time_s),
            elements_m_s2: &self.elements_m_s2,
            nodes_m_s2: &self.nodes_m_s2,
            gamma: &self.gamma,
            tau_pa: &self.tau_pa,
            vertical_effective_pa: &self.vertical_pa,
            excess_pore_pa: &self.pore_pa,
        };
        sink(&frame).map_err(|e| Failure { time_s, depth_m: 0.0, cause: Cause::Sink(Box::new(e)) })
    }
}
