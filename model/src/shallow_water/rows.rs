//! The nonlinear tendency row by row: the lines of [`super::tendency`] in one pass, with the diagnostic fields of two
//! or three rows in cache instead of on the whole grid. The bits are those of [`super::tendency`].

use super::{ShallowWater, VectorInvariant};
use crate::grid::Boundary;
use crate::rows::RowStream;
use pulp::{Simd, WithSimd};

/// Diagnostic rows of a sweep: the last is that of the row pushed last, unless said otherwise.
pub(super) struct ShallowWaterRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    length: usize,
    /// U of three rows.
    flux_x: [Vec<f64>; 3],
    /// V of two rows.
    flux_y: [Vec<f64>; 2],
    /// q of two rows.
    q: [Vec<f64>; 2],
    /// B of the two rows before the last.
    bernoulli: [Vec<f64>; 2],
}

impl<'a> ShallowWaterRows<'a> {
    /// For rows of `length` values per variable, rim included.
    pub fn new(model: &'a ShallowWater, length: usize) -> Self {
        let row = || vec![0.0; length];
        Self {
            model,
            arch: pulp::Arch::new(),
            length,
            flux_x: [row(), row(), row()],
            flux_y: [row(), row()],
            q: [row(), row()],
            bernoulli: [row(), row()],
        }
    }
}

/// The three variables of a row.
#[inline(always)]
fn split(x: &[f64], length: usize) -> [&[f64]; 3] {
    [&x[..length], &x[length..2 * length], &x[2 * length..3 * length]]
}

impl RowStream for ShallowWaterRows<'_> {
    fn begin(&mut self, first: &[f64]) {
        let [h, u, _] = split(first, self.length);
        for i in 1..self.length {
            self.flux_x[2][i] = 0.5 * (h[i] + h[i - 1]) * u[i];
        }
    }

    /// h and u continued evenly, v = 0.
    fn beyond_wall(&self, x: &[f64], ghost: &mut [f64]) {
        let winds = 2 * self.length;
        ghost[..winds].copy_from_slice(&x[..winds]);
        ghost[winds..].fill(0.0);
    }

    fn push(&mut self, row: usize, south: &[f64], north: &[f64], tendency: &mut [f64]) {
        self.flux_x.rotate_left(1);
        self.flux_y.rotate_left(1);
        self.q.rotate_left(1);
        self.bernoulli.rotate_left(1);
        self.arch.dispatch(Push { rows: self, row, south, north, tendency });
    }
}

/// One row, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b> {
    rows: &'a mut ShallowWaterRows<'b>,
    row: usize,
    south: &'a [f64],
    north: &'a [f64],
    tendency: &'a mut [f64],
}

impl WithSimd for Push<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Push { rows, row, south, north, tendency } = self;
        let ShallowWaterRows { model, length, flux_x, flux_y, q, bernoulli, .. } = rows;
        let (grid, length) = (&model.layout.grid, *length);
        let (per_dx, per_dy) = (1.0 / grid.dx_m, 1.0 / grid.dy_m);
        let coriolis = model.coriolis_per_s(row);
        let [h_s, u_s, v_s] = split(south, length);
        let [h_n, u_n, v_n] = split(north, length);
        fluxes(h_s, h_n, u_n, v_n, &mut flux_x[2], &mut flux_y[1]);
        vorticity(coriolis, [per_dx, per_dy], h_s, h_n, u_s, u_n, v_n, &mut q[1]);
        bernoulli_row(model.parameters.gravity_m_per_s2, h_s, u_s, v_s, v_n, &mut bernoulli[1]);
        let (k_h, winds) = tendency.split_at_mut(length);
        let (k_u, k_v) = winds.split_at_mut(length);
        divergence([per_dx, per_dy], &flux_x[1], &flux_y[0], &flux_y[1], k_h);
        momentum_x(model.form, per_dx, &bernoulli[1], &q[0], &q[1], &flux_y[0], &flux_y[1], k_u);
        // The tendency is that of the row south of the one pushed.
        let southern_wall = grid.boundary == Boundary::Channel && row == 1;
        if southern_wall {
            k_v.fill(0.0);
        } else {
            momentum_y(model.form, per_dy, &bernoulli[0], &bernoulli[1], &q[0], &flux_x[0], &flux_x[1], k_v);
        }
        let drag = model.parameters.drag_per_s;
        if drag != 0.0 {
            add_drag(drag, u_s, k_u);
            if !southern_wall {
                add_drag(drag, v_s, k_v);
            }
        }
    }
}

/// U and V of the northern row.
#[inline(always)]
fn fluxes(h_s: &[f64], h_n: &[f64], u_n: &[f64], v_n: &[f64], flux_x: &mut [f64], flux_y: &mut [f64]) {
    let n = h_s.len() - 1;
    let (h_w, h_e, u_e, flux_x) = (&h_n[..n], &h_n[1..=n], &u_n[1..=n], &mut flux_x[1..=n]);
    for i in 0..n {
        flux_x[i] = 0.5 * (h_e[i] + h_w[i]) * u_e[i];
    }
    let (h_s, h_n, v_n, flux_y) = (&h_s[..=n], &h_n[..=n], &v_n[..=n], &mut flux_y[..=n]);
    for i in 0..=n {
        flux_y[i] = 0.5 * (h_n[i] + h_s[i]) * v_n[i];
    }
}

