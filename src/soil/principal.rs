//! Stress of plane strain in its principal directions: compression positive, zz always principal.

/// In-plane principal values and direction of (xx, yy, zz, xy).
#[derive(Debug, Clone, Copy)]
pub(super) struct Principal {
    /// The two in-plane values (larger first), then zz.
    pub values: [f64; 3],
    /// cos 2θ and sin 2θ of the larger one's direction from x.
    pub double_angle: (f64, f64),
}

impl Principal {
    /// Of a stress (xx, yy, zz, xy).
    pub fn new(stress: [f64; 4]) -> Self {
        let [xx, yy, zz, xy] = stress;
        let centre = 0.5 * (xx + yy);
        let half = 0.5 * (xx - yy);
        let radius = half.hypot(xy);
        let double_angle = if radius > 0.0 { (half / radius, xy / radius) } else { (1.0, 0.0) };
        Self { values: [centre + radius, centre - radius, zz], double_angle }
    }

    /// The stress (xx, yy, zz, xy) with these principal `values` in the same directions.
    pub fn with_values(&self, values: [f64; 3]) -> [f64; 4] {
        let centre = 0.5 * (values[0] + values[1]);
        let radius = 0.5 * (values[0] - values[1]);
        let (c, s) = self.double_angle;
        [centre + radius * c, centre - radius * c, values[2], radius * s]
    }

    /// Change of the stress (xx, yy, zz, xy) for a change `d` of the trial stress, where the principal values change by
    /// `matrix`·d(trial values) and the directions turn with the trial's.
    pub fn derivative(&self, values: [f64; 3], matrix: &[[f64; 3]; 3], d: [f64; 4]) -> [f64; 4] {
        let (c, s) = self.double_angle;
        let (mean, half) = (0.5 * (d[0] + d[1]), 0.5 * (d[0] - d[1]));
        let along = c * half + s * d[3];
        let across = c * d[3] - s * half;
        let trial = [mean + along, mean - along, d[2]];
        let row = |i: usize| matrix[i][0] * trial[0] + matrix[i][1] * trial[1] + matrix[i][2] * trial[2];
        let new = [row(0), row(1), row(2)];
        let trial_gap = self.values[0] - self.values[1];
        let turn = if trial_gap > 0.0 { across * (values[0] - values[1]) / trial_gap } else { across };
        let (mean, along) = (0.5 * (new[0] + new[1]), 0.5 * (new[0] - new[1]));
        [mean + along * c - turn * s, mean - along * c + turn * s, new[2], along * s + turn * c]
    }
}
