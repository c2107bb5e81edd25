//! The equations of a place, or of several at once, each once, with its derivative beside it: [`super::rows`] takes them row by
//! row, [`super::tangent_rows`] the derivatives row by row, and [`super::tangent_linear`] field by field; [`super::adjoint_lines`]
//! and [`super::adjoint`] have their transposes. [`super::tangent_lanes`] has the lines of the derivatives in one pass, for a group
//! of columns at once.

use super::{ShallowWater, VectorInvariant};
use crate::arithmetic::Number;
use crate::places::Places;
use crate::stored::Stored;
use pulp::Simd;

/// Numbers of the equations.
#[derive(Clone, Copy)]
pub(super) struct Constants<N = f64> {
    /// g \[m s⁻²\].
    pub gravity: N,
    /// 1/dx \[m⁻¹\].
    per_dx: N,
    /// 1/dy \[m⁻¹\].
    per_dy: N,
}

/// The diagnostic quantities of a place.
pub(super) struct Diagnosed<N> {
    /// U at the western face \[m² s⁻¹\].
    pub mass_flux_x: N,
    /// V at the southern face \[m² s⁻¹\].
    pub mass_flux_y: N,
    /// q at the south-western corner \[m⁻¹ s⁻¹\].
    pub potential_vorticity: N,
    /// B at the centre of the place south-west of it \[m² s⁻²\].
    pub bernoulli: N,
}

/// U = h̄ˣ u, V = h̄ʸ v: of the thickness on either side of a face and the wind through it.
#[inline(always)]
pub(super) fn mass_flux<N: Number>(h: [N; 2], wind: N) -> N {
    (h[0] + h[1]).times(0.5) * wind
}

/// δU = h̄ˣ δu + (u/2) (δh + δh\[W\]), and δV.
#[inline(always)]
pub(super) fn mass_flux_tl<N: Number>(thickness: N, half_wind: N, h_sum: N, wind: N) -> N {
    wind * thickness + h_sum * half_wind
}

/// q = (f + ζ) / h̄ˣʸ, of the sum of the thickness around the corner.
#[inline(always)]
pub(super) fn potential_vorticity<N: Number>(coriolis: N, vorticity: N, h_sum: N) -> N {
    (coriolis + vorticity).times(4.0) / h_sum
}

/// δq = δζ / h̄ˣʸ − q / (4 h̄ˣʸ) Σ δh.
#[inline(always)]
pub(super) fn potential_vorticity_tl<N: Number>(per_thickness: N, quarter_q: N, vorticity: N, h_sum: N) -> N {
    vorticity * per_thickness - h_sum * quarter_q
}

impl<N: Stored> Constants<N> {
    /// Those of a model.
    pub fn new(model: &ShallowWater) -> Self {
        let grid = &model.layout.grid;
        let [gravity, per_dx, per_dy] =
            [model.parameters.gravity_m_per_s2, 1.0 / grid.dx_m, 1.0 / grid.dy_m].map(N::narrow);
        Self { gravity, per_dx, per_dy }
    }

    /// g, 1/dx and 1/dy in all lanes of vectors.
    #[inline(always)]
    pub fn splat<S: Simd>(self, simd: S) -> [N::Vector<S>; 3] {
        [self.gravity, self.per_dx, self.per_dy].map(|value| N::splat(simd, value))
    }

    /// The same at several places.
    #[inline(always)]
    pub fn at<P: Places<N>>(self, places: P) -> Constants<P::Number> {
        Constants {
            gravity: places.all(self.gravity),
            per_dx: places.all(self.per_dx),
            per_dy: places.all(self.per_dy),
        }
    }
}

impl<N: Number> Constants<N> {
    /// ζ = δx v/dx − δy u/dy of u, u\[S\] and v, v\[W\]; δζ likewise.
    #[inline(always)]
    pub fn vorticity(self, [u, u_s]: [N; 2], [v, v_w]: [N; 2]) -> N {
        (v - v_w) * self.per_dx - (u - u_s) * self.per_dy
    }

    /// δB = g δh + mean_x(u δu) + mean_y(v δv), of u/2 and v/2.
    #[inline(always)]
    pub fn bernoulli_tl(self, half_u: [N; 2], half_v: [N; 2], h: N, u: [N; 2], v: [N; 2]) -> N {
        let kinetic_x = u[0] * half_u[0] + u[1] * half_u[1];
        let kinetic_y = v[0] * half_v[0] + v[1] * half_v[1];
        h * self.gravity + (kinetic_x + kinetic_y)
    }

