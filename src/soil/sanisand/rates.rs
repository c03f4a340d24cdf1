//! Everything equations (2)–(10) need at one state, for several points side by side.

use super::Sanisand;
use crate::numerics::lanes::Lane;
use crate::units::KPA;

/// Deviator of plane strain: xx, yy, xy; zz = −xx − yy.
pub(super) type Deviator<L> = [L; 3];

/// a : b.
#[inline(always)]
pub(super) fn dot<L: Lane>(a: Deviator<L>, b: Deviator<L>) -> L {
    a[0] * b[0] + a[1] * b[1] + (a[0] + a[1]) * (b[0] + b[1]) + (a[2] * b[2] + a[2] * b[2])
}

/// a + c·b.
#[inline(always)]
pub(super) fn add<L: Lane>(a: Deviator<L>, c: L, b: Deviator<L>) -> Deviator<L> {
    [a[0] + c * b[0], a[1] + c * b[1], a[2] + c * b[2]]
}

/// Memory of several points.
#[derive(Clone, Copy)]
pub(super) struct State<L> {
    pub s: Deviator<L>,
    pub p: L,
    pub alpha: Deviator<L>,
    pub z: Deviator<L>,
    pub alpha_in: Deviator<L>,
    pub e: L,
    pub g_0: L,
}

/// Parameters in the form the kernel uses.
pub(super) struct Constants {
    pub p_a: f64,
    pub p_t: f64,
    pub k_per_g: f64,
    /// What (2) subtracts from p̄.
    pub stiffness_shift: f64,
    pub yield_radius: f64,
    pub reset_on_reversal: bool,
    pub tolerance: f64,
    pub max_substeps: u32,
    e_0: f64,
    lambda_c: f64,
    xi: f64,
    c: f64,
    m_c: f64,
    m: f64,
    h_0: f64,
    c_h: f64,
    n_b: f64,
    n_d: f64,
    a_0: f64,
    contraction: f64,
    pub z_max: f64,
    pub c_z: f64,
}

impl Constants {
    pub fn new(law: &Sanisand) -> Self {
        let p_a = law.p_a_kpa * KPA;
        Self {
            p_a,
            p_t: law.p_t_over_p_a * p_a,
            k_per_g: 2.0 * (1.0 + law.nu) / (3.0 * (1.0 - 2.0 * law.nu)),
            stiffness_shift: if law.p_t_in_moduli { 0.0 } else { law.p_t_over_p_a * p_a },
            reset_on_reversal: law.reset_on_reversal,
            yield_radius: (2.0_f64 / 3.0).sqrt() * law.m,
            tolerance: law.tolerance,
            max_substeps: law.max_substeps,
            e_0: law.e_0,
            lambda_c: law.lambda_c,
            xi: law.xi,
            c: law.m_e / law.m_c,
            m_c: law.m_c,
            m: law.m,
            h_0: law.h_0,
            c_h: law.c_h,
            n_b: law.n_b,
            n_d: law.n_d,
            a_0: law.a_0,
            contraction: law.contraction_multiplier,
            z_max: law.z_max,
            c_z: law.c_z,
        }
    }

    /// G/√p̄, constant while the void ratio is.
    #[inline(always)]
    pub fn stiffness<L: Lane>(&self, g_0: L, e: L) -> L {
        let d = L::splat(2.97) - e;
        g_0 * L::splat(self.p_a.sqrt()) * d * d / (L::splat(1.0) + e)
    }
}

/// The rates at one state: a strain increment makes them stress.
#[derive(Clone, Copy)]
pub(super) struct Rates<L> {
    /// Shear and bulk modulus.
    pub g: L,
    pub k: L,
    /// Loading direction and n : r.
    pub n: Deviator<L>,
    pub n_r: L,
    /// Deviatoric flow direction and dilatancy.
    pub flow: Deviator<L>,
    pub d: L,
    /// (α − α_in) : n, not negative.
    pub x: L,
    /// The denominator of (10) times x.
    pub denominator: L,
    /// ⅔ b₀ (α^b − α).
    pub back: Deviator<L>,
    /// ⅔ b₀ √⅔ (g M_c e^{−n_b Ψ} − m): the share of `back` along n.
    pub reach: L,
}

