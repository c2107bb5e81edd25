//! The tangent-linear tendency N'(x̄) δx of whole fields, for the start of leapfrog, with coefficients computed once for many
//! evaluations, which are also those of a linear model's rows. The lines are the derivatives in [`super::kernel`].
//!
//! ```text
//! δU = h̄ˣ δu + u mean_x(δh)                       δq = δζ / h̄ˣʸ − (q / h̄ˣʸ) mean_xy(δh)
//! δV = h̄ʸ δv + v mean_y(δh)                       δB = g δh + mean_x(u δu) + mean_y(v δv)
//! δ(∂u/∂t) =   mean_y(δq) V̄ˣʸ + q̄ʸ mean_xy(δV)  − δx δB/dx        (potential-enstrophy form)
//! δ(∂v/∂t) = −[mean_x(δq) Ūˣʸ + q̄ˣ mean_xy(δU)] − δy δB/dy
//! δ(∂u/∂t) =   mean_y(δq V̄ˣ + q mean_x(δV))       − δx δB/dx        (energy form)
//! δ(∂v/∂t) = −mean_x(δq Ūʸ + q mean_y(δU))        − δy δB/dy
//! ```
//!
//! The fields of x̄ in these lines are the [`Coefficients`].

use super::damping::add_damping;
use super::kernel::{self, Constants, VorticityWeights, mass_flux, mass_flux_tl, potential_vorticity_tl};
use super::row_coefficients::QUANTITIES;
use super::{ShallowWater, VectorInvariant, padded_fields};
use crate::grid::Location;
use crate::halo::Halo;

/// The coefficient fields of N'(x̄), padded, with the means' factors ½ and ¼ in them.
#[derive(Clone, Debug)]
pub struct Coefficients {
    /// h̄ˣ at x-faces.
    pub(super) thickness_x: Vec<f64>,
    /// h̄ʸ at y-faces.
    pub(super) thickness_y: Vec<f64>,
    /// u/2 at x-faces.
    pub(super) half_u: Vec<f64>,
    /// v/2 at y-faces.
    pub(super) half_v: Vec<f64>,
    /// 1 / h̄ˣʸ at corners.
    pub(super) per_thickness: Vec<f64>,
    /// q / (4 h̄ˣʸ) at corners.
    pub(super) quarter_q_per_thickness: Vec<f64>,
    /// Derivatives of the vorticity term.
    pub(super) vorticity_term: VorticityTerm,
}

/// Coefficients of the vorticity term, padded.
#[derive(Clone, Debug)]
pub(super) enum VorticityTerm {
    /// V̄ˣʸ/2 and q̄ʸ/4 at x-faces, Ūˣʸ/2 and q̄ˣ/4 at y-faces.
    PotentialEnstrophy { flux_y: Vec<f64>, q_x: Vec<f64>, flux_x: Vec<f64>, q_y: Vec<f64> },
    /// V̄ˣ/2, Ūʸ/2 and q/4, all at corners.
    Energy { flux_y: Vec<f64>, flux_x: Vec<f64>, q: Vec<f64> },
}

