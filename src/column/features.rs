//! What a plain layered column on a rigid base does not have. Effects declare it; nothing of it is the default.

use crate::soil::{Law, Rate, Scaled, Scaling, Slider, Softening, Viscoelastic};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Boundaries and soil behaviour beyond layers on a rigid base; the default changes no bit of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Features {
    /// Impedance ratio q of the deepest layer over the half-space below; 0 is a rigid base.
    pub base_impedance_ratio: f64,
    /// Corner of the coherence of up-going and down-going wave at the input sensor, Hz; 0 is no corner: they interfere wholly.
    pub downgoing_corner_hz: f64,
    /// A structure on the surface.
    pub structure: Structure,
    /// Interfaces that slip.
    pub slips: Vec<Slip>,
    /// A container around the column.
    pub container: Container,
    /// Softening by pore pressure that the laws do not compute.
    pub softenings: Vec<SofteningZone>,
    /// Strength that grows with the strain rate.
    pub rates: Vec<RateZone>,
    /// Boundaries between layers that lie elsewhere than declared.
    pub boundaries: Vec<MovedBoundary>,
}

impl Features {
    /// Where a declared depth lies, m: with its boundary, where there is one that has moved.
    pub(crate) fn depth_m(&self, declared_m: f64) -> f64 {
        let own = self.boundaries.iter().filter(|b| (b.declared_m - declared_m).abs() <= MovedBoundary::NEAR_M);
        declared_m + own.map(|b| b.offset_m).sum::<f64>()
    }
}

/// A boundary between layers that lies elsewhere than declared; the layers of a profile are where they are, not where they were declared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MovedBoundary {
    /// Declared depth, m.
    pub declared_m: f64,
    /// How much deeper it lies, m.
    pub offset_m: f64,
}

impl MovedBoundary {
    /// A depth this close to a boundary is that of the boundary, m: thinner layers are not made.
    pub(crate) const NEAR_M: f64 = 0.02;
}

/// A single-degree-of-freedom structure standing on the surface.
///
/// ```text
/// m (ü_s) + c (u̇_s − u̇_0) + k (u_s − u_0) = 0,   k = m ω_s²,  c = 2 ζ m ω_s              (1)
/// traction on the surface  c (u̇_s − u̇_0) + k (u_s − u_0);   weight m g in the geostatic state   (2)
/// ```
///
/// Limits: as wide as the site, so its weight and inertia do not spread with depth; no rocking.
/// Check: `tests/verification/boundaries.rs`: exact transfer function with the oscillator.
/// Source: the boundary condition τ(0) = −m ω² T(ω) U(0), T the transmissibility of (1).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Structure {
    /// Mass per area m, kg/m²; 0 is none.
    pub mass_kg_m2: f64,
    /// Fixed-base frequency ω_s/2π, Hz.
    pub frequency_hz: f64,
    /// Damping ratio ζ.
    pub damping_ratio: f64,
}

/// An interface whose shear stress is capped; see [`Slider`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Slip {
    /// Depth, m: the element that holds it slips.
    pub depth_m: f64,
    /// Largest shear stress, Pa.
    pub tau_max_pa: f64,
}

/// A laminar container that moves with the soil.
///
/// ```text
/// ρ → ρ + m_c/H in horizontal motion (no weight),   τ → τ + k_c γ                           (1)
/// ```
///
/// Limits: one mass and one stiffness over the whole depth H; no friction between the rings. Rayleigh damping counts
/// the container's mass, not its stiffness.
/// Check: `tests/verification/boundaries.rs`: exact transfer function with (1).
/// Source: Fiegel, Hudson, Idriss, Kutter & Zeng (1994), Centrifuge 94, on containers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Container {
    /// Mass per plan area m_c, kg/m².
    pub mass_kg_m2: f64,
    /// Shear stiffness in parallel k_c, Pa.
    pub stiffness_pa: f64,
}

/// [`Softening`] of the elements whose centre lies in a depth range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SofteningZone {
    /// Top of the range, m.
    pub top_m: f64,
    /// Bottom of the range, m.
    pub bottom_m: f64,
    /// Pore pressure ratio after the reference stress path.
    pub ru_at_reference: f64,
    /// Exponent of the growth with the motion.
    pub exponent: f64,
}

/// [`Rate`] dependence of the elements whose centre lies in a depth range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RateZone {
    /// Top of the range, m.
    pub top_m: f64,
    /// Bottom of the range, m.
    pub bottom_m: f64,
    /// Only elements of this law, where given.
    #[serde(default)]
    pub law_kind: Option<String>,
    /// Gain of strength per tenfold rate.
    pub per_log_cycle: f64,
}

