//! The loops of [`super::adjoint_rows`] for a group of columns at once in vector operations, with the same bits.

use super::VARIABLES;
use super::adjoint_rows::Gradients;
use super::kernel::Constants;
use super::lanes::{for_vectors, places, places_mut};
use super::row_coefficients::RowCoefficients;
use crate::scheme::rows::Row;
use pulp::Simd;

/// V*, q*/h̄ˣʸ and q q*/(4 h̄ˣʸ) of the northern row, U* and B* of the southern.
#[inline(always)]
pub(super) fn diagnostics<S: Simd>(
    simd: S,
    constants: Constants,
    coefficients: &RowCoefficients,
    row: isize,
    [south, north]: [Row<'_>; 2],
    gradients: &mut Gradients,
) {
    for_vectors!(S, f64, P => diagnostics_in::<S, P>(simd, constants, coefficients, row, south, north, gradients));
}

#[inline(always)]
fn diagnostics_in<S: Simd, const P: usize>(
    simd: S,
    constants: Constants,
    coefficients: &RowCoefficients,
    row: isize,
    south: Row<'_>,
    north: Row<'_>,
    gradients: &mut Gradients,
) {
    let [_, per_dx, per_dy] = constants.splat(simd);
    let splat = |value: f64| simd.splat_f64s(value);
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let [h_south, u_south, v_south] = south.variables().map(places::<S, f64, P>);
    let [h_north, u_north, v_north] = north.variables().map(places::<S, f64, P>);
    // Place i is at i + 1.
    let padded = h_north.len();
    let n = padded - 2;
    let (h_north, u_north, v_north) = (&h_north[..padded], &u_north[..padded], &v_north[..padded]);
    let (h_south, u_south, v_south) = (&h_south[..padded], &u_south[..padded], &v_south[..padded]);
    let (at, term, term_s) =
        (coefficients.places(row, n), coefficients.vorticity_term(row, n), coefficients.vorticity_term(row - 1, n));
    let (per_thickness, quarter_q) = (&at.per_thickness[..padded], &at.quarter_q_per_thickness[..padded]);
    let (of_q, of_q_s) = (&term.x[0][..padded], &term_s.x[1][..padded]);
    let (of_v, of_v_s) = (&term.x[2][..padded], &term_s.x[3][..padded]);
    let (of_q_y, of_q_e) = (&term.y[0][..padded], &term.y[1][..n]);
    let (of_u, of_u_e) = (&term.y[2][..padded], &term.y[3][..n]);
    let (of_u_s, of_u_se) = (&term_s.y[2][..padded], &term_s.y[3][..n]);
    let [flux_x, flux_y, vorticity, thickness, bernoulli] =
        gradients.newest_mut().map(|row| &mut places_mut::<S, f64, P>(row)[..padded]);
    for part in 0..P {
        for w in 0..n {
            let (i, e) = (w + 1, w + 2);
            let (h, h_s, h_sw) = (h_north[i][part], h_south[i][part], h_south[w][part]);
            let (u, u_e, u_s, u_se) = (u_north[i][part], u_north[e][part], u_south[i][part], u_south[e][part]);
            let (v, v_w, v_s, v_sw) = (v_north[i][part], v_north[w][part], v_south[i][part], v_south[w][part]);
            let of_u_star = add(mul(splat(of_q[i]), u), mul(splat(of_q_s[i]), u_s));
            let of_v_star = add(mul(splat(of_q_y[i]), v), mul(splat(of_q_e[w]), v_w));
            let q = sub(of_u_star, of_v_star);
            vorticity[i][part] = mul(splat(per_thickness[i]), q);
            thickness[i][part] = mul(splat(quarter_q[i]), q);
            let northern = add(mul(splat(of_v[i]), u), mul(splat(of_v[e]), u_e));
            let southern = add(mul(splat(of_v_s[i]), u_s), mul(splat(of_v_s[e]), u_se));
            flux_y[i][part] = add(mul(sub(h, h_s), per_dy), add(northern, southern));
            let southern = add(mul(splat(of_u_s[i]), v_s), mul(splat(of_u_se[w]), v_sw));
            let northern = add(mul(splat(of_u[i]), v), mul(splat(of_u_e[w]), v_w));
            flux_x[i][part] = sub(mul(sub(h_s, h_sw), per_dx), add(southern, northern));
            bernoulli[i][part] = add(mul(sub(u_se, u_s), per_dx), mul(sub(v, v_s), per_dy));
        }
    }
    for row in [flux_x, vorticity, thickness, bernoulli] {
        (row[0], row[n + 1]) = (row[n], row[1]);
    }
}

/// h*, u* and v* of a row.
#[inline(always)]
pub(super) fn prognostics<S: Simd>(
    simd: S,
    constants: Constants,
    coefficients: &RowCoefficients,
    row: isize,
    gradients: &Gradients,
    out: &mut [f64],
) {
    for_vectors!(S, f64, P => prognostics_in::<S, P>(simd, constants, coefficients, row, gradients, out));
}

#[inline(always)]
fn prognostics_in<S: Simd, const P: usize>(
    simd: S,
    constants: Constants,
    coefficients: &RowCoefficients,
    row: isize,
    gradients: &Gradients,
    out: &mut [f64],
) {
    let [gravity, per_dx, per_dy] = constants.splat(simd);
    let splat = |value: f64| simd.splat_f64s(value);
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let (out_h, winds) = out.split_at_mut(out.len() / VARIABLES);
    let (out_u, out_v) = winds.split_at_mut(out_h.len());
    let [out_h, out_u, out_v] = [out_h, out_u, out_v].map(places_mut::<S, f64, P>);
    let padded = out_h.len();
    let n = padded - 2;
    let (out_u, out_v) = (&mut out_u[..padded], &mut out_v[..padded]);
    let (at, half_v_n) = (coefficients.places(row, n), &coefficients.places(row + 1, n).half_v[..padded]);
    let (thickness_x, thickness_y) = (&at.thickness_x[..padded], &at.thickness_y[..padded]);
    let (half_u, half_v) = (&at.half_u[..padded], &at.half_v[..padded]);
    let flux_x = &places::<S, f64, P>(&gradients.flux_x)[..padded];
    let [flux_y, flux_y_n] = gradients.flux_y.each_ref().map(|row| &places::<S, f64, P>(row)[..padded]);
    let [z, z_n] = gradients.vorticity.each_ref().map(|row| &places::<S, f64, P>(row)[..padded]);
    let [q, q_n] = gradients.thickness.each_ref().map(|row| &places::<S, f64, P>(row)[..padded]);
    let [b_s, b] = gradients.bernoulli.each_ref().map(|row| &places::<S, f64, P>(row)[..padded]);
    for part in 0..P {
        for w in 0..n {
            let (i, e) = (w + 1, w + 2);
            let (half_u_i, half_v_i) = (splat(half_u[i]), splat(half_v[i]));
            let (flux_x_i, flux_y_i, b_i, z_i) = (flux_x[i][part], flux_y[i][part], b[i][part], z[i][part]);
            let kinetic_x = add(mul(half_u_i, flux_x_i), mul(splat(half_u[e]), flux_x[e][part]));
            let kinetic_y = add(mul(half_v_i, flux_y_i), mul(splat(half_v_n[i]), flux_y_n[i][part]));
            let corners = add(add(q[i][part], q[e][part]), add(q_n[i][part], q_n[e][part]));
            out_h[i][part] = sub(add(mul(gravity, b_i), add(kinetic_x, kinetic_y)), corners);
            let of_fluxes = add(mul(splat(thickness_x[i]), flux_x_i), mul(half_u_i, add(b_i, b[w][part])));
            out_u[i][part] = sub(of_fluxes, mul(sub(z_i, z_n[i][part]), per_dy));
            let of_fluxes = add(mul(splat(thickness_y[i]), flux_y_i), mul(half_v_i, add(b_i, b_s[i][part])));
            out_v[i][part] = add(of_fluxes, mul(sub(z_i, z[e][part]), per_dx));
        }
    }
}
