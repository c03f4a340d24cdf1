//! Modified hyperbolic backbone with extended Masing rules, for sites that have little more than a velocity profile.

mod batch;

use super::{Batch, Damping, Increment, Law, Point, Ranges, Refusal, Response, update_alone};
use crate::error::Result;
use crate::numerics::lanes::{Width, raise};
use crate::registry::{Entry, params};
use crate::units::GPA;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Law> = Entry {
    name: "hyperbolic",
    about: "MKZ backbone, extended Masing rules, Darendeli curves by plasticity index and confining stress",
    build: |table| {
        let law: Hyperbolic = params(table)?;
        Ranges::new()
            .check("plasticity_index", law.plasticity_index, 0.0, 200.0)
            .check("ocr", law.ocr, 1.0, 50.0)
            .check("curvature", law.curvature, 0.5, 1.5)
            .check("gamma_ref", law.gamma_ref.unwrap_or(1e-3), 1e-6, 1.0)
            .check("gamma_ref_multiplier", law.gamma_ref_multiplier, 0.01, 1e6)
            .check("damping_ratio", law.damping_ratio.unwrap_or(0.0), 0.0, 0.5)
            .check("damping_multiplier", law.damping_multiplier, 0.0, 20.0)
            .check("damping_exponent", law.damping_exponent, -0.6, 0.6)
            .check("hysteresis_multiplier", law.hysteresis_multiplier, 0.05, 3.0)
            .check("cycles", law.cycles, 1.0, 1e4)
            .check("poisson_ratio", law.poisson_ratio, 0.0, 0.495)
            .check("porosity", law.porosity, 0.01, 0.99)
            .check("k_w_gpa", law.k_w_gpa, 0.0, 10.0)
            .done()?;
        Ok(Box::new(law))
    },
    schema: || schemars::schema_for!(Hyperbolic),
};

