//! A small nonlinear shear column with which the learned stages are tested and timed without the finite-element column.
//!
//! Lumped masses on springs of parallel elastic–plastic elements (hyperbolic backbone, Masing unloading by construction),
//! explicit central differences, base acceleration from filtered noise. Strong motions soften it clearly, weak ones
//! hardly. Not a model of any site.

use flare_pipe::flare::{Case, Observation};
use flare_pipe::numerics::random::stream;
use rand::RngExt;
use std::f64::consts::{PI, TAU};

const FINE_S: f64 = 0.00125;
const N_NODE: usize = 34;
const DEPTH_M: f64 = 17.0;
const N_SLIDER: usize = 8;
/// 0.05 s over the fine step.
const STRIDE: usize = 40;

/// What to generate.
pub struct Synthetic {
    /// Number of motions.
    pub n_case: usize,
    /// Duration (s).
    pub duration_s: f64,
    /// Evenly spaced dense channels, interpolated between the masses.
    pub channels: usize,
    /// Depths of the sensors (m).
    pub sensor_depth_m: Vec<f64>,
    /// Reference strain of the springs.
    pub gamma_ref: f64,
    /// Factor on all shear-wave velocities: another column for stand-in records.
    pub velocity_factor: f64,
    /// Seed of the motions.
    pub seed: u64,
}

impl Default for Synthetic {
    fn default() -> Self {
        Self {
            n_case: 100,
            duration_s: 15.0,
            channels: 100,
            sensor_depth_m: vec![11.0, 6.0, 0.0],
            gamma_ref: 1.2e-3,
            velocity_factor: 1.0,
            seed: 1,
        }
    }
}

/// Motion in m/s² at the fine step, with its half steps in reach.
pub struct Series {
    base: Vec<f64>,
    response: Vec<Vec<f64>>, // [node][fine step], surface first
}

impl Synthetic {
    /// Runs all motions and normalises by the standard deviations of the first `n_train` of them.
    pub fn cases(&self, n_train: usize) -> (Vec<Case>, Observation) {
        let series: Vec<Series> = (0..self.n_case).map(|i| self.run(&self.motion(i))).collect();
        let observation = self.observation(&series[..n_train]);
        let input_std = std_of(series[..n_train].iter().flat_map(|s| &s.base).copied());
        let cases = series.iter().enumerate().map(|(i, s)| self.case(i, s, &observation, input_std)).collect();
        (cases, observation)
    }

    /// Standard deviation of the base acceleration of the first `n_train` motions, as `cases` uses it.
    pub fn input_std(&self, n_train: usize) -> f64 {
        let motions: Vec<Vec<f64>> = (0..n_train).map(|i| low_pass(&self.motion(i))).collect();
        std_of(motions.iter().flatten().copied())
    }

    /// Cases normalised with given statistics: stand-ins for records of another column.
    pub fn cases_like(&self, observation: &Observation, input_std: f64) -> Vec<Case> {
        (0..self.n_case).map(|i| self.case(i, &self.run(&self.motion(i)), observation, input_std)).collect()
    }

    fn observation(&self, train: &[Series]) -> Observation {
        let channel_depth_m: Vec<f64> =
            (0..self.channels).map(|c| (c as f64 + 0.5) * DEPTH_M / self.channels as f64).collect();
        let std_at = |z: f64| std_of(train.iter().flat_map(|s| at_depth(s, z)));
        Observation {
            sensors: (0..self.sensor_depth_m.len()).map(|i| format!("S{i}")).collect(),
            dense_std_m_s2: channel_depth_m.iter().map(|z| std_at(*z)).collect(),
            sparse_std_m_s2: self.sensor_depth_m.iter().map(|z| std_at(*z)).collect(),
            channel_depth_m,
            sensor_depth_m: self.sensor_depth_m.clone(),
        }
    }

    fn case(&self, i: usize, s: &Series, observation: &Observation, input_std: f64) -> Case {
        let n_step = s.base.len().div_ceil(STRIDE);
        let at = |x: &[f64], t: usize| x[t.min(x.len() - 1)];
        let gather = |depths: &[f64], stds: &[f64]| -> Vec<f32> {
            let columns: Vec<Vec<f64>> = depths.iter().map(|z| at_depth(s, *z)).collect();
            (0..n_step)
                .flat_map(|t| columns.iter().zip(stds).map(move |(x, std)| (at(x, t * STRIDE) / std) as f32))
                .collect()
        };
        Case {
            id: format!("{:03}", i + 1),
            u: (0..n_step).map(|t| (at(&s.base, t * STRIDE) / input_std) as f32).collect(),
            u_half: (0..n_step - 1).map(|t| (at(&s.base, t * STRIDE + STRIDE / 2) / input_std) as f32).collect(),
            dense: gather(&observation.channel_depth_m, &observation.dense_std_m_s2).into(),
            sparse: gather(&observation.sensor_depth_m, &observation.sparse_std_m_s2).into(),
        }
    }

