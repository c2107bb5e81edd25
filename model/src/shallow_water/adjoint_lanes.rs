//! The loops of [`super::adjoint_rows`] for eight columns at once in vector operations, with the same bits.

use super::ShallowWater;
use super::row_coefficients::RowCoefficients;
use crate::columns::LANES;
use crate::scheme::rows::Row;
use pulp::Simd;

/// h, u and v.
const VARIABLES: usize = 3;

/// Gradients with respect to the diagnostic quantities of the rows of a sweep, `[x, lane]`: see
/// [`AdjointRows`](super::adjoint_rows::AdjointRows).
pub(super) struct Rows<'a> {
    pub flux_x: &'a mut [f64],
    pub flux_y: [&'a mut [f64]; 2],
    pub vorticity: [&'a mut [f64]; 2],
    pub thickness: [&'a mut [f64]; 2],
    pub bernoulli: [&'a mut [f64]; 2],
}

/// Places of a row of one variable, the lanes of each in `P` vectors.
#[inline(always)]
fn places<S: Simd, const P: usize>(row: &[f64]) -> &[[S::f64s; P]] {
    S::as_simd_f64s(row).0.as_chunks().0
}

/// Places of a row of one variable, the lanes of each in `P` vectors.
#[inline(always)]
fn places_mut<S: Simd, const P: usize>(row: &mut [f64]) -> &mut [[S::f64s; P]] {
    S::as_mut_simd_f64s(row).0.as_chunks_mut().0
}

/// V*, q*/h̄ˣʸ and q q*/(4 h̄ˣʸ) of the northern row, U* and B* of the southern.
#[inline(always)]
pub(super) fn diagnostics<S: Simd>(
    simd: S,
    model: &ShallowWater,
    coefficients: &RowCoefficients,
    row: isize,
    [south, north]: [Row<'_>; 2],
    rows: &mut Rows<'_>,
) {
    match S::as_simd_f64s(&[0.0; 2 * LANES]).0.len() / 2 {
        1 => diagnostics_in::<S, 1>(simd, model, coefficients, row, south, north, rows),
        2 => diagnostics_in::<S, 2>(simd, model, coefficients, row, south, north, rows),
        4 => diagnostics_in::<S, 4>(simd, model, coefficients, row, south, north, rows),
        8 => diagnostics_in::<S, 8>(simd, model, coefficients, row, south, north, rows),
        vectors => panic!("no processor has vectors of which {vectors} make eight numbers"),
    }
}

#[inline(always)]
fn diagnostics_in<S: Simd, const P: usize>(
    simd: S,
    model: &ShallowWater,
    coefficients: &RowCoefficients,
    row: isize,
    south: Row<'_>,
    north: Row<'_>,
    rows: &mut Rows<'_>,
) {
    let grid = &model.layout.grid;
    let splat = |value: f64| simd.splat_f64s(value);
    let (per_dx, per_dy) = (splat(1.0 / grid.dx_m), splat(1.0 / grid.dy_m));
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let [h_south, u_south, v_south] = south.variables().map(places::<S, P>);
    let [h_north, u_north, v_north] = north.variables().map(places::<S, P>);
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
    let flux_x = &mut places_mut::<S, P>(rows.flux_x)[..padded];
    let [_, flux_y] = &mut rows.flux_y;
    let ([_, vorticity], [_, thickness]) = (&mut rows.vorticity, &mut rows.thickness);
    let [_, bernoulli] = &mut rows.bernoulli;
    let (flux_y, bernoulli) = (&mut places_mut::<S, P>(flux_y)[..padded], &mut places_mut::<S, P>(bernoulli)[..padded]);
    let (vorticity, thickness) =
        (&mut places_mut::<S, P>(vorticity)[..padded], &mut places_mut::<S, P>(thickness)[..padded]);
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
    model: &ShallowWater,
    coefficients: &RowCoefficients,
    row: isize,
    rows: &Rows<'_>,
    out: &mut [f64],
) {
    match S::as_simd_f64s(&[0.0; 2 * LANES]).0.len() / 2 {
        1 => prognostics_in::<S, 1>(simd, model, coefficients, row, rows, out),
        2 => prognostics_in::<S, 2>(simd, model, coefficients, row, rows, out),
        4 => prognostics_in::<S, 4>(simd, model, coefficients, row, rows, out),
        8 => prognostics_in::<S, 8>(simd, model, coefficients, row, rows, out),
        vectors => panic!("no processor has vectors of which {vectors} make eight numbers"),
    }
}

#[inline(always)]
fn prognostics_in<S: Simd, const P: usize>(
    simd: S,
    model: &ShallowWater,
    coefficients: &RowCoefficients,
    row: isize,
    rows: &Rows<'_>,
    out: &mut [f64],
) {
    let grid = &model.layout.grid;
    let splat = |value: f64| simd.splat_f64s(value);
    let (per_dx, per_dy) = (splat(1.0 / grid.dx_m), splat(1.0 / grid.dy_m));
    let gravity = splat(model.parameters.gravity_m_per_s2);
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let (out_h, winds) = out.split_at_mut(out.len() / VARIABLES);
    let (out_u, out_v) = winds.split_at_mut(out_h.len());
    let (out_h, out_u, out_v) = (places_mut::<S, P>(out_h), places_mut::<S, P>(out_u), places_mut::<S, P>(out_v));
    let padded = out_h.len();
    let n = padded - 2;
    let (out_u, out_v) = (&mut out_u[..padded], &mut out_v[..padded]);
    let (at, half_v_n) = (coefficients.places(row, n), &coefficients.places(row + 1, n).half_v[..padded]);
    let (thickness_x, thickness_y) = (&at.thickness_x[..padded], &at.thickness_y[..padded]);
    let (half_u, half_v) = (&at.half_u[..padded], &at.half_v[..padded]);
    let flux_x = &places::<S, P>(rows.flux_x)[..padded];
    let [flux_y, flux_y_n] = [0, 1].map(|row| &places::<S, P>(rows.flux_y[row])[..padded]);
    let [z, z_n] = [0, 1].map(|row| &places::<S, P>(rows.vorticity[row])[..padded]);
    let [q, q_n] = [0, 1].map(|row| &places::<S, P>(rows.thickness[row])[..padded]);
    let [b_s, b] = [0, 1].map(|row| &places::<S, P>(rows.bernoulli[row])[..padded]);
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