/// Modified Kondner–Zelasko backbone with extended Masing unloading and a damping reduction factor.
///
/// ```text
/// backbone            τ_b(γ) = G γ / (1 + |γ/γ_r|^s)                                            (1)
/// from reversal (γ_a, τ_a), x = γ − γ_a:
///                     τ = τ_a + F [2 τ_b(x/2) − G_m x] + G_m x                                   (2)
/// with the secant     G_m = τ_b(γ_m)/γ_m at the largest strain γ_m so far                       (3)
/// and the factor      F = k b (G_m/G)^0.1,   b = 0.6329 − 0.0057 ln N                            (4)
/// reference strain    γ_r = (0.0352 + 0.0010 PI OCR^0.3246) (σ'₀/p_a)^0.3483 / 100              (5)
/// small strain        ξ_min = (0.8005 + 0.0129 PI OCR^−0.1069) (σ'₀/p_a)^−0.2889 / 100          (6)
/// ```
///
/// ξ_min is [`Viscoelastic`](super::Viscoelastic): ξ(f) = ξ_min (f/f_r)ⁿ beside the hysteresis, f_r = 3 Hz, where Vs holds;
/// n = 0 does not depend on frequency. The factor 1 + 0.2919 ln f of the source's (6) is left out: it is 1 at 1 Hz, 1.67 at
/// 10 Hz, about n = 0.22. Who wants Rayleigh damping declares ξ_min = 0 and `[site.rayleigh]`.
///
/// Since the straight part of (2) encloses nothing, the loop damping is F times Masing's, which is Darendeli's curve.
/// A curve that meets an earlier reversal goes on as if the inner loop had not been; one that passes γ_m is the backbone.
///
/// | symbol | field                  | unit | range     |
/// |--------|------------------------|------|-----------|
/// | PI     | `plasticity_index`     | %    | 0…200     |
/// | OCR    | `ocr`                  | –    | 1…50      |
/// | s      | `curvature`            | –    | 0.5…1.5   |
/// | γ_r    | `gamma_ref` (else (5)) | –    | 1e-6…1    |
/// | ξ_min  | `damping_ratio` (else (6)) | – | 0…0.5    |
/// | n      | `damping_exponent`     | –    | −0.6…0.6  |
/// | k      | `hysteresis_multiplier`| –    | 0.05…3    |
/// | N      | `cycles`               | –    | 1…1e4     |
/// | ν, φ, K_w | as in `elastic`     |      |           |
/// | state  | τ, σ, γ, γ_m, constants, G_m, F, reversals | [10 + 2·24] | Pa, – |
///
/// Limits: no strength and no pore pressure; volumetric response linear; at most 24 open reversals, loops inside which
/// enclose nothing; confining stress below 1 kPa counts as 1 kPa.
/// Check: `tests/verification/masing.rs`: loop area in closed form, closure of inner loops, no jump however many are open.
/// Source: Darendeli (2001), Development of a new family of normalized modulus reduction and material damping curves;
/// Matasović & Vucetic (1993), doi 10.1061/(ASCE)0733-9410(1993)119:11(1805); Phillips & Hashash (2009),
/// doi 10.1016/j.soildyn.2008.12.004, for the form of (2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Hyperbolic {
    /// Plasticity index PI, %.
    plasticity_index: f64,
    /// Overconsolidation ratio.
    ocr: f64,
    /// Exponent s of the backbone.
    curvature: f64,
    /// Reference strain γ_r; from PI, OCR and confining stress where absent.
    gamma_ref: Option<f64>,
    /// Factor on the reference strain.
    gamma_ref_multiplier: f64,
    /// Small-strain damping ratio ξ_min; from PI, OCR and confining stress where absent.
    damping_ratio: Option<f64>,
    /// Factor on the small-strain damping ratio.
    damping_multiplier: f64,
    /// Exponent n of its growth with frequency.
    damping_exponent: f64,
    /// Factor k on the damping of loops; with `reduce_damping = false` on Masing's.
    hysteresis_multiplier: f64,
    /// Number of cycles N of the damping curve.
    cycles: f64,
    /// Whether hysteretic damping is reduced by F; false gives the plain Masing rule.
    reduce_damping: bool,
    /// Poisson's ratio ν of the skeleton.
    poisson_ratio: f64,
    /// Porosity n (pore water below the water table).
    porosity: f64,
    /// Bulk modulus of water, GPa (0: drained).
    k_w_gpa: f64,
}

impl Default for Hyperbolic {
    fn default() -> Self {
        Self {
            plasticity_index: 0.0,
            ocr: 1.0,
            curvature: 0.919,
            gamma_ref: None,
            gamma_ref_multiplier: 1.0,
            damping_ratio: None,
            damping_multiplier: 1.0,
            damping_exponent: 0.0,
            hysteresis_multiplier: 1.0,
            cycles: 10.0,
            reduce_damping: true,
            poisson_ratio: 0.3,
            porosity: 0.4,
            k_w_gpa: 2.2,
        }
    }
}

const MAX_REVERSALS: usize = 24;
/// Points of which powers are taken at once.
const AT_ONCE: usize = 64;
const TAU: usize = 0;
const SIGMA: usize = 1;
const GAMMA: usize = 2;
const GAMMA_MAX: usize = 3;
const G: usize = 4;
const M: usize = 5;
const GAMMA_REF: usize = 6;
const COUNT: usize = 7;
/// G_m and F: they change with the largest strain only, and their powers cost more than all else.
const SECANT: usize = 8;
const FACTOR: usize = 9;
const STACK: usize = 10;
const ATMOSPHERE_PA: f64 = 101_325.0;

/// The branch of the loops that a point is on.
#[derive(Clone, Copy)]
struct Branch {
    /// Largest strain so far, and what (3) and (4) make of it.
    gamma_max: f64,
    secant: f64,
    factor: f64,
    /// Reversals that are open.
    count: usize,
    /// [γ, τ] at the last of them, and γ at the one before; nothing where there is none.
    last: [f64; 2],
    before: f64,
}