    /// Noise between two corner frequencies under an envelope, scaled to its peak: 60 % weak, 20 % moderate, 20 % strong.
    fn motion(&self, i: usize) -> Vec<f64> {
        let mut random = stream(self.seed, &format!("synthetic motion {i}"));
        let (low, high) = match i % 5 {
            0..=2 => (0.0075, 0.02),
            3 => (0.02, 0.06),
            _ => (0.06, 0.112),
        };
        let peak = 9.81 * (low + (high - low) * random.random::<f64>());
        let (f_low, f_high) = (0.3 + random.random::<f64>(), 3.0 + 4.0 * random.random::<f64>());
        let (rise, length) =
            (0.5 + 2.0 * random.random::<f64>(), self.duration_s * (0.2 + 0.4 * random.random::<f64>()));
        let n_wave = 60;
        let waves: Vec<(f64, f64)> = (0..n_wave)
            .map(|k| {
                let share = (k as f64 + random.random::<f64>()) / n_wave as f64;
                (f_low * (f_high / f_low).powf(share), TAU * random.random::<f64>())
            })
            .collect();
        let mut a: Vec<f64> = (0..(self.duration_s / FINE_S) as usize)
            .map(|t| {
                let t = t as f64 * FINE_S;
                let envelope =
                    if t < rise { (t / rise).powi(2) } else { (-((t - rise - length).max(0.0)) / 1.5).exp() };
                envelope * waves.iter().map(|(f, phase)| (TAU * f * t + phase).sin()).sum::<f64>()
            })
            .collect();
        let largest = a.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        a.iter_mut().for_each(|v| *v *= peak / largest);
        a
    }

    fn run(&self, base: &[f64]) -> Series {
        let h = DEPTH_M / N_NODE as f64;
        let density = 2000.0;
        let g: Vec<f64> = (0..N_NODE)
            .map(|i| {
                let vs = self.velocity_factor * (110.0 + 105.0 * (i as f64 + 0.5) / N_NODE as f64);
                density * vs * vs
            })
            .collect();
        // a hyperbola through N_SLIDER elastic–plastic elements: stiffness share and yield strain of each
        let strains: Vec<f64> = (0..=N_SLIDER).map(|k| self.gamma_ref * 0.03 * 2.2_f64.powi(k as i32)).collect();
        let backbone = |x: f64| x / (1.0 + x / self.gamma_ref);
        let slope = |k: usize| {
            let from = if k == 0 { 0.0 } else { strains[k - 1] };
            (backbone(strains[k]) - backbone(from)) / (strains[k] - from)
        };
        let share: Vec<f64> = (0..N_SLIDER).map(|k| slope(k) - slope(k + 1)).collect();
        let residual = slope(N_SLIDER);
        let beta = 0.0006;
        let mut slip = vec![0.0_f64; N_NODE * N_SLIDER];
        let (mut u, mut v) = (vec![0.0; N_NODE], vec![0.0; N_NODE]); // relative to the base
        let mut response = vec![Vec::new(); N_NODE];
        for a_base in base {
            let mut stress = vec![0.0; N_NODE];
            for i in 0..N_NODE {
                let (below_u, below_v) = if i + 1 < N_NODE { (u[i + 1], v[i + 1]) } else { (0.0, 0.0) };
                let (gamma, rate) = ((u[i] - below_u) / h, (v[i] - below_v) / h);
                let mut tau = residual * gamma;
                for k in 0..N_SLIDER {
                    let s = &mut slip[i * N_SLIDER + k];
                    *s = f64::clamp(*s, gamma - strains[k], gamma + strains[k]);
                    tau += share[k] * (gamma - *s);
                }
                stress[i] = g[i] * (tau + beta * rate);
            }
            for i in 0..N_NODE {
                let above = if i == 0 { 0.0 } else { stress[i - 1] };
                let mass = density * h * if i == 0 { 0.5 } else { 1.0 };
                let total = (above - stress[i]) / mass;
                response[i].push(total);
                v[i] += FINE_S * (total - a_base);
                u[i] += FINE_S * v[i];
            }
        }
        Series { base: low_pass(base), response: response.iter().map(|x| low_pass(x)).collect() }
    }
}

fn at_depth(s: &Series, depth_m: f64) -> Vec<f64> {
    let x = (depth_m / DEPTH_M * N_NODE as f64).clamp(0.0, N_NODE as f64);
    let i = (x.floor() as usize).min(N_NODE - 1);
    let share = x - i as f64;
    let below = if i + 1 < N_NODE { &s.response[i + 1] } else { &s.base };
    s.response[i].iter().zip(below).map(|(a, b)| (1.0 - share) * a + share * b).collect()
}

/// Zero-phase windowed-sinc low-pass with its corner at 8 Hz.
fn low_pass(x: &[f64]) -> Vec<f64> {
    let (half, corner) = (4 * STRIDE, 8.0 * FINE_S);
    let tap = |k: isize| {
        let t = k as f64;
        let sinc = if k == 0 { 2.0 * corner } else { (TAU * corner * t).sin() / (PI * t) };
        sinc * (0.5 + 0.5 * (PI * t / half as f64).cos())
    };
    let taps: Vec<f64> = (-(half as isize)..=half as isize).map(tap).collect();
    // only every STRIDE/2-th sample is ever read
    let mut y = vec![0.0; x.len()];
    for t in (0..x.len()).step_by(STRIDE / 2) {
        let first = t.saturating_sub(half);
        let last = (t + half).min(x.len() - 1);
        y[t] = (first..=last).map(|s| x[s] * taps[s + half - t]).sum();
    }
    y
}

fn std_of(x: impl Iterator<Item = f64>) -> f64 {
    let (mut n, mut sum) = (0.0, 0.0);
    for v in x.step_by(STRIDE) {
        n += 1.0;
        sum += v * v;
    }
    (sum / n).sqrt()
}
