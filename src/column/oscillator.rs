//! The structure on the surface within one increment: its own displacement is condensed out of the column's equations.

use super::Structure;
use super::step::newmark;

/// A structure's memory and the present increment; displacements relative to the input motion like the column's.
pub(super) struct Oscillator {
    mass: f64,
    stiffness: f64,
    dashpot: f64,
    velocity: f64,
    acceleration: f64,
    /// u_s − u_0.
    stretch: f64,
    /// Traction on the surface at the last accepted time.
    force: f64,
    delta: f64,
    trial_velocity: f64,
    trial_acceleration: f64,
    trial_force: f64,
    unbalanced: f64,
    /// Effective tangents of the spring with dashpot, and of that with the mass.
    link: f64,
    own: f64,
}

impl Oscillator {
    /// None without a structure; at rest while the input accelerates with `base_m_s2`.
    pub fn new(structure: &Structure, base_m_s2: f64) -> Option<Self> {
        let w = std::f64::consts::TAU * structure.frequency_hz;
        let mass = structure.mass_kg_m2;
        (mass > 0.0).then(|| Self {
            mass,
            stiffness: mass * w * w,
            dashpot: 2.0 * structure.damping_ratio * mass * w,
            velocity: 0.0,
            acceleration: -base_m_s2,
            stretch: 0.0,
            force: 0.0,
            delta: 0.0,
            trial_velocity: 0.0,
            trial_acceleration: 0.0,
            trial_force: 0.0,
            unbalanced: 0.0,
            link: 0.0,
            own: 1.0,
        })
    }

    /// Starts an increment.
    pub fn begin(&mut self) {
        self.delta = 0.0;
    }

    /// What the structure adds to the effective tangent of the surface.
    pub fn condensed(&mut self, c_mass: f64, hht: f64, c_rate: f64) -> f64 {
        self.link = hht * (self.stiffness + c_rate * self.dashpot);
        self.own = self.mass * c_mass + self.link;
        self.link * (1.0 - self.link / self.own)
    }

    /// What the structure's own imbalance adds to the surface's.
    pub fn condensed_residual(&self) -> f64 {
        self.link / self.own * self.unbalanced
    }

    /// Its own imbalance.
    pub fn unbalanced(&self) -> f64 {
        self.unbalanced
    }

    /// Follows a correction of the surface displacement.
    pub fn correct(&mut self, surface: f64) {
        self.delta -= (self.unbalanced + self.link * surface) / self.own;
    }

    /// (traction on the surface, imbalance of the structure) for an increment and velocity of the surface.
    pub fn residual(&mut self, dt: f64, base: f64, alpha: f64, surface: [f64; 2]) -> (f64, f64) {
        let (beta, gamma) = newmark(alpha);
        let (v, a) = (self.velocity, self.acceleration);
        self.trial_acceleration = (self.delta / dt - v) / (beta * dt) - (0.5 / beta - 1.0) * a;
        self.trial_velocity = v + dt * ((1.0 - gamma) * a + gamma * self.trial_acceleration);
        self.trial_force = self.stiffness * (self.stretch + self.delta - surface[0])
            + self.dashpot * (self.trial_velocity - surface[1]);
        self.unbalanced =
            self.mass * (self.trial_acceleration + base) + (1.0 + alpha) * self.trial_force - alpha * self.force;
        (self.trial_force, self.unbalanced)
    }

    /// Takes the increment over, the surface having moved by `surface`.
    pub fn accept(&mut self, surface: f64) {
        self.stretch += self.delta - surface;
        self.velocity = self.trial_velocity;
        self.acceleration = self.trial_acceleration;
        self.force = self.trial_force;
    }
}
