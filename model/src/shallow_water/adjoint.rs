//! The adjoint tendency N'(x̄)ᵀ δy of whole fields, for the start of leapfrog: the derivatives in [`super::kernel`] transposed,
//! in reverse order. A step has it row by row, in [`super::adjoint_rows`].
//!
//! A stencil that reads at k + s becomes one that reads at k − s; the boundary condition's transpose comes last
//! ([`Halo::fold`](crate::halo::Halo::fold)). With a star for the gradient with respect to a quantity and
//! a = (weight of δq), b = (weight of δV or δU) in the vorticity term:
//!
//! ```text
//! B* = −(u* − u*[E])/dx − (v* − v*[N])/dy
//! U* = (h* − h*[W])/dx − mean_xy(b v*)      V* = (h* − h*[S])/dy + mean_xy(b u*)      q* = mean_y(a u*) − mean_x(a v*)
//! u* = h̄ˣ U* + u mean_x(B*) − (q*/h̄ˣʸ − [N])/dy
//! v* = h̄ʸ V* + v mean_y(B*) + (q*/h̄ˣʸ − [E])/dx
//! h* = g B* + mean_x(u U*) + mean_y(v V*) − mean_xy(q q*/h̄ˣʸ)
//! ```

use super::damping::add_damping;
use super::tangent_linear::{Coefficients, VorticityTerm};
use super::{ShallowWater, padded_fields};
use crate::grid::Location;

/// `out_add` += N'(x̄)ᵀ dy.
#[inline(always)]
pub(super) fn tendency_ad(
    model: &ShallowWater,
    at: &Coefficients,
    dy: &[f64],
    out_add: &mut [f64],
    scratch: &mut [f64],
) {
    let halo = &model.halo;
    let cells = model.layout.grid.cells();
    add_damping(model, dy, out_add, scratch);
    let [h, u, v, flux_x, flux_y, q, bernoulli, work_a, work_b, work_c] = padded_fields(halo, scratch);
    let [dy_h, dy_u, dy_v] = model.fields(dy);
    halo.load_without_rim(Location::Center, dy_h, h);
    halo.load_without_rim(Location::XFace, dy_u, u);
    halo.load_without_rim(Location::YFace, dy_v, v);
    gradient_ad(model, u, v, bernoulli);
    divergence_ad(model, h, flux_x, flux_y);
    vorticity_term_ad(model, &at.vorticity_term, u, v, flux_x, flux_y, q, [&mut *work_a, &mut *work_b]);
    // From here on, u*, v*, h* are those of the input, and overwrite those of the output.
    winds_ad(model, at, flux_x, flux_y, q, bernoulli, u, v, work_a);
    thickness_ad(model, at, flux_x, flux_y, q, bernoulli, h, [work_a, work_b, work_c]);
    let (out_h, winds) = out_add.split_at_mut(cells);
    let (out_u, out_v) = winds.split_at_mut(cells);
    halo.fold(Location::Center, h, out_h);
    halo.fold(Location::XFace, u, out_u);
    halo.fold(Location::YFace, v, out_v);
}

/// B* from u*, v*.
#[inline(always)]
fn gradient_ad(model: &ShallowWater, u: &[f64], v: &[f64], bernoulli: &mut [f64]) {
    let halo = &model.halo;
    let (per_dx, per_dy) = (1.0 / model.layout.grid.dx_m, 1.0 / model.layout.grid.dy_m);
    let (u0, u_e, v0, v_n) = (halo.core(u), halo.shift(u, 0, 1), halo.core(v), halo.shift(v, 1, 0));
    let out = halo.core_mut(bernoulli);
    for k in 0..halo.core_len() {
        out[k] = (u_e[k] - u0[k]) * per_dx + (v_n[k] - v0[k]) * per_dy;
    }
}

/// U*, V* from h*.
#[inline(always)]
fn divergence_ad(model: &ShallowWater, h: &[f64], flux_x: &mut [f64], flux_y: &mut [f64]) {
    let halo = &model.halo;
    let (per_dx, per_dy) = (1.0 / model.layout.grid.dx_m, 1.0 / model.layout.grid.dy_m);
    let (h0, h_w, h_s) = (halo.core(h), halo.shift(h, 0, -1), halo.shift(h, -1, 0));
    let out = halo.core_mut(flux_x);
    for k in 0..halo.core_len() {
        out[k] = (h0[k] - h_w[k]) * per_dx;
    }
    let out = halo.core_mut(flux_y);
    for k in 0..halo.core_len() {
        out[k] = (h0[k] - h_s[k]) * per_dy;
    }
}