impl Hyperbolic {
    fn confinement(point: &Point) -> f64 {
        point.mean_pa().max(1e3) / ATMOSPHERE_PA
    }

    fn reference_strain(&self, point: &Point) -> f64 {
        let percent =
            (0.0352 + 0.0010 * self.plasticity_index * self.ocr.powf(0.3246)) * Self::confinement(point).powf(0.3483); // (5)
        self.gamma_ref.unwrap_or(percent / 100.0) * self.gamma_ref_multiplier
    }

    /// (G_m, F) of (3) and (4) where the largest strain so far is `gamma_max`.
    fn reduction(&self, g: f64, gamma_ref: f64, gamma_max: f64) -> (f64, f64) {
        let ratio = 1.0 / (1.0 + (gamma_max / gamma_ref).powf(self.curvature));
        let f = if self.reduce_damping { (0.6329 - 0.0057 * self.cycles.ln()) * ratio.powf(0.1) } else { 1.0 };
        (g * ratio, self.hysteresis_multiplier * f)
    }

    /// The branch on which the strain `gamma` lies that follows [γ, τ] `from` on `branch`, where the reversals so far are `reversals`.
    fn follow(
        &self,
        branch: Branch,
        from: [f64; 2],
        gamma: f64,
        [g, gamma_ref]: [f64; 2],
        reversals: &[f64],
    ) -> Branch {
        let mut new = branch;
        let at = |i: usize| [reversals[2 * i], reversals[2 * i + 1]];
        // The present branch runs away from its last reversal; on the backbone, away from zero.
        let turns = (gamma - from[0]) * (from[0] - new.last[0]) < 0.0;
        if turns && new.count == MAX_REVERSALS {
            // No room for another reversal: it is gone back along the branch, and beyond its beginning along the one before.
            if (gamma - new.last[0]) * (from[0] - new.last[0]) < 0.0 {
                new.count -= 1;
                (new.last, new.before) = (at(new.count - 1), at(new.count - 2)[0]);
            }
        } else if turns {
            if new.count == 0 {
                new.gamma_max = from[0].abs();
                (new.secant, new.factor) = self.reduction(g, gamma_ref, new.gamma_max);
            }
            new.count += 1;
            new.last = from;
            new.before = if new.count > 1 { at(new.count - 2)[0] } else { 0.0 };
        }
        // Loops that this increment closes are forgotten: the branch before the last reversal began at the one before.
        while new.count >= 2 && (gamma - new.before) * (new.before - new.last[0]) > 0.0 {
            new.count -= 2;
            new.last = if new.count > 0 { at(new.count - 1) } else { [0.0; 2] };
            new.before = if new.count > 1 { at(new.count - 2)[0] } else { 0.0 };
        }
        if new.count > 0 && gamma.abs() > new.gamma_max {
            (new.count, new.last, new.before) = (0, [0.0; 2], 0.0);
        }
        new
    }

    /// Where an increment leads: the present branch in the memory `s` of a point, and the strain at which (1) is taken there.
    fn turn(&self, increment: Increment, committed: &[f64], s: &mut [f64]) -> f64 {
        let count = committed[COUNT] as usize;
        let reversals = &committed[STACK..];
        s[..STACK + 2 * count].copy_from_slice(&committed[..STACK + 2 * count]);
        let gamma = s[GAMMA] + increment.gamma;
        s[SIGMA] += s[M] * increment.eps_yy;
        let old = Branch {
            gamma_max: s[GAMMA_MAX],
            secant: s[SECANT],
            factor: s[FACTOR],
            count,
            last: if count > 0 { [reversals[2 * count - 2], reversals[2 * count - 1]] } else { [0.0; 2] },
            before: if count > 1 { reversals[2 * count - 4] } else { 0.0 },
        };
        let new = self.follow(old, [s[GAMMA], s[TAU]], gamma, [s[G], s[GAMMA_REF]], reversals);
        (s[GAMMA_MAX], s[SECANT], s[FACTOR]) = (new.gamma_max, new.secant, new.factor);
        if new.count > 0 {
            let last = STACK + 2 * (new.count - 1);
            s[last..last + 2].copy_from_slice(&new.last);
        }
        s[GAMMA] = gamma;
        s[COUNT] = new.count as f64;
        if new.count == 0 { gamma } else { 0.5 * (gamma - new.last[0]) }
    }