/// q of the northern row.
#[inline(always)]
fn vorticity(
    coriolis: f64,
    [per_dx, per_dy]: [f64; 2],
    h_s: &[f64],
    h_n: &[f64],
    u_s: &[f64],
    u_n: &[f64],
    v_n: &[f64],
    q: &mut [f64],
) {
    let n = h_s.len() - 1;
    let (h0, h_w, h_s, h_sw) = (&h_n[1..=n], &h_n[..n], &h_s[1..=n], &h_s[..n]);
    let (u0, u_s, v0, v_w, q) = (&u_n[1..=n], &u_s[1..=n], &v_n[1..=n], &v_n[..n], &mut q[1..=n]);
    for i in 0..n {
        let vorticity = (v0[i] - v_w[i]) * per_dx - (u0[i] - u_s[i]) * per_dy;
        q[i] = 4.0 * (coriolis + vorticity) / (h0[i] + h_w[i] + h_s[i] + h_sw[i]);
    }
}

/// B of the southern row.
#[inline(always)]
fn bernoulli_row(gravity: f64, h: &[f64], u: &[f64], v: &[f64], v_n: &[f64], b: &mut [f64]) {
    let n = h.len() - 1;
    let (h, u0, u_e, v, v_n, b) = (&h[..n], &u[..n], &u[1..=n], &v[..n], &v_n[..n], &mut b[..n]);
    for i in 0..n {
        b[i] = gravity * h[i] + 0.25 * (u0[i] * u0[i] + u_e[i] * u_e[i] + v[i] * v[i] + v_n[i] * v_n[i]);
    }
}

/// −δx U/dx − δy V/dy.
#[inline(always)]
fn divergence([per_dx, per_dy]: [f64; 2], flux_x: &[f64], flux_y: &[f64], flux_y_n: &[f64], out: &mut [f64]) {
    let n = out.len() - 2;
    let (west, east, south, north) = (&flux_x[1..=n], &flux_x[2..n + 2], &flux_y[1..=n], &flux_y_n[1..=n]);
    let out = &mut out[1..=n];
    for i in 0..n {
        out[i] = (west[i] - east[i]) * per_dx + (south[i] - north[i]) * per_dy;
    }
}

/// −δx B/dx + q V.
#[inline(always)]
fn momentum_x(
    form: VectorInvariant,
    per_dx: f64,
    b: &[f64],
    q: &[f64],
    q_n: &[f64],
    flux_y: &[f64],
    flux_y_n: &[f64],
    out: &mut [f64],
) {
    let n = out.len() - 2;
    let (b_w, b, q, q_n) = (&b[..n], &b[1..=n], &q[1..=n], &q_n[1..=n]);
    let (v, v_w, v_n, v_nw) = (&flux_y[1..=n], &flux_y[..n], &flux_y_n[1..=n], &flux_y_n[..n]);
    let out = &mut out[1..=n];
    match form {
        VectorInvariant::PotentialEnstrophy => {
            for i in 0..n {
                out[i] = (b_w[i] - b[i]) * per_dx + 0.125 * (q[i] + q_n[i]) * (v[i] + v_w[i] + v_n[i] + v_nw[i]);
            }
        }
        VectorInvariant::Energy => {
            for i in 0..n {
                out[i] = (b_w[i] - b[i]) * per_dx + 0.25 * (q[i] * (v[i] + v_w[i]) + q_n[i] * (v_n[i] + v_nw[i]));
            }
        }
    }
}

/// −δy B/dy − q U.
#[inline(always)]
fn momentum_y(
    form: VectorInvariant,
    per_dy: f64,
    b_s: &[f64],
    b: &[f64],
    q: &[f64],
    flux_x_s: &[f64],
    flux_x: &[f64],
    out: &mut [f64],
) {
    let n = out.len() - 2;
    let (b_s, b, q, q_e) = (&b_s[1..=n], &b[1..=n], &q[1..=n], &q[2..n + 2]);
    let (u, u_e, u_s, u_se) = (&flux_x[1..=n], &flux_x[2..n + 2], &flux_x_s[1..=n], &flux_x_s[2..n + 2]);
    let out = &mut out[1..=n];
    match form {
        VectorInvariant::PotentialEnstrophy => {
            for i in 0..n {
                out[i] = (b_s[i] - b[i]) * per_dy - 0.125 * (q[i] + q_e[i]) * (u[i] + u_e[i] + u_s[i] + u_se[i]);
            }
        }
        VectorInvariant::Energy => {
            for i in 0..n {
                out[i] = (b_s[i] - b[i]) * per_dy - 0.25 * (q[i] * (u[i] + u_s[i]) + q_e[i] * (u_e[i] + u_se[i]));
            }
        }
    }
}

/// −r u.
#[inline(always)]
fn add_drag(drag: f64, wind: &[f64], out: &mut [f64]) {
    for (out, wind) in out.iter_mut().zip(wind) {
        *out -= drag * wind;
    }
}