impl Coefficients {
    /// The coefficients at a state `[variable, y, x]`.
    pub(super) fn new(model: &ShallowWater, at: &[f64]) -> Self {
        let halo = &model.halo;
        let constants = Constants::new(model);
        let [mut h, mut u, mut v, mut mass_flux_x, mut mass_flux_y, mut q] = std::array::from_fn(|_| halo.zeros());
        load_all(model, at, [&mut h, &mut u, &mut v]);
        let (h0, h_w, h_s, h_sw) =
            (halo.core(&h), halo.shift(&h, 0, -1), halo.shift(&h, -1, 0), halo.shift(&h, -1, -1));
        let (u0, u_s, v0, v_w) = (halo.core(&u), halo.shift(&u, -1, 0), halo.core(&v), halo.shift(&v, 0, -1));
        let coriolis = halo.core(&model.coriolis);
        let (out_x, out_y, out_q) =
            (halo.core_mut(&mut mass_flux_x), halo.core_mut(&mut mass_flux_y), halo.core_mut(&mut q));
        for k in 0..halo.core_len() {
            let vorticity = constants.vorticity([u0[k], u_s[k]], [v0[k], v_w[k]]);
            out_x[k] = mass_flux([h0[k], h_w[k]], u0[k]);
            out_y[k] = mass_flux([h0[k], h_s[k]], v0[k]);
            out_q[k] = kernel::potential_vorticity(coriolis[k], vorticity, h0[k] + h_w[k] + h_s[k] + h_sw[k]);
        }
        let (q0, q_n, q_e) = (halo.core(&q), halo.shift(&q, 1, 0), halo.shift(&q, 0, 1));
        let flux_x = |rows, columns| halo.shift(&mass_flux_x, rows, columns);
        let flux_y = |rows, columns| halo.shift(&mass_flux_y, rows, columns);
        let vorticity_term = match model.form {
            VectorInvariant::PotentialEnstrophy => VorticityTerm::PotentialEnstrophy {
                flux_y: sum(halo, 0.125, [flux_y(0, 0), flux_y(0, -1), flux_y(1, 0), flux_y(1, -1)]),
                q_x: sum(halo, 0.125, [q0, q_n]),
                flux_x: sum(halo, 0.125, [flux_x(0, 0), flux_x(0, 1), flux_x(-1, 0), flux_x(-1, 1)]),
                q_y: sum(halo, 0.125, [q0, q_e]),
            },
            VectorInvariant::Energy => VorticityTerm::Energy {
                flux_y: sum(halo, 0.25, [flux_y(0, 0), flux_y(0, -1)]),
                flux_x: sum(halo, 0.25, [flux_x(0, 0), flux_x(-1, 0)]),
                q: sum(halo, 0.25, [q0]),
            },
        };
        let mut per_thickness = sum(halo, 1.0, [h0, h_w, h_s, h_sw]);
        let mut quarter_q_per_thickness = halo.zeros();
        let (per, quarter_q) = (halo.core_mut(&mut per_thickness), halo.core_mut(&mut quarter_q_per_thickness));
        let (n, q0) = (per.len(), &q0[..per.len()]);
        let quarter_q = &mut quarter_q[..n];
        for k in 0..n {
            (per[k], quarter_q[k]) = (4.0 / per[k], q0[k] / per[k]);
        }
        Self {
            thickness_x: sum(halo, 0.5, [h0, h_w]),
            thickness_y: sum(halo, 0.5, [h0, h_s]),
            half_u: sum(halo, 0.5, [halo.core(&u)]),
            half_v: sum(halo, 0.5, [halo.core(&v)]),
            per_thickness,
            quarter_q_per_thickness,
            vorticity_term,
        }
    }
}

impl Coefficients {
    /// The fields in the order of the quantities of [`super::row_coefficients`]; where the form has no such quantity, any field.
    pub(super) fn quantities(&self) -> [&[f64]; QUANTITIES] {
        let [a, b, c, d] = match &self.vorticity_term {
            VorticityTerm::PotentialEnstrophy { flux_y, q_x, flux_x, q_y } => [flux_y, q_x, flux_x, q_y],
            VorticityTerm::Energy { flux_y, flux_x, q } => [flux_y, q, flux_x, q],
        };
        let Self { thickness_x, thickness_y, half_u, half_v, per_thickness, quarter_q_per_thickness, .. } = self;
        [thickness_x, thickness_y, per_thickness, quarter_q_per_thickness, half_u, half_v, a, b, c, d]
            .map(|field| &field[..])
    }
}

/// A padded field: the terms' sum, in their order, times a factor.
#[inline(always)]
fn sum<const N: usize>(halo: &Halo, factor: f64, terms: [&[f64]; N]) -> Vec<f64> {
    let mut field = halo.zeros();
    let out = halo.core_mut(&mut field);
    let (n, mut own) = (out.len(), terms);
    for term in 0..N {
        own[term] = &terms[term][..n];
    }
    for k in 0..n {
        let mut value = own[0][k];
        for term in 1..N {
            value += own[term][k];
        }
        out[k] = factor * value;
    }
    field
}

/// `out` = N'(x̄) dx.
#[inline(always)]
pub(super) fn tendency_tl(model: &ShallowWater, at: &Coefficients, dx: &[f64], out: &mut [f64], scratch: &mut [f64]) {
    let halo = &model.halo;
    let [h, u, v, flux_x, flux_y, q, bernoulli] = padded_fields(halo, scratch);
    load_all(model, dx, [&mut *h, &mut *u, &mut *v]);
    mass_fluxes(model, at, h, u, v, flux_x, flux_y);
    potential_vorticity(model, at, h, u, v, q);
    bernoulli_function(model, at, h, u, v, bernoulli);
    let cells = model.layout.grid.cells();
    let (out_h, winds) = out.split_at_mut(cells);
    let (out_u, out_v) = winds.split_at_mut(cells);
    minus_divergence(model, flux_x, flux_y, out_h);
    minus_gradient(model, bernoulli, out_u, out_v);
    add_vorticity_term(model, &at.vorticity_term, flux_x, flux_y, q, out_u, out_v);
    add_damping(model, dx, out, scratch);
}

