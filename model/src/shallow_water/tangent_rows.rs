//! The tangent-linear tendency row by row for eight columns at once: the lines of [`super::tangent_linear`], with the
//! coefficients of a row of the state computed once for all columns.

use super::rows::ShallowWaterRows;
use super::{ShallowWater, VectorInvariant};
use crate::grid::Boundary;
use crate::rows::RowStream;
use crate::tangent_wavefront::{LANES, TangentRowStream};
use pulp::{Simd, WithSimd};

/// Rows of a sweep: of the state, of its coefficients, and of the increments' diagnostic fields (as in
/// [`ShallowWaterRows`]).
pub(super) struct TangentRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    length: usize,
    state: ShallowWaterRows<'a>,
    /// Of the northern row: h̄ˣ, h̄ʸ, 1/h̄ˣʸ, q/(4 h̄ˣʸ).
    thickness: [Vec<f64>; 4],
    /// u/2 and v/2 of the southern and the northern row.
    half_wind: [[Vec<f64>; 2]; 2],
    /// Of the southern row: what multiplies δq, δq\[N\], δV + δV\[W\], δV\[N\] + δV\[NW\] in ∂u/∂t, and
    /// δq, δq\[E\], δU + δU\[S\], δU\[E\] + δU\[SE\] in −∂v/∂t.
    vorticity_term: [Vec<f64>; 8],
    flux_x: [Vec<f64>; 3],
    flux_y: [Vec<f64>; 2],
    q: [Vec<f64>; 2],
    bernoulli: [Vec<f64>; 2],
}

impl<'a> TangentRows<'a> {
    /// For rows of `length` places per variable, rim included.
    pub fn new(model: &'a ShallowWater, length: usize) -> Self {
        let (row, lanes) = (|| vec![0.0; length], || vec![0.0; length * LANES]);
        Self {
            model,
            arch: pulp::Arch::new(),
            length,
            state: ShallowWaterRows::new(model, length),
            thickness: std::array::from_fn(|_| row()),
            half_wind: std::array::from_fn(|_| [row(), row()]),
            vorticity_term: std::array::from_fn(|_| row()),
            flux_x: [lanes(), lanes(), lanes()],
            flux_y: [lanes(), lanes()],
            q: [lanes(), lanes()],
            bernoulli: [lanes(), lanes()],
        }
    }

    /// Coefficients of the row pushed, and of the row south of it.
    #[inline(always)]
    fn linearise(&mut self, south: &[f64], north: &[f64]) {
        let n = self.length;
        let ([h_s, _, _], [h, u, v]) = (super::rows::split(south, n), super::rows::split(north, n));
        let [thickness_x, thickness_y, per_thickness, quarter_q] = &mut self.thickness;
        let [half_u, half_v] = &mut self.half_wind[1];
        halve(u, half_u);
        halve(v, half_v);
        mean(h, h_s, thickness_y);
        mean(&h[1..], &h[..n - 1], &mut thickness_x[1..]);
        per_sum(h, h_s, &self.state.q[1], per_thickness, quarter_q);
        let [a, a_n, b, b_n, c, c_e, d, d_e] = &mut self.vorticity_term;
        let (q, q_n) = (&self.state.q[0], &self.state.q[1]);
        let [flux_x_s, flux_x, _] = &self.state.flux_x;
        let [flux_y, flux_y_n] = &self.state.flux_y;
        match self.model.form {
            VectorInvariant::PotentialEnstrophy => {
                eighth_sum(flux_y, flux_y_n, 0, a);
                eighth_sum(flux_x, flux_x_s, 1, c);
                for i in 1..n - 1 {
                    b[i] = 0.125 * (q[i] + q_n[i]);
                    d[i] = 0.125 * (q[i] + q[i + 1]);
                }
                for (copy, of) in [(a_n, a), (b_n, b), (c_e, c), (d_e, d)] {
                    copy.copy_from_slice(of);
                }
            }
            VectorInvariant::Energy => {
                for i in 1..n - 1 {
                    a[i] = 0.25 * (flux_y[i] + flux_y[i - 1]);
                    a_n[i] = 0.25 * (flux_y_n[i] + flux_y_n[i - 1]);
                    c[i] = 0.25 * (flux_x[i] + flux_x_s[i]);
                    c_e[i] = 0.25 * (flux_x[i + 1] + flux_x_s[i + 1]);
                    (b[i], b_n[i], d[i], d_e[i]) = (0.25 * q[i], 0.25 * q_n[i], 0.25 * q[i], 0.25 * q[i + 1]);
                }
            }
        }
    }
}

