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
        diagnose(simd, rows, south, north);
        tendencies(simd, rows, south, tendency, at_wall);
    }
}

/// Vectors of the three variables.
#[inline(always)]
fn vectors<S: Simd>(x: &[f64], length: usize) -> [&[S::f64s]; 3] {
    super::rows::split(x, length * LANES).map(|x| S::as_simd_f64s(x).0)
}

/// δU, δV and δq of the northern row, δB of the southern.
#[inline(always)]
fn diagnose<S: Simd>(simd: S, rows: &mut TangentRows<'_>, south: &[f64], north: &[f64]) {
    let length = rows.length;
    let ([h_s, u_s, v_s], [h_n, u_n, v_n]) = (vectors::<S>(south, length), vectors::<S>(north, length));
    let per_cell = h_s.len() / length;
    let grid = &rows.model.layout.grid;
    let splat = |value: f64| simd.splat_f64s(value);
    let (per_dx, per_dy) = (splat(1.0 / grid.dx_m), splat(1.0 / grid.dy_m));
    let gravity = splat(rows.model.parameters.gravity_m_per_s2);
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let [thickness_x, thickness_y, per_thickness, quarter_q] = rows.thickness.each_ref().map(|row| &row[..length]);
    let [[half_u_s, half_v_s], [half_u, half_v]] =
        rows.half_wind.each_ref().map(|row| row.each_ref().map(|row| &row[..length]));
    let flux_x = S::as_mut_simd_f64s(&mut rows.flux_x[2]).0;
    let flux_y = S::as_mut_simd_f64s(&mut rows.flux_y[1]).0;
    let q = S::as_mut_simd_f64s(&mut rows.q[1]).0;
    let bernoulli = S::as_mut_simd_f64s(&mut rows.bernoulli[1]).0;
    let all = length * per_cell;
    let (flux_x, flux_y, q, bernoulli) = (&mut flux_x[..all], &mut flux_y[..all], &mut q[..all], &mut bernoulli[..all]);
    let (h_s, u_s, v_s, h_n, u_n, v_n) = (&h_s[..all], &u_s[..all], &v_s[..all], &h_n[..all], &u_n[..all], &v_n[..all]);
    for k in 0..per_cell {
        flux_y[k] = add(mul(splat(thickness_y[0]), v_n[k]), mul(splat(half_v[0]), add(h_n[k], h_s[k])));
    }
    for i in 1..length {
        let (thickness_x, thickness_y, half_u_n, half_v_n) =
            (splat(thickness_x[i]), splat(thickness_y[i]), splat(half_u[i]), splat(half_v[i]));
        let (per_thickness, quarter_q) = (splat(per_thickness[i]), splat(quarter_q[i]));
        let (u_here, u_west) = (splat(half_u_s[i]), splat(half_u_s[i - 1]));
        let (v_here, v_north) = (splat(half_v_s[i - 1]), splat(half_v[i - 1]));
        for k in i * per_cell..(i + 1) * per_cell {
            let w = k - per_cell;
            let (h_x, h_sum_s) = (add(h_n[k], h_n[w]), add(h_s[k], h_s[w]));
            flux_x[k] = add(mul(thickness_x, u_n[k]), mul(half_u_n, h_x));
            flux_y[k] = add(mul(thickness_y, v_n[k]), mul(half_v_n, add(h_n[k], h_s[k])));
            let vorticity = sub(mul(sub(v_n[k], v_n[w]), per_dx), mul(sub(u_n[k], u_s[k]), per_dy));
            q[k] = sub(mul(vorticity, per_thickness), mul(quarter_q, add(h_x, h_sum_s)));
            let kinetic_x = add(mul(u_west, u_s[w]), mul(u_here, u_s[k]));
            let kinetic_y = add(mul(v_here, v_s[w]), mul(v_north, v_n[w]));
            bernoulli[w] = add(mul(gravity, h_s[w]), add(kinetic_x, kinetic_y));
        }
    }
}

/// The tendencies of the southern row.
#[inline(always)]
fn tendencies<S: Simd>(simd: S, rows: &TangentRows<'_>, south: &[f64], tendency: &mut [f64], at_wall: bool) {
    let length = rows.length;
    let [_, du, dv] = vectors::<S>(south, length);
    let grid = &rows.model.layout.grid;
    let splat = |value: f64| simd.splat_f64s(value);
    let (per_dx, per_dy) = (splat(1.0 / grid.dx_m), splat(1.0 / grid.dy_m));
    let drag = rows.model.parameters.drag_per_s;
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let (k_h, winds) = tendency.split_at_mut(length * LANES);
    let (k_u, k_v) = winds.split_at_mut(length * LANES);
    let (k_h, k_u, k_v) = (S::as_mut_simd_f64s(k_h).0, S::as_mut_simd_f64s(k_u).0, S::as_mut_simd_f64s(k_v).0);
    let all = k_h.len();
    let (per_cell, k_u, k_v) = (all / length, &mut k_u[..all], &mut k_v[..all]);
    let [u_s, u0] = [&rows.flux_x[0], &rows.flux_x[1]].map(|row| &S::as_simd_f64s(row).0[..all]);
    let [v0, v_n] = [&rows.flux_y[0], &rows.flux_y[1]].map(|row| &S::as_simd_f64s(row).0[..all]);
    let [q0, q_n] = [&rows.q[0], &rows.q[1]].map(|row| &S::as_simd_f64s(row).0[..all]);
    let [b_s, b0] = [&rows.bernoulli[0], &rows.bernoulli[1]].map(|row| &S::as_simd_f64s(row).0[..all]);
    let [a, a_n, b, b_n, c, c_e, d, d_e] = rows.vorticity_term.each_ref().map(|row| &row[..length]);
    for i in 1..length - 1 {
        let (a, a_n, b, b_n) = (splat(a[i]), splat(a_n[i]), splat(b[i]), splat(b_n[i]));
        let (c, c_e, d, d_e) = (splat(c[i]), splat(c_e[i]), splat(d[i]), splat(d_e[i]));
        for k in i * per_cell..(i + 1) * per_cell {
            let (w, e) = (k - per_cell, k + per_cell);
            k_h[k] = add(mul(sub(u0[k], u0[e]), per_dx), mul(sub(v0[k], v_n[k]), per_dy));
            let of_q = add(mul(a, q0[k]), mul(a_n, q_n[k]));
            let of_flux = add(mul(b, add(v0[k], v0[w])), mul(b_n, add(v_n[k], v_n[w])));
            k_u[k] = add(mul(sub(b0[w], b0[k]), per_dx), add(of_q, of_flux));
            let of_q = add(mul(c, q0[k]), mul(c_e, q0[e]));
            let of_flux = add(mul(d, add(u0[k], u_s[k])), mul(d_e, add(u0[e], u_s[e])));
            k_v[k] = sub(mul(sub(b_s[k], b0[k]), per_dy), add(of_q, of_flux));
        }
    }
    if drag != 0.0 {
        for k in per_cell..all - per_cell {
            k_u[k] = sub(k_u[k], mul(splat(drag), du[k]));
            k_v[k] = sub(k_v[k], mul(splat(drag), dv[k]));
        }
    }
    if at_wall {
        k_v.fill(splat(0.0));
    }
}