/// δU and δV.
#[inline(always)]
fn mass_fluxes(
    model: &ShallowWater,
    at: &Coefficients,
    h: &[f64],
    u: &[f64],
    v: &[f64],
    flux_x: &mut [f64],
    flux_y: &mut [f64],
) {
    let halo = &model.halo;
    let n = halo.core_len();
    let (h0, h_w, h_s) = (halo.core(h), halo.shift(h, 0, -1), halo.shift(h, -1, 0));
    let (u0, thickness, half_u) = (halo.core(u), halo.core(&at.thickness_x), halo.core(&at.half_u));
    let out = halo.core_mut(flux_x);
    for k in 0..n {
        out[k] = mass_flux_tl(thickness[k], half_u[k], h0[k] + h_w[k], u0[k]);
    }
    let (v0, thickness, half_v) = (halo.core(v), halo.core(&at.thickness_y), halo.core(&at.half_v));
    let out = halo.core_mut(flux_y);
    for k in 0..n {
        out[k] = mass_flux_tl(thickness[k], half_v[k], h0[k] + h_s[k], v0[k]);
    }
}

/// δq.
#[inline(always)]
fn potential_vorticity(model: &ShallowWater, at: &Coefficients, h: &[f64], u: &[f64], v: &[f64], q: &mut [f64]) {
    let halo = &model.halo;
    let constants = Constants::new(model);
    let (h0, h_w, h_s, h_sw) = (halo.core(h), halo.shift(h, 0, -1), halo.shift(h, -1, 0), halo.shift(h, -1, -1));
    let (u0, u_s, v0, v_w) = (halo.core(u), halo.shift(u, -1, 0), halo.core(v), halo.shift(v, 0, -1));
    let (per_thickness, quarter_q) = (halo.core(&at.per_thickness), halo.core(&at.quarter_q_per_thickness));
    let out = halo.core_mut(q);
    for k in 0..halo.core_len() {
        let vorticity = constants.vorticity([u0[k], u_s[k]], [v0[k], v_w[k]]);
        let h_sum = (h0[k] + h_w[k]) + (h_s[k] + h_sw[k]);
        out[k] = potential_vorticity_tl(per_thickness[k], quarter_q[k], vorticity, h_sum);
    }
}

/// δB.
#[inline(always)]
fn bernoulli_function(model: &ShallowWater, at: &Coefficients, h: &[f64], u: &[f64], v: &[f64], bernoulli: &mut [f64]) {
    let halo = &model.halo;
    let constants = Constants::new(model);
    let (h0, u0, u_e, v0, v_n) = (halo.core(h), halo.core(u), halo.shift(u, 0, 1), halo.core(v), halo.shift(v, 1, 0));
    let (half_u, half_u_e) = (halo.core(&at.half_u), halo.shift(&at.half_u, 0, 1));
    let (half_v, half_v_n) = (halo.core(&at.half_v), halo.shift(&at.half_v, 1, 0));
    let out = halo.core_mut(bernoulli);
    for k in 0..halo.core_len() {
        let (half_u, half_v) = ([half_u[k], half_u_e[k]], [half_v[k], half_v_n[k]]);
        out[k] = constants.bernoulli_tl(half_u, half_v, h0[k], [u0[k], u_e[k]], [v0[k], v_n[k]]);
    }
}