/// q*, and additions to U*, V*, from u*, v*.
#[inline(always)]
fn vorticity_term_ad(
    model: &ShallowWater,
    at: &VorticityTerm,
    u: &[f64],
    v: &[f64],
    flux_x: &mut [f64],
    flux_y: &mut [f64],
    q: &mut [f64],
    [product_u, product_v]: [&mut [f64]; 2],
) {
    let halo = &model.halo;
    let n = halo.core_len();
    match at {
        VorticityTerm::PotentialEnstrophy { flux_y: mean_flux_y, q_x, flux_x: mean_flux_x, q_y } => {
            multiply(halo.core_mut(product_u), halo.core(mean_flux_y), halo.core(u));
            multiply(halo.core_mut(product_v), halo.core(mean_flux_x), halo.core(v));
            let (a, a_s) = (halo.core(product_u), halo.shift(product_u, -1, 0));
            let (b, b_w) = (halo.core(product_v), halo.shift(product_v, 0, -1));
            let out = halo.core_mut(q);
            for k in 0..n {
                out[k] = (a[k] + a_s[k]) - (b[k] + b_w[k]);
            }
            multiply(halo.core_mut(product_u), halo.core(q_x), halo.core(u));
            multiply(halo.core_mut(product_v), halo.core(q_y), halo.core(v));
            let p = |rows, columns| halo.shift(product_u, rows, columns);
            let (a, a_e, a_s, a_se) = (p(0, 0), p(0, 1), p(-1, 0), p(-1, 1));
            let out = halo.core_mut(flux_y);
            for k in 0..n {
                out[k] += a[k] + a_e[k] + a_s[k] + a_se[k];
            }
            let p = |rows, columns| halo.shift(product_v, rows, columns);
            let (b, b_w, b_n, b_nw) = (p(0, 0), p(0, -1), p(1, 0), p(1, -1));
            let out = halo.core_mut(flux_x);
            for k in 0..n {
                out[k] -= b[k] + b_w[k] + b_n[k] + b_nw[k];
            }
        }
        VorticityTerm::Energy { flux_y: mean_flux_y, flux_x: mean_flux_x, q: quarter_q } => {
            let (u0, u_s, v0, v_w) = (halo.core(u), halo.shift(u, -1, 0), halo.core(v), halo.shift(v, 0, -1));
            let (mean_y, mean_x, quarter_q) = (halo.core(mean_flux_y), halo.core(mean_flux_x), halo.core(quarter_q));
            let out = halo.core_mut(q);
            for k in 0..n {
                out[k] = mean_y[k] * (u0[k] + u_s[k]) - mean_x[k] * (v0[k] + v_w[k]);
            }
            let out = halo.core_mut(product_u);
            for k in 0..n {
                out[k] = quarter_q[k] * (u0[k] + u_s[k]);
            }
            let out = halo.core_mut(product_v);
            for k in 0..n {
                out[k] = quarter_q[k] * (v0[k] + v_w[k]);
            }
            let (a, a_e) = (halo.core(product_u), halo.shift(product_u, 0, 1));
            let out = halo.core_mut(flux_y);
            for k in 0..n {
                out[k] += a[k] + a_e[k];
            }
            let (b, b_n) = (halo.core(product_v), halo.shift(product_v, 1, 0));
            let out = halo.core_mut(flux_x);
            for k in 0..n {
                out[k] -= b[k] + b_n[k];
            }
        }
    }
}

/// u*, v* of the input from U*, V*, q*, B*.
#[inline(always)]
fn winds_ad(
    model: &ShallowWater,
    at: &Coefficients,
    flux_x: &[f64],
    flux_y: &[f64],
    q: &[f64],
    bernoulli: &[f64],
    u: &mut [f64],
    v: &mut [f64],
    vorticity: &mut [f64],
) {
    let halo = &model.halo;
    let (per_dx, per_dy) = (1.0 / model.layout.grid.dx_m, 1.0 / model.layout.grid.dy_m);
    multiply(halo.core_mut(vorticity), halo.core(&at.per_thickness), halo.core(q));
    let (b0, b_w, b_s) = (halo.core(bernoulli), halo.shift(bernoulli, 0, -1), halo.shift(bernoulli, -1, 0));
    let (z0, z_n, z_e) = (halo.core(vorticity), halo.shift(vorticity, 1, 0), halo.shift(vorticity, 0, 1));
    let (thickness, half_u, flux) = (halo.core(&at.thickness_x), halo.core(&at.half_u), halo.core(flux_x));
    let out = halo.core_mut(u);
    for k in 0..halo.core_len() {
        out[k] = thickness[k] * flux[k] + half_u[k] * (b0[k] + b_w[k]) - (z0[k] - z_n[k]) * per_dy;
    }
    let (thickness, half_v, flux) = (halo.core(&at.thickness_y), halo.core(&at.half_v), halo.core(flux_y));
    let out = halo.core_mut(v);
    for k in 0..halo.core_len() {
        out[k] = thickness[k] * flux[k] + half_v[k] * (b0[k] + b_s[k]) + (z0[k] - z_e[k]) * per_dx;
    }
}

/// h* of the input from U*, V*, q*, B*.
#[inline(always)]
fn thickness_ad(
    model: &ShallowWater,
    at: &Coefficients,
    flux_x: &[f64],
    flux_y: &[f64],
    q: &[f64],
    bernoulli: &[f64],
    h: &mut [f64],
    [product_x, product_y, product_q]: [&mut [f64]; 3],
) {
    let halo = &model.halo;
    let gravity = model.parameters.gravity_m_per_s2;
    multiply(halo.core_mut(product_x), halo.core(&at.half_u), halo.core(flux_x));
    multiply(halo.core_mut(product_y), halo.core(&at.half_v), halo.core(flux_y));
    multiply(halo.core_mut(product_q), halo.core(&at.quarter_q_per_thickness), halo.core(q));
    let b = halo.core(bernoulli);
    let (x0, x_e) = (halo.core(product_x), halo.shift(product_x, 0, 1));
    let (y0, y_n) = (halo.core(product_y), halo.shift(product_y, 1, 0));
    let p = |rows, columns| halo.shift(product_q, rows, columns);
    let (q0, q_e, q_n, q_ne) = (p(0, 0), p(0, 1), p(1, 0), p(1, 1));
    let out = halo.core_mut(h);
    for k in 0..halo.core_len() {
        out[k] = gravity * b[k] + (x0[k] + x_e[k]) + (y0[k] + y_n[k]) - (q0[k] + q_e[k] + q_n[k] + q_ne[k]);
    }
}

/// out = a b.
#[inline(always)]
fn multiply(out: &mut [f64], a: &[f64], b: &[f64]) {
    for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
        *out = a * b;
    }
}