/// What is around the law of one element.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Around {
    softenings: Vec<Softening>,
    rates: Vec<Rate>,
    tau_max_pa: Option<f64>,
}

impl Features {
    /// What is around the law `kind` of the element between two depths.
    pub(super) fn around(&self, kind: &str, top_m: f64, bottom_m: f64) -> Around {
        let centre_m = 0.5 * (top_m + bottom_m);
        let is_in = |top: f64, bottom: f64| (top..bottom).contains(&centre_m);
        let softenings = self.softenings.iter().filter(|z| z.ru_at_reference > 0.0 && is_in(z.top_m, z.bottom_m));
        let rates = self.rates.iter().filter(|z| {
            z.per_log_cycle > 0.0 && is_in(z.top_m, z.bottom_m) && z.law_kind.as_deref().is_none_or(|k| k == kind)
        });
        let slips = self.slips.iter().filter(|s| (top_m..bottom_m).contains(&s.depth_m));
        Around {
            softenings: softenings
                .map(|z| Softening { ru_at_reference: z.ru_at_reference, exponent: z.exponent })
                .collect(),
            rates: rates.map(|z| Rate { per_log_cycle: z.per_log_cycle }).collect(),
            tau_max_pa: slips.map(|s| s.tau_max_pa).reduce(f64::min),
        }
    }

    /// What is out of range, as (key, sentence).
    pub(super) fn problems(&self, depth_m: f64) -> Vec<(String, String)> {
        let mut problems = Vec::new();
        let mut check = |key: String, value: f64, unit: &str, low: f64, high: f64| {
            if !(value >= low && value <= high) {
                problems.push((key, format!("must be in {low}…{high}{unit}, got {value}")));
            }
        };
        check("features.base_impedance_ratio".into(), self.base_impedance_ratio, "", 0.0, 10.0);
        check("features.downgoing_corner_hz".into(), self.downgoing_corner_hz, " Hz", 0.0, f64::INFINITY);
        check("features.structure.mass_kg_m2".into(), self.structure.mass_kg_m2, " kg/m²", 0.0, 1e6);
        if self.structure.mass_kg_m2 > 0.0 {
            check("features.structure.frequency_hz".into(), self.structure.frequency_hz, " Hz", 0.05, 100.0);
            check("features.structure.damping_ratio".into(), self.structure.damping_ratio, "", 0.0, 1.0);
        }
        for (i, slip) in self.slips.iter().enumerate() {
            check(format!("features.slips[{}].depth_m", i + 1), slip.depth_m, " m", 0.0, depth_m);
            check(format!("features.slips[{}].tau_max_pa", i + 1), slip.tau_max_pa, " Pa", 1.0, 1e9);
        }
        check("features.container.mass_kg_m2".into(), self.container.mass_kg_m2, " kg/m²", 0.0, 1e6);
        check("features.container.stiffness_pa".into(), self.container.stiffness_pa, " Pa", 0.0, 1e9);
        for (i, zone) in self.softenings.iter().enumerate() {
            check(format!("features.softenings[{}].ru_at_reference", i + 1), zone.ru_at_reference, "", 0.0, 10.0);
            check(format!("features.softenings[{}].exponent", i + 1), zone.exponent, "", 0.5, 4.0);
        }
        for (i, zone) in self.rates.iter().enumerate() {
            check(format!("features.rates[{}].per_log_cycle", i + 1), zone.per_log_cycle, "", 0.0, 0.5);
        }
        problems
    }
}

impl Around {
    /// `law` with everything around it, and with the small-strain damping it asks for where it `is_lossy`: the relaxation
    /// sees the stress after softening and before the slider, which carries what is damped, too.
    pub fn dress(&self, law: Box<dyn Law>, is_lossy: bool) -> Box<dyn Law> {
        let mut scalings: Vec<Box<dyn Scaling>> = Vec::new();
        scalings.extend(self.softenings.iter().map(|s| Box::new(*s) as Box<dyn Scaling>));
        scalings.extend(self.rates.iter().map(|r| Box::new(*r) as Box<dyn Scaling>));
        let law: Box<dyn Law> = if scalings.is_empty() { law } else { Box::new(Scaled::new(law, scalings)) };
        let law: Box<dyn Law> = if is_lossy { Box::new(Viscoelastic::new(law)) } else { law };
        match self.tau_max_pa {
            Some(tau_max_pa) => Box::new(Slider::new(law, tau_max_pa)),
            None => law,
        }
    }

    /// Whether the element slips; its viscous damping would carry what the slider does not.
    pub fn slips(&self) -> bool {
        self.tau_max_pa.is_some()
    }
}