#[inline(always)]
fn halve(of: &[f64], out: &mut [f64]) {
    for (out, of) in out.iter_mut().zip(of) {
        *out = 0.5 * of;
    }
}

#[inline(always)]
fn mean(a: &[f64], b: &[f64], out: &mut [f64]) {
    for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
        *out = 0.5 * (a + b);
    }
}

/// 1/h̄ˣʸ and q/(4 h̄ˣʸ).
#[inline(always)]
fn per_sum(h: &[f64], h_s: &[f64], q: &[f64], per_thickness: &mut [f64], quarter_q: &mut [f64]) {
    let n = h.len() - 1;
    let (h0, h_w, h_s, h_sw, q) = (&h[1..][..n], &h[..n], &h_s[1..][..n], &h_s[..n], &q[1..][..n]);
    let (per_thickness, quarter_q) = (&mut per_thickness[1..][..n], &mut quarter_q[1..][..n]);
    for i in 0..n {
        let per_sum = 1.0 / (h0[i] + h_w[i] + h_s[i] + h_sw[i]);
        per_thickness[i] = 4.0 * per_sum;
        quarter_q[i] = q[i] * per_sum;
    }
}

/// An eighth of the sum of four: of both rows at i − 1 + `east` and i + `east`.
#[inline(always)]
fn eighth_sum(one: &[f64], other: &[f64], east: usize, out: &mut [f64]) {
    let n = out.len() - 2;
    let (a, b, c, d) = (&one[east..][..n], &one[east + 1..][..n], &other[east..][..n], &other[east + 1..][..n]);
    let out = &mut out[1..][..n];
    for i in 0..n {
        out[i] = 0.125 * (a[i] + b[i] + c[i] + d[i]);
    }
}

impl TangentRowStream for TangentRows<'_> {
    fn begin(&mut self, x: &[f64], dx: &[f64]) {
        self.state.begin(x);
        let [h, u, v] = super::rows::split(x, self.length);
        let [dh, du, _] = super::rows::split(dx, self.length * LANES);
        for i in 1..self.length {
            for k in i * LANES..(i + 1) * LANES {
                self.flux_x[2][k] = 0.5 * (h[i] + h[i - 1]) * du[k] + 0.5 * u[i] * (dh[k] + dh[k - LANES]);
            }
        }
        for i in 0..self.length {
            (self.half_wind[1][0][i], self.half_wind[1][1][i]) = (0.5 * u[i], 0.5 * v[i]);
        }
    }

    fn beyond_wall(&self, x: &[f64], ghost: &mut [f64], lanes: usize) {
        let winds = 2 * self.length * lanes;
        ghost[..winds].copy_from_slice(&x[..winds]);
        ghost[winds..].fill(0.0);
    }

    fn push(&mut self, row: usize, x: (&[f64], &[f64], &mut [f64]), dx: (&[f64], &[f64], &mut [f64])) {
        self.state.push(row, x.0, x.1, x.2);
        self.half_wind.rotate_left(1);
        self.flux_x.rotate_left(1);
        self.flux_y.rotate_left(1);
        self.q.rotate_left(1);
        self.bernoulli.rotate_left(1);
        let at_wall = self.model.layout.grid.boundary == Boundary::Channel && row == 1;
        self.arch.dispatch(Push { rows: self, at_wall, x: (x.0, x.1), south: dx.0, north: dx.1, tendency: dx.2 });
    }
}

/// One row of the columns, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b> {
    rows: &'a mut TangentRows<'b>,
    at_wall: bool,
    x: (&'a [f64], &'a [f64]),
    south: &'a [f64],
    north: &'a [f64],
    tendency: &'a mut [f64],
}

impl WithSimd for Push<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Push { rows, at_wall, x, south, north, tendency } = self;
        rows.linearise(x.0, x.1);
        let vector_len = S::as_simd_f64s(&[0.0; 2 * LANES]).0.len() / 2;
        match vector_len {
            1 => push::<S, 1>(simd, rows, south, north, tendency),
            2 => push::<S, 2>(simd, rows, south, north, tendency),
            4 => push::<S, 4>(simd, rows, south, north, tendency),
            8 => push::<S, 8>(simd, rows, south, north, tendency),
            _ => panic!("no processor has vectors of which {vector_len} make eight numbers"),
        }
        if at_wall {
            tendency[2 * rows.length * LANES..].fill(0.0);
        }
    }
}

