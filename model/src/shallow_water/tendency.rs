//! The nonlinear tendency N(x), and the damping terms, which are linear and symmetric: the tangent-linear and the
//! adjoint use the same ones.

use super::{H, ShallowWater, U, V, VectorInvariant, padded_fields};
use crate::grid::Location;
use crate::halo::Halo;

/// Mass fluxes, potential vorticity and Bernoulli function of a state, padded.
pub(super) struct Diagnostics<'a> {
    /// U = h̄ˣ u at x-faces \[m² s⁻¹\].
    pub mass_flux_x: &'a mut [f64],
    /// V = h̄ʸ v at y-faces \[m² s⁻¹\].
    pub mass_flux_y: &'a mut [f64],
    /// q at corners \[m⁻¹ s⁻¹\].
    pub potential_vorticity: &'a mut [f64],
    /// B at centres \[m² s⁻²\].
    pub bernoulli: &'a mut [f64],
}

/// `out` = N(x).
#[inline(always)]
pub(super) fn tendency(model: &ShallowWater, x: &[f64], out: &mut [f64], scratch: &mut [f64]) {
    let halo = &model.halo;
    let [h, u, v, mass_flux_x, mass_flux_y, potential_vorticity, bernoulli] = padded_fields(halo, scratch);
    load_all(model, x, [&mut *h, &mut *u, &mut *v]);
    let mut d = Diagnostics { mass_flux_x, mass_flux_y, potential_vorticity, bernoulli };
    diagnose(model, h, u, v, &mut d);
    let cells = model.layout.grid.cells();
    let (out_h, winds) = out.split_at_mut(cells);
    let (out_u, out_v) = winds.split_at_mut(cells);
    minus_divergence(model, d.mass_flux_x, d.mass_flux_y, out_h);
    minus_gradient(model, d.bernoulli, out_u, out_v);
    add_vorticity_term(model, &d, out_u, out_v);
    add_damping(model, x, out, scratch);
}

/// Mass fluxes, potential vorticity and Bernoulli function from the padded h, u and v.
#[inline(always)]
pub(super) fn diagnose(model: &ShallowWater, h: &[f64], u: &[f64], v: &[f64], d: &mut Diagnostics<'_>) {
    let halo = &model.halo;
    let n = halo.core_len();
    let gravity = model.parameters.gravity_m_per_s2;
    let (per_dx, per_dy) = (1.0 / model.layout.grid.dx_m, 1.0 / model.layout.grid.dy_m);
    let (h0, h_w, h_s, h_sw) = (halo.core(h), halo.shift(h, 0, -1), halo.shift(h, -1, 0), halo.shift(h, -1, -1));
    let (u0, u_e, u_s) = (halo.core(u), halo.shift(u, 0, 1), halo.shift(u, -1, 0));
    let (v0, v_n, v_w) = (halo.core(v), halo.shift(v, 1, 0), halo.shift(v, 0, -1));
    let coriolis = halo.core(&model.coriolis);
    let flux = halo.core_mut(d.mass_flux_x);
    for k in 0..n {
        flux[k] = 0.5 * (h0[k] + h_w[k]) * u0[k];
    }
    let flux = halo.core_mut(d.mass_flux_y);
    for k in 0..n {
        flux[k] = 0.5 * (h0[k] + h_s[k]) * v0[k];
    }
    let q = halo.core_mut(d.potential_vorticity);
    for k in 0..n {
        let vorticity = (v0[k] - v_w[k]) * per_dx - (u0[k] - u_s[k]) * per_dy;
        q[k] = 4.0 * (coriolis[k] + vorticity) / (h0[k] + h_w[k] + h_s[k] + h_sw[k]);
    }
    let b = halo.core_mut(d.bernoulli);
    for k in 0..n {
        b[k] = gravity * h0[k] + 0.25 * (u0[k] * u0[k] + u_e[k] * u_e[k] + v0[k] * v0[k] + v_n[k] * v_n[k]);
    }
}

/// `out_h` = −δx U/dx − δy V/dy.
#[inline(always)]
pub(super) fn minus_divergence(model: &ShallowWater, flux_x: &[f64], flux_y: &[f64], out_h: &mut [f64]) {
    let (halo, grid) = (&model.halo, &model.layout.grid);
    let (per_dx, per_dy) = (1.0 / grid.dx_m, 1.0 / grid.dy_m);
    for (j, out) in out_h.chunks_exact_mut(halo.columns()).enumerate() {
        let (west, east) = (halo.row(flux_x, j, 0, 0), halo.row(flux_x, j, 0, 1));
        let (south, north) = (halo.row(flux_y, j, 0, 0), halo.row(flux_y, j, 1, 0));
        for i in 0..halo.columns() {
            out[i] = (west[i] - east[i]) * per_dx + (south[i] - north[i]) * per_dy;
        }
    }
}

/// `out_u` = −δx B/dx, `out_v` = −δy B/dy, but zero at walls.
#[inline(always)]
pub(super) fn minus_gradient(model: &ShallowWater, bernoulli: &[f64], out_u: &mut [f64], out_v: &mut [f64]) {
    let (halo, grid) = (&model.halo, &model.layout.grid);
    let (per_dx, per_dy) = (1.0 / grid.dx_m, 1.0 / grid.dy_m);
    let walls = halo.first_row(Location::YFace);
    out_v[..walls * grid.nx].fill(0.0);
    let rows = out_u.chunks_exact_mut(halo.columns()).zip(out_v.chunks_exact_mut(halo.columns()));
    for (j, (out_u, out_v)) in rows.enumerate() {
        let b = halo.row(bernoulli, j, 0, 0);
        let (west, south) = (halo.row(bernoulli, j, 0, -1), halo.row(bernoulli, j, -1, 0));
        for i in 0..halo.columns() {
            out_u[i] = (west[i] - b[i]) * per_dx;
        }
        if j >= walls {
            for i in 0..halo.columns() {
                out_v[i] = (south[i] - b[i]) * per_dy;
            }
        }
    }
}