impl<L: Lane> Rates<L> {
    /// The rates at `s`, with α_in moved to α where the loading direction has turned (told by the second value).
    #[inline(always)]
    pub fn at(c: &Constants, s: &State<L>) -> (Self, L::Mask) {
        let one = L::splat(1.0);
        let zero = L::splat(0.0);
        let p = s.p.max(L::splat(1e-6 * c.p_a));
        let inv_p = one / p;
        let r = [s.s[0] * inv_p, s.s[1] * inv_p, s.s[2] * inv_p];
        let away = add(r, L::splat(-1.0), s.alpha);
        let inv_norm = one / dot(away, away).sqrt().max(L::splat(1e-14));
        let n = [away[0] * inv_norm, away[1] * inv_norm, away[2] * inv_norm]; // (3)

        let p_ratio = p * L::splat(1.0 / c.p_a);
        let root = p_ratio.sqrt();
        let g = c.stiffness(s.g_0, s.e) * (p - L::splat(c.stiffness_shift)).max(L::splat(1e-6 * c.p_a)).sqrt(); // (2)
        let k = g * L::splat(c.k_per_g);
        let psi = s.e - L::splat(c.e_0) + L::splat(c.lambda_c) * (p_ratio.ln() * L::splat(c.xi)).exp();

        let n_zz = -(n[0] + n[1]);
        let trace_n3 = L::splat(3.0) * n_zz * (n[0] * n[1] - n[2] * n[2]);
        let cos3 = (L::splat(6.0_f64.sqrt()) * trace_n3).max(L::splat(-1.0)).min(one);
        let lode = L::splat(2.0 * c.c) / (L::splat(1.0 + c.c) - L::splat(1.0 - c.c) * cos3); // (4)
        let strength = lode * L::splat(c.m_c);
        let root23 = (2.0_f64 / 3.0).sqrt();
        let bound = L::splat(root23) * (strength * (psi * L::splat(-c.n_b)).exp() - L::splat(c.m)); // (5)
        let dilatant = L::splat(root23) * (strength * (psi * L::splat(c.n_d)).exp() - L::splat(c.m));
        let alpha_n = dot(s.alpha, n);

        let fabric = dot(s.z, n).max(zero);
        let full = L::splat(c.a_0) * (one + fabric) * (dilatant - alpha_n); // (7)
        let y = (p * L::splat(1.0 / c.p_t)).min(one);
        let faded = L::splat(c.contraction) * full * y * y * (L::splat(3.0) - (y + y));
        let d = L::select(L::lt(zero, full), faded, full);

        let shape = L::splat((1.0 - c.c) / c.c) * lode;
        let b = one + L::splat(1.5) * shape * cos3; // (9)
        let cc = L::splat(3.0 * 1.5_f64.sqrt()) * shape;
        let xy2 = n[2] * n[2];
        let third = L::splat(1.0 / 3.0);
        let flow = [
            b * n[0] - cc * (n[0] * n[0] + xy2 - third),
            b * n[1] - cc * (n[1] * n[1] + xy2 - third),
            b * n[2] - cc * (n[2] * (n[0] + n[1])),
        ];
        let n_r = dot(n, r);
        let turned = dot(add(s.alpha, L::splat(-1.0), s.alpha_in), n);
        let reversed = L::lt(turned, zero);
        let x = turned.max(zero);
        let b_0 = s.g_0 * L::splat(c.h_0) * (one - L::splat(c.c_h) * s.e) / root; // (6)
        let two_third_b0 = L::splat(2.0 / 3.0) * b_0;
        let resist = (g + g) * (b - cc * trace_n3) - k * d * n_r;
        let stiff = two_third_b0 * p * (bound - alpha_n) + x * resist; // (10) times x
        let floor = x * g * L::splat(0.02) + L::splat(1e-9) * g;
        let denominator = stiff.max(floor);
        let back = [
            two_third_b0 * (bound * n[0] - s.alpha[0]),
            two_third_b0 * (bound * n[1] - s.alpha[1]),
            two_third_b0 * (bound * n[2] - s.alpha[2]),
        ];
        (Self { g, k, n, n_r, flow, d, x, denominator, back, reach: two_third_b0 * bound }, reversed)
    }

    /// ⟨L⟩/x of (10) for a strain increment (deviator, volume; compression positive).
    #[inline(always)]
    pub fn multiplier_over_x(&self, de: Deviator<L>, dv: L) -> L {
        (((self.g + self.g) * dot(self.n, de) - self.k * self.n_r * dv) / self.denominator).max(L::splat(0.0))
    }

    /// ∂(τ, σ'_yy)/∂(γ, ε_yy), tension positive; elastic where `plastic` does not hold.
    #[inline(always)]
    pub fn tangent(&self, plastic: L::Mask) -> [L; 4] {
        let per = L::select(plastic, self.x / self.denominator, L::splat(0.0));
        let two_g = self.g + self.g;
        let l_gamma = per * (two_g * self.n[2]);
        let l_eps = per * (self.k * self.n_r - two_g * self.n[1]);
        let push = two_g * self.flow[1] + self.k * self.d;
        [
            self.g - two_g * l_gamma * self.flow[2],
            -(two_g * l_eps * self.flow[2]),
            l_gamma * push,
            L::splat(4.0 / 3.0) * self.g + self.k + l_eps * push,
        ]
    }
}
