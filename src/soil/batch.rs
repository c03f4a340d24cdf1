//! Points of one law under several motions at once. Each motion has a lane; arrays are `[point][lane]`. What happens in one lane does not
//! depend on the others, and is what [`Law::update_all`] makes of the same increments, to the last bit.

use super::{Increment, Law, Refusal, Response};

/// The memory of points under several motions, and the law that it follows. Shear alone: the points do not move vertically.
pub trait Batch {
    /// Puts a lane back to the geostatic state.
    fn restart(&mut self, lane: usize);

    /// Turns the stresses and tangents after the last increments into those after the time of `steps` without strain.
    fn relax(&mut self, steps: &Steps, shear: &mut Shear);

    /// Stresses and tangents after `increments` of shear strain; the first point of a lane that is refused to `refused`. What becomes of
    /// lanes without a step does not matter.
    fn update(
        &mut self,
        steps: &Steps,
        increments: &[f64],
        shear: &mut Shear,
        refused: &mut [Option<(usize, Refusal)>],
    );

    /// Takes over the last update of `lanes`.
    fn accept(&mut self, lanes: &[bool]);

    /// Vertical effective stress of the points of a lane, Pa, tension positive.
    fn vertical_pa(&self, lane: usize, sigma_yy_pa: &mut [f64]);
}

/// Steps of the lanes that have one.
pub struct Steps<'s> {
    /// Which have.
    pub lanes: &'s [bool],
    /// How long they are, s; above nothing in every lane.
    pub dt_s: &'s [f64],
}

/// Shear stress and tangent of points, `[point][lane]`, Pa.
pub struct Shear<'s> {
    /// Stress.
    pub tau_pa: &'s mut [f64],
    /// Its derivative by shear strain.
    pub tangent_pa: &'s mut [f64],
}

/// A batch of any law: lane after lane by [`Law::update_all`].
pub(super) struct LaneByLane<'l> {
    law: &'l dyn Law,
    start: &'l [f64],
    response: Vec<Response>,
    increments: Vec<Increment>,
    lanes: Vec<Memory>,
}

struct Memory {
    state: Vec<f64>,
    trial_state: Vec<f64>,
    responses: Vec<Response>,
    trial_responses: Vec<Response>,
}

impl<'l> LaneByLane<'l> {
    /// A batch of points that start with this memory and these responses.
    pub fn new(law: &'l dyn Law, start: &'l [f64], response: Vec<Response>, lanes: usize) -> Self {
        let memory = || Memory {
            state: start.to_vec(),
            trial_state: start.to_vec(),
            responses: response.clone(),
            trial_responses: response.clone(),
        };
        let increments = vec![Increment::default(); response.len()];
        Self { law, start, increments, lanes: (0..lanes).map(|_| memory()).collect(), response }
    }
}

impl Batch for LaneByLane<'_> {
    fn restart(&mut self, lane: usize) {
        self.lanes[lane].state.copy_from_slice(self.start);
        self.lanes[lane].responses.copy_from_slice(&self.response);
    }

    fn relax(&mut self, steps: &Steps, shear: &mut Shear) {
        let Steps { lanes, dt_s } = *steps;
        let n = lanes.len();
        for (lane, memory) in self.lanes.iter_mut().enumerate().filter(|(lane, _)| lanes[*lane]) {
            memory.trial_responses.copy_from_slice(&memory.responses);
            self.law.relax_all(dt_s[lane], &memory.state, &mut memory.trial_responses);
            write(&memory.trial_responses, lane, n, shear);
        }
    }

    fn update(
        &mut self,
        steps: &Steps,
        increments: &[f64],
        shear: &mut Shear,
        refused: &mut [Option<(usize, Refusal)>],
    ) {
        let Steps { lanes, dt_s } = *steps;
        let n = lanes.len();
        for (lane, memory) in self.lanes.iter_mut().enumerate().filter(|(lane, _)| lanes[*lane]) {
            for (own, all) in self.increments.iter_mut().zip(increments.chunks_exact(n)) {
                *own = Increment { gamma: all[lane], eps_yy: 0.0, dt_s: dt_s[lane] };
            }
            let trial = (&mut memory.trial_state, &mut memory.trial_responses);
            match self.law.update_all(&self.increments, &memory.state, trial.0, trial.1) {
                Ok(()) => write(&memory.trial_responses, lane, n, shear),
                Err(refusal) => refused[lane] = Some(refusal),
            }
        }
    }

    fn accept(&mut self, lanes: &[bool]) {
        for (memory, _) in self.lanes.iter_mut().zip(lanes).filter(|(_, is_accepted)| **is_accepted) {
            std::mem::swap(&mut memory.state, &mut memory.trial_state);
            std::mem::swap(&mut memory.responses, &mut memory.trial_responses);
        }
    }

    fn vertical_pa(&self, lane: usize, sigma_yy_pa: &mut [f64]) {
        sigma_yy_pa.iter_mut().zip(&self.lanes[lane].responses).for_each(|(sigma, r)| *sigma = r.sigma_yy_pa);
    }
}

fn write(responses: &[Response], lane: usize, lanes: usize, shear: &mut Shear) {
    for (i, response) in responses.iter().enumerate() {
        shear.tau_pa[i * lanes + lane] = response.tau_pa;
        shear.tangent_pa[i * lanes + lane] = response.tangent_pa[0];
    }
}