/// Adds the vorticity term's increment.
#[inline(always)]
fn add_vorticity_term(
    model: &ShallowWater,
    at: &VorticityTerm,
    flux_x: &[f64],
    flux_y: &[f64],
    q: &[f64],
    out_u: &mut [f64],
    out_v: &mut [f64],
) {
    let (halo, nx) = (&model.halo, model.halo.columns());
    let first_row = halo.first_row(Location::YFace);
    for (j, out) in out_u.chunks_exact_mut(nx).enumerate() {
        let row = |field, rows, columns| halo.row(field, j, rows, columns);
        let (q0, q_n) = (row(q, 0, 0), row(q, 1, 0));
        let (v, v_w, v_n, v_nw) = (row(flux_y, 0, 0), row(flux_y, 0, -1), row(flux_y, 1, 0), row(flux_y, 1, -1));
        match at {
            VorticityTerm::PotentialEnstrophy { flux_y, q_x, .. } => {
                let (mean_flux, mean_q) = (row(flux_y, 0, 0), row(q_x, 0, 0));
                for i in 0..nx {
                    let weights = VorticityWeights { of_q: [mean_flux[i]; 2], of_flux: [mean_q[i]; 2] };
                    out[i] += weights.apply([q0[i], q_n[i]], [v[i] + v_w[i], v_n[i] + v_nw[i]]);
                }
            }
            VorticityTerm::Energy { flux_y, q, .. } => {
                let (mean_flux, mean_flux_n) = (row(flux_y, 0, 0), row(flux_y, 1, 0));
                let (quarter_q, quarter_q_n) = (row(q, 0, 0), row(q, 1, 0));
                for i in 0..nx {
                    let (of_q, of_flux) = ([mean_flux[i], mean_flux_n[i]], [quarter_q[i], quarter_q_n[i]]);
                    let weights = VorticityWeights { of_q, of_flux };
                    out[i] += weights.apply([q0[i], q_n[i]], [v[i] + v_w[i], v_n[i] + v_nw[i]]);
                }
            }
        }
    }
    for (j, out) in out_v.chunks_exact_mut(nx).enumerate().skip(first_row) {
        let row = |field, rows, columns| halo.row(field, j, rows, columns);
        let (q0, q_e) = (row(q, 0, 0), row(q, 0, 1));
        let (u, u_e, u_s, u_se) = (row(flux_x, 0, 0), row(flux_x, 0, 1), row(flux_x, -1, 0), row(flux_x, -1, 1));
        match at {
            VorticityTerm::PotentialEnstrophy { flux_x, q_y, .. } => {
                let (mean_flux, mean_q) = (row(flux_x, 0, 0), row(q_y, 0, 0));
                for i in 0..nx {
                    let weights = VorticityWeights { of_q: [mean_flux[i]; 2], of_flux: [mean_q[i]; 2] };
                    out[i] -= weights.apply([q0[i], q_e[i]], [u[i] + u_s[i], u_e[i] + u_se[i]]);
                }
            }
            VorticityTerm::Energy { flux_x, q, .. } => {
                let (mean_flux, mean_flux_e) = (row(flux_x, 0, 0), row(flux_x, 0, 1));
                let (quarter_q, quarter_q_e) = (row(q, 0, 0), row(q, 0, 1));
                for i in 0..nx {
                    let (of_q, of_flux) = ([mean_flux[i], mean_flux_e[i]], [quarter_q[i], quarter_q_e[i]]);
                    let weights = VorticityWeights { of_q, of_flux };
                    out[i] -= weights.apply([q0[i], q_e[i]], [u[i] + u_s[i], u_e[i] + u_se[i]]);
                }
            }
        }
    }
}

/// `out_h` = −δx U/dx − δy V/dy.
#[inline(always)]
fn minus_divergence(model: &ShallowWater, flux_x: &[f64], flux_y: &[f64], out_h: &mut [f64]) {
    let (halo, constants) = (&model.halo, Constants::new(model));
    for (j, out) in out_h.chunks_exact_mut(halo.columns()).enumerate() {
        let (west, east) = (halo.row(flux_x, j, 0, 0), halo.row(flux_x, j, 0, 1));
        let (south, north) = (halo.row(flux_y, j, 0, 0), halo.row(flux_y, j, 1, 0));
        for i in 0..halo.columns() {
            out[i] = constants.minus_divergence([west[i], east[i]], [south[i], north[i]]);
        }
    }
}

/// `out_u` = −δx B/dx, `out_v` = −δy B/dy, but zero at walls.
#[inline(always)]
fn minus_gradient(model: &ShallowWater, bernoulli: &[f64], out_u: &mut [f64], out_v: &mut [f64]) {
    let (halo, constants) = (&model.halo, Constants::new(model));
    let walls = halo.first_row(Location::YFace);
    out_v[..walls * halo.columns()].fill(0.0);
    let rows = out_u.chunks_exact_mut(halo.columns()).zip(out_v.chunks_exact_mut(halo.columns()));
    for (j, (out_u, out_v)) in rows.enumerate() {
        let b = halo.row(bernoulli, j, 0, 0);
        let (west, south) = (halo.row(bernoulli, j, 0, -1), halo.row(bernoulli, j, -1, 0));
        for i in 0..halo.columns() {
            out_u[i] = constants.minus_gradient_x(west[i], b[i]);
        }
        if j >= walls {
            for i in 0..halo.columns() {
                out_v[i] = constants.minus_gradient_y(south[i], b[i]);
            }
        }
    }
}

/// Pads the three fields under their boundary conditions.
#[inline(always)]
pub(super) fn load_all(model: &ShallowWater, x: &[f64], padded: [&mut [f64]; 3]) {
    let locations = [Location::Center, Location::XFace, Location::YFace];
    for ((field, padded), location) in model.fields(x).into_iter().zip(padded).zip(locations) {
        model.halo.load(location, field, padded);
    }
}