/// With `P` vectors for the eight numbers of a place.
#[inline(always)]
fn push<S: Simd, const P: usize>(
    simd: S,
    rows: &mut TangentRows<'_>,
    south: &[f64],
    north: &[f64],
    tendency: &mut [f64],
) {
    diagnose::<S, P>(simd, rows, south, north);
    tendencies::<S, P>(simd, rows, south, tendency);
}

/// The places of a row.
#[inline(always)]
fn places<S: Simd, const P: usize>(row: &[f64]) -> &[[S::f64s; P]] {
    S::as_simd_f64s(row).0.as_chunks().0
}

/// The places of a row.
#[inline(always)]
fn places_mut<S: Simd, const P: usize>(row: &mut [f64]) -> &mut [[S::f64s; P]] {
    S::as_mut_simd_f64s(row).0.as_chunks_mut().0
}

/// δU, δV and δq of the northern row, δB of the southern.
#[inline(always)]
fn diagnose<S: Simd, const P: usize>(simd: S, rows: &mut TangentRows<'_>, south: &[f64], north: &[f64]) {
    let (length, n) = (rows.length, rows.length - 1);
    let ([h_s, u_s, v_s], [h, u, v]) =
        (super::rows::split(south, length * LANES), super::rows::split(north, length * LANES));
    let (h_s, u_s, v_s) = (places::<S, P>(h_s), places::<S, P>(u_s), places::<S, P>(v_s));
    let (h, u, v) = (places::<S, P>(h), places::<S, P>(u), places::<S, P>(v));
    let grid = &rows.model.layout.grid;
    let splat = |value: f64| simd.splat_f64s(value);
    let (per_dx, per_dy) = (splat(1.0 / grid.dx_m), splat(1.0 / grid.dy_m));
    let gravity = splat(rows.model.parameters.gravity_m_per_s2);
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let [thickness_x, thickness_y, per_thickness, quarter_q] = &rows.thickness;
    let [[half_u_s, half_v_s], [half_u, half_v]] = &rows.half_wind;
    let flux_x = &mut places_mut::<S, P>(&mut rows.flux_x[2])[1..][..n];
    let (first, flux_y) = places_mut::<S, P>(&mut rows.flux_y[1]).split_at_mut(1);
    let (flux_y, q) = (&mut flux_y[..n], &mut places_mut::<S, P>(&mut rows.q[1])[1..][..n]);
    let b = &mut places_mut::<S, P>(&mut rows.bernoulli[1])[..n];
    for c in 0..P {
        first[0][c] = add(mul(splat(thickness_y[0]), v[0][c]), mul(splat(half_v[0]), add(h[0][c], h_s[0][c])));
    }
    let (h_w, h, h_sw, h_s) = (&h[..n], &h[1..][..n], &h_s[..n], &h_s[1..][..n]);
    let (u, u_sw, u_s) = (&u[1..][..n], &u_s[..n], &u_s[1..][..n]);
    let (v_w, v, v_sw) = (&v[..n], &v[1..][..n], &v_s[..n]);
    let (thickness_x, thickness_y) = (&thickness_x[1..][..n], &thickness_y[1..][..n]);
    let (per_thickness, quarter_q) = (&per_thickness[1..][..n], &quarter_q[1..][..n]);
    let (half_u_sw, half_u_s, half_u) = (&half_u_s[..n], &half_u_s[1..][..n], &half_u[1..][..n]);
    let (half_v_sw, half_v_w, half_v) = (&half_v_s[..n], &half_v[..n], &half_v[1..][..n]);
    for i in 0..n {
        let (thickness_x, thickness_y) = (splat(thickness_x[i]), splat(thickness_y[i]));
        let (per_thickness, quarter_q) = (splat(per_thickness[i]), splat(quarter_q[i]));
        let (half_u, half_u_sw, half_u_s) = (splat(half_u[i]), splat(half_u_sw[i]), splat(half_u_s[i]));
        let (half_v, half_v_sw, half_v_w) = (splat(half_v[i]), splat(half_v_sw[i]), splat(half_v_w[i]));
        for c in 0..P {
            let (sum, sum_s) = (add(h[i][c], h_w[i][c]), add(h_s[i][c], h_sw[i][c]));
            flux_x[i][c] = add(mul(thickness_x, u[i][c]), mul(half_u, sum));
            flux_y[i][c] = add(mul(thickness_y, v[i][c]), mul(half_v, add(h[i][c], h_s[i][c])));
            let (dv, du) = (sub(v[i][c], v_w[i][c]), sub(u[i][c], u_s[i][c]));
            let vorticity = sub(mul(dv, per_dx), mul(du, per_dy));
            q[i][c] = sub(mul(vorticity, per_thickness), mul(quarter_q, add(sum, sum_s)));
            let kinetic_x = add(mul(half_u_sw, u_sw[i][c]), mul(half_u_s, u_s[i][c]));
            let kinetic_y = add(mul(half_v_sw, v_sw[i][c]), mul(half_v_w, v_w[i][c]));
            b[i][c] = add(mul(gravity, h_sw[i][c]), add(kinetic_x, kinetic_y));
        }
    }
}