/// Adds the vorticity term q V, −q U.
#[inline(always)]
fn add_vorticity_term(model: &ShallowWater, d: &Diagnostics<'_>, out_u: &mut [f64], out_v: &mut [f64]) {
    let (halo, nx) = (&model.halo, model.halo.columns());
    let (q, flux_x, flux_y) = (&*d.potential_vorticity, &*d.mass_flux_x, &*d.mass_flux_y);
    for (j, out) in out_u.chunks_exact_mut(nx).enumerate() {
        let (q, q_n) = (halo.row(q, j, 0, 0), halo.row(q, j, 1, 0));
        let (v, v_w) = (halo.row(flux_y, j, 0, 0), halo.row(flux_y, j, 0, -1));
        let (v_n, v_nw) = (halo.row(flux_y, j, 1, 0), halo.row(flux_y, j, 1, -1));
        match model.form {
            VectorInvariant::PotentialEnstrophy => {
                for i in 0..nx {
                    out[i] += 0.125 * (q[i] + q_n[i]) * (v[i] + v_w[i] + v_n[i] + v_nw[i]);
                }
            }
            VectorInvariant::Energy => {
                for i in 0..nx {
                    out[i] += 0.25 * (q[i] * (v[i] + v_w[i]) + q_n[i] * (v_n[i] + v_nw[i]));
                }
            }
        }
    }
    for (j, out) in out_v.chunks_exact_mut(nx).enumerate().skip(halo.first_row(Location::YFace)) {
        let (q, q_e) = (halo.row(q, j, 0, 0), halo.row(q, j, 0, 1));
        let (u, u_e) = (halo.row(flux_x, j, 0, 0), halo.row(flux_x, j, 0, 1));
        let (u_s, u_se) = (halo.row(flux_x, j, -1, 0), halo.row(flux_x, j, -1, 1));
        match model.form {
            VectorInvariant::PotentialEnstrophy => {
                for i in 0..nx {
                    out[i] -= 0.125 * (q[i] + q_e[i]) * (u[i] + u_e[i] + u_s[i] + u_se[i]);
                }
            }
            VectorInvariant::Energy => {
                for i in 0..nx {
                    out[i] -= 0.25 * (q[i] * (u[i] + u_s[i]) + q_e[i] * (u_e[i] + u_se[i]));
                }
            }
        }
    }
}

/// Adds −r u, −r v and −ν L(L x), with L the five-point Laplacian under the boundary conditions of each variable.
///
/// Under the even continuation L has no flux through walls, so that Σ L h = 0 and mass is conserved; for v the walls
/// are zeros. Either way L is symmetric.
#[inline(always)]
pub(super) fn add_damping(model: &ShallowWater, x: &[f64], out_add: &mut [f64], scratch: &mut [f64]) {
    let (halo, grid) = (&model.halo, &model.layout.grid);
    let (drag, hyperdiffusion) = (model.parameters.drag_per_s, model.parameters.hyperdiffusion_m4_per_s);
    let cells = grid.cells();
    if drag != 0.0 {
        let walls = halo.first_row(Location::YFace) * grid.nx;
        for range in [U * cells..V * cells, V * cells + walls..(V + 1) * cells] {
            for (out, x) in out_add[range.clone()].iter_mut().zip(&x[range]) {
                *out -= drag * x;
            }
        }
    }
    if hyperdiffusion != 0.0 {
        let [field, laplacian] = padded_fields(halo, scratch);
        for (variable, location) in [(H, Location::Center), (U, Location::XFace), (V, Location::YFace)] {
            let range = variable * cells..(variable + 1) * cells;
            halo.load(location, &x[range.clone()], field);
            laplace(model, field, laplacian);
            halo.fill(location, laplacian);
            laplace(model, laplacian, field);
            let rows = out_add[range].chunks_exact_mut(halo.columns()).enumerate();
            for (j, out) in rows.skip(halo.first_row(location)) {
                for (out, bilaplacian) in out.iter_mut().zip(halo.row(field, j, 0, 0)) {
                    *out -= hyperdiffusion * bilaplacian;
                }
            }
        }
    }
}

/// The five-point Laplacian of a padded field.
#[inline(always)]
fn laplace(model: &ShallowWater, field: &[f64], out: &mut [f64]) {
    let (halo, grid) = (&model.halo, &model.layout.grid);
    let (x_weight, y_weight) = (grid.dx_m.powi(-2), grid.dy_m.powi(-2));
    let (center, west, east) = (halo.core(field), halo.shift(field, 0, -1), halo.shift(field, 0, 1));
    let (south, north) = (halo.shift(field, -1, 0), halo.shift(field, 1, 0));
    let out = halo.core_mut(out);
    for k in 0..halo.core_len() {
        let (x_part, y_part) =
            ((east[k] - center[k]) - (center[k] - west[k]), (north[k] - center[k]) - (center[k] - south[k]));
        out[k] = x_part * x_weight + y_part * y_weight;
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

/// Zero as often as a padded field is long; for building [`Diagnostics`] of one's own.
pub(super) fn zeros<const N: usize>(halo: &Halo) -> [Vec<f64>; N] {
    std::array::from_fn(|_| halo.zeros())
}