    /// Response of a point where (1) is taken at the strain `at` and `y` is |γ/γ_r|^s there.
    fn respond(&self, s: &mut [f64], at: f64, y: f64) -> Result<Response, Refusal> {
        let d = 1.0 / (1.0 + y);
        let mut tau = s[G] * at * d; // (1)
        let mut slope = s[G] * d * (1.0 - self.curvature * y * d);
        let count = s[COUNT] as usize;
        if count > 0 {
            let (secant, f, tau_a) = (s[SECANT], s[FACTOR], s[STACK + 2 * (count - 1) + 1]);
            let x = 2.0 * at;
            tau = tau_a + f * (2.0 * tau - secant * x) + secant * x; // (2)
            slope = f * (slope - secant) + secant;
        }
        if !(tau.is_finite() && s[GAMMA].is_finite()) {
            return Err(Refusal::NotFinite);
        }
        s[TAU] = tau;
        Ok(Response { tau_pa: tau, sigma_yy_pa: s[SIGMA], tangent_pa: [slope, 0.0, 0.0, s[M]] })
    }
}

impl Law for Hyperbolic {
    fn n_state(&self) -> usize {
        STACK + 2 * MAX_REVERSALS
    }

    fn start(&self, point: &Point, state: &mut [f64]) -> Result<[f64; 4]> {
        let g = point.shear_modulus_pa();
        let nu = self.poisson_ratio;
        state.fill(0.0);
        state[SIGMA] = -point.vertical_pa;
        state[G] = g;
        state[M] = 2.0 * g * (1.0 - nu) / (1.0 - 2.0 * nu);
        state[GAMMA_REF] = self.reference_strain(point);
        Ok([g, 0.0, 0.0, state[M]])
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        update_alone(self, increment, committed, trial)
    }

    fn update_all(
        &self,
        increments: &[Increment],
        committed: &[f64],
        trial: &mut [f64],
        responses: &mut [Response],
    ) -> Result<(), (usize, Refusal)> {
        let n = self.n_state();
        // Powers cost more than all else, and are taken of many points at once.
        let (mut at, mut y) = ([0.0; AT_ONCE], [0.0; AT_ONCE]);
        for first in (0..increments.len()).step_by(AT_ONCE) {
            let count = AT_ONCE.min(increments.len() - first);
            for k in 0..count {
                let own = (first + k) * n..(first + k + 1) * n;
                let s = &mut trial[own.clone()];
                at[k] = self.turn(increments[first + k], &committed[own], s);
                y[k] = at[k].abs() / s[GAMMA_REF];
            }
            raise(&mut y[..count], self.curvature);
            for k in 0..count {
                let i = first + k;
                responses[i] = self.respond(&mut trial[i * n..(i + 1) * n], at[k], y[k]).map_err(|e| (i, e))?;
            }
        }
        Ok(())
    }

    fn batch<'l>(&'l self, start: &'l [f64], _: &[Response], width: Width) -> Option<Box<dyn Batch + 'l>> {
        Some(Box::new(batch::Points::new(self, start, width)))
    }

    fn couples(&self) -> bool {
        false
    }

    fn pore_stiffness_pa(&self) -> f64 {
        self.k_w_gpa * GPA / self.porosity
    }

    fn damping(&self, point: &Point) -> Damping {
        let percent =
            (0.8005 + 0.0129 * self.plasticity_index * self.ocr.powf(-0.1069)) * Self::confinement(point).powf(-0.2889); // (6)
        let ratio = self.damping_ratio.unwrap_or(percent / 100.0) * self.damping_multiplier;
        Damping::Memory { ratio, exponent: self.damping_exponent }
    }
}