/// The tendencies of the southern row.
#[inline(always)]
fn tendencies<S: Simd, const P: usize>(simd: S, rows: &TangentRows<'_>, south: &[f64], tendency: &mut [f64]) {
    let (length, n) = (rows.length, rows.length - 2);
    let grid = &rows.model.layout.grid;
    let splat = |value: f64| simd.splat_f64s(value);
    let (per_dx, per_dy) = (splat(1.0 / grid.dx_m), splat(1.0 / grid.dy_m));
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let (k_h, winds) = tendency.split_at_mut(length * LANES);
    let (k_u, k_v) = winds.split_at_mut(length * LANES);
    let (k_h, k_u) = (&mut places_mut::<S, P>(k_h)[1..][..n], &mut places_mut::<S, P>(k_u)[1..][..n]);
    let k_v = &mut places_mut::<S, P>(k_v)[1..][..n];
    let (u_s, u) = (places::<S, P>(&rows.flux_x[0]), places::<S, P>(&rows.flux_x[1]));
    let (v, v_n) = (places::<S, P>(&rows.flux_y[0]), places::<S, P>(&rows.flux_y[1]));
    let (q, q_n) = (places::<S, P>(&rows.q[0]), places::<S, P>(&rows.q[1]));
    let (b_s, b) = (places::<S, P>(&rows.bernoulli[0]), places::<S, P>(&rows.bernoulli[1]));
    let (u, u_e, u_s, u_se) = (&u[1..][..n], &u[2..][..n], &u_s[1..][..n], &u_s[2..][..n]);
    let (v, v_w, v_n, v_nw) = (&v[1..][..n], &v[..n], &v_n[1..][..n], &v_n[..n]);
    let (q, q_e, q_n) = (&q[1..][..n], &q[2..][..n], &q_n[1..][..n]);
    let (b, b_w, b_s) = (&b[1..][..n], &b[..n], &b_s[1..][..n]);
    let [a, a_n, m, m_n, c, c_e, d, d_e] = rows.vorticity_term.each_ref().map(|row| &row[1..][..n]);
    for i in 0..n {
        let (a, a_n, m, m_n) = (splat(a[i]), splat(a_n[i]), splat(m[i]), splat(m_n[i]));
        let (c, c_e, d, d_e) = (splat(c[i]), splat(c_e[i]), splat(d[i]), splat(d_e[i]));
        for k in 0..P {
            k_h[i][k] = add(mul(sub(u[i][k], u_e[i][k]), per_dx), mul(sub(v[i][k], v_n[i][k]), per_dy));
            let of_q = add(mul(a, q[i][k]), mul(a_n, q_n[i][k]));
            let of_flux = add(mul(m, add(v[i][k], v_w[i][k])), mul(m_n, add(v_n[i][k], v_nw[i][k])));
            k_u[i][k] = add(mul(sub(b_w[i][k], b[i][k]), per_dx), add(of_q, of_flux));
            let of_q = add(mul(c, q[i][k]), mul(c_e, q_e[i][k]));
            let of_flux = add(mul(d, add(u[i][k], u_s[i][k])), mul(d_e, add(u_e[i][k], u_se[i][k])));
            k_v[i][k] = sub(mul(sub(b_s[i][k], b[i][k]), per_dy), add(of_q, of_flux));
        }
    }
    let drag = rows.model.parameters.drag_per_s;
    if drag != 0.0 {
        let [_, u, v] = super::rows::split(south, length * LANES);
        let (u, v) = (&places::<S, P>(u)[1..][..n], &places::<S, P>(v)[1..][..n]);
        for i in 0..n {
            for k in 0..P {
                k_u[i][k] = sub(k_u[i][k], mul(splat(drag), u[i][k]));
                k_v[i][k] = sub(k_v[i][k], mul(splat(drag), v[i][k]));
            }
        }
    }
}