    /// −δx U/dx − δy V/dy of U, U\[E\] and V, V\[N\].
    #[inline(always)]
    pub fn minus_divergence(self, [flux_x, flux_x_e]: [N; 2], [flux_y, flux_y_n]: [N; 2]) -> N {
        (flux_x - flux_x_e) * self.per_dx + (flux_y - flux_y_n) * self.per_dy
    }

    /// −δx B/dx of B\[W\], B.
    #[inline(always)]
    pub fn minus_gradient_x(self, b_w: N, b: N) -> N {
        (b_w - b) * self.per_dx
    }

    /// −δy B/dy of B\[S\], B.
    #[inline(always)]
    pub fn minus_gradient_y(self, b_s: N, b: N) -> N {
        (b_s - b) * self.per_dy
    }

    /// B = g h + mean_x(u²)/2 + mean_y(v²)/2 of u, u\[E\] and v, v\[N\].
    #[inline(always)]
    pub fn bernoulli(self, h: N, [u, u_e]: [N; 2], [v, v_n]: [N; 2]) -> N {
        self.gravity * h + (u * u + u_e * u_e + v * v + v_n * v_n).times(0.25)
    }

    /// All diagnostic quantities: of h, h\[W\], h\[S\], h\[SW\], of u, u\[S\], u\[SW\] and of v, v\[W\], v\[SW\].
    #[inline(always)]
    pub fn place(
        self,
        coriolis: N,
        [h, h_w, h_s, h_sw]: [N; 4],
        [u, u_s, u_sw]: [N; 3],
        [v, v_w, v_sw]: [N; 3],
    ) -> Diagnosed<N> {
        let vorticity = self.vorticity([u, u_s], [v, v_w]);
        Diagnosed {
            mass_flux_x: mass_flux([h, h_w], u),
            mass_flux_y: mass_flux([h, h_s], v),
            potential_vorticity: potential_vorticity(coriolis, vorticity, h + h_w + h_s + h_sw),
            bernoulli: self.bernoulli(h_sw, [u_sw, u_s], [v_sw, v_w]),
        }
    }
}

impl VectorInvariant {
    /// q V in ∂u/∂t: q̄ʸ V̄ˣʸ or mean_y(q V̄ˣ), of q, q\[N\] and V, V\[W\], V\[N\], V\[NW\].
    #[inline(always)]
    pub(super) fn q_v<N: Number>(self, [q, q_n]: [N; 2], [v, v_w, v_n, v_nw]: [N; 4]) -> N {
        match self {
            VectorInvariant::PotentialEnstrophy => (q + q_n).times(0.125) * (v + v_w + v_n + v_nw),
            VectorInvariant::Energy => (q * (v + v_w) + q_n * (v_n + v_nw)).times(0.25),
        }
    }

    /// q U in −∂v/∂t: q̄ˣ Ūˣʸ or mean_x(q Ūʸ), of q, q\[E\] and U, U\[E\], U\[S\], U\[SE\].
    #[inline(always)]
    pub(super) fn q_u<N: Number>(self, [q, q_e]: [N; 2], [u, u_e, u_s, u_se]: [N; 4]) -> N {
        match self {
            VectorInvariant::PotentialEnstrophy => (q + q_e).times(0.125) * (u + u_e + u_s + u_se),
            VectorInvariant::Energy => (q * (u + u_s) + q_e * (u_e + u_se)).times(0.25),
        }
    }
}

/// The derivative of the vorticity term at a face, between the corners at its ends.
#[derive(Clone, Copy)]
pub(super) struct VorticityWeights<N> {
    /// With respect to q at either corner.
    pub of_q: [N; 2],
    /// With respect to the two fluxes beside either corner.
    pub of_flux: [N; 2],
}

impl<N: Number> VorticityWeights<N> {
    /// δ(q V) of δq at either corner and the sum of the δV beside either corner, or δ(q U).
    #[inline(always)]
    pub fn apply(self, q: [N; 2], flux: [N; 2]) -> N {
        (q[0] * self.of_q[0] + q[1] * self.of_q[1]) + (flux[0] * self.of_flux[0] + flux[1] * self.of_flux[1])
    }
}
