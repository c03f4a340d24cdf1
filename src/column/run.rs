//! A whole motion: increments that grow and shrink, and a frame at every output time.

use super::step::{Cut, Stepper};
use super::{Cause, Column, Failure};
use crate::error::Result;

/// What the column shows at one output time.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Time, s.
    pub time_s: f64,
    /// Horizontal acceleration handed in, m/s²: that of a rigid base, of the outcrop of a compliant one.
    pub base_m_s2: f64,
    /// Absolute horizontal acceleration at the element centres, surface down, m/s².
    pub elements_m_s2: &'a [f64],
    /// Absolute horizontal acceleration of the surface node, m/s².
    pub surface_m_s2: f64,
    /// Shear strain of the elements.
    pub gamma: &'a [f64],
    /// Shear stress of the elements, without what Rayleigh damping and containers carry, Pa.
    pub tau_pa: &'a [f64],
    /// Vertical effective stress of the elements, Pa, compression positive.
    pub vertical_effective_pa: &'a [f64],
    /// Excess pore pressure of the elements, Pa.
    pub excess_pore_pa: &'a [f64],
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
        if self.mesh.moves_vertically {
            self.run_nodes::<2>(base_dt_s, base_acceleration_m_s2, sink)
        } else {
            self.run_nodes::<1>(base_dt_s, base_acceleration_m_s2, sink)
        }
    }

    /// [`Column::run`] of nodes with D degrees of freedom.
    fn run_nodes<const D: usize>(
        &self,
        base_dt_s: f64,
        base_acceleration_m_s2: &[f64],
        sink: &mut dyn FnMut(&Frame) -> Result<()>,
    ) -> Result<RunSummary, Failure> {
        let fail = |time_s, depth_m, cause| Failure { time_s, depth_m, cause };
        let base = base_acceleration_m_s2;
        if base.is_empty() || base.iter().any(|a| !a.is_finite()) || !(base_dt_s.is_finite() && base_dt_s > 0.0) {
            let what = "the base motion must have finite samples and a positive time step";
            return Err(fail(0.0, 0.0, Cause::Input(what.into())));
        }
        let base_at = |t: f64| {
            let x = t / base_dt_s;
            let i = (x.floor() as usize).min(base.len() - 1);
            let j = (i + 1).min(base.len() - 1);
            base[i] + (x - i as f64).clamp(0.0, 1.0) * (base[j] - base[i])
        };
        let analysis = &self.analysis;
        let output_s = analysis.output_step_s;
        let duration_s = (base.len() - 1) as f64 * base_dt_s;
        let n_output = (duration_s / output_s + 1e-6).floor() as usize;
        let mut stepper = Stepper::<D>::new(self, base[0]);
        let mut frames = Frames::new(self);
        let mut summary = RunSummary::default();
        let mut step_s = analysis.initial_step_s;
        let mut easy = 0;
        frames.show(self, &stepper, 0.0, base[0], sink).map_err(|e| fail(0.0, 0.0, Cause::Sink(Box::new(e))))?;
        for k in 1..=n_output {
            let end_s = k as f64 * output_s;
            let mut time_s = (k - 1) as f64 * output_s;
            while end_s - time_s > 1e-9 * output_s {
                let pieces = ((end_s - time_s) / step_s * (1.0 - 1e-9)).ceil().max(1.0);
                let dt = (end_s - time_s) / pieces;
                let next_s = if pieces == 1.0 { end_s } else { time_s + dt };
                match stepper.advance(dt, base_at(next_s)) {
                    Ok(iterations) => {
                        time_s = next_s;
                        summary.steps += 1;
                        summary.newton_iterations += u64::from(iterations);
                        easy = if iterations <= 6 { easy + 1 } else { 0 };
                        if easy >= 3 && step_s < analysis.max_step_s {
                            step_s = (2.0 * step_s).min(analysis.max_step_s);
                            easy = 0;
                        }
                    }
                    Err(cut) => {
                        easy = 0;
                        step_s = 0.5 * dt;
                        let (node, cause) = match cut {
                            Cut::Front => {
                                summary.fronts += 1;
                                continue;
                            }
                            Cut::Law { element, refusal } => (element, Cause::Law(refusal)),
                            Cut::Unbalanced { node, share } => (node, Cause::Unbalanced { share, step_s: dt }),
                            Cut::Singular => (0, Cause::Singular),
                        };
                        summary.cuts += 1;
                        if step_s < analysis.min_step_s {
                            // A compliant base is a node without an element below.
                            let element = node.min(self.mesh.elements.len() - 1);
                            return Err(fail(time_s, self.mesh.elements[element].depth_m, cause));
                        }
                    }
                }
            }
            frames
                .show(self, &stepper, end_s, base_at(end_s), sink)
                .map_err(|e| fail(end_s, 0.0, Cause::Sink(Box::new(e))))?;
        }
        Ok(summary)
    }
}

/// Buffers of the frames.
struct Frames {
    elements_m_s2: Vec<f64>,
    tau_pa: Vec<f64>,
    vertical_pa: Vec<f64>,
    pore_pa: Vec<f64>,
}

impl Frames {
    fn new(column: &Column) -> Self {
        let zero = vec![0.0; column.mesh.elements.len()];
        Self { elements_m_s2: zero.clone(), tau_pa: zero.clone(), vertical_pa: zero.clone(), pore_pa: zero }
    }

    fn show<const D: usize>(
        &mut self,
        column: &Column,
        stepper: &Stepper<D>,
        time_s: f64,
        base_m_s2: f64,
        sink: &mut dyn FnMut(&Frame) -> Result<()>,
    ) -> Result<()> {
        let a = &stepper.acceleration;
        for (i, element) in column.mesh.elements.iter().enumerate() {
            let below = a.get(i + 1).map_or(0.0, |a| a[0]);
            self.elements_m_s2[i] = base_m_s2 + 0.5 * (a[i][0] + below);
            self.tau_pa[i] = stepper.responses[i].tau_pa;
            self.vertical_pa[i] = -stepper.responses[i].sigma_yy_pa;
            self.pore_pa[i] = -element.pore_pa * stepper.eps_yy[i];
        }
        sink(&Frame {
            time_s,
            base_m_s2,
            elements_m_s2: &self.elements_m_s2,
            surface_m_s2: base_m_s2 + a[0][0],
            gamma: &stepper.gamma,
            tau_pa: &self.tau_pa,
            vertical_effective_pa: &self.vertical_pa,
            excess_pore_pa: &self.pore_pa,
        })
    }
}
