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
    pub(super) flux_x: [Vec<f64>; 3],
    /// V of two rows.
    pub(super) flux_y: [Vec<f64>; 2],
    /// q of two rows.
    pub(super) q: [Vec<f64>; 2],
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
pub(super) fn split(x: &[f64], length: usize) -> [&[f64]; 3] {
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
        let constants = Constants { coriolis, gravity: model.parameters.gravity_m_per_s2, per_dx, per_dy };
        let ([_, _, flux_x_n], [_, flux_y_n]) = (&mut *flux_x, &mut *flux_y);
        diagnose(constants, h_s, u_s, v_s, h_n, u_n, v_n, flux_x_n, flux_y_n, &mut q[1], &mut bernoulli[1]);
        let (k_h, winds) = tendency.split_at_mut(length);
        let (k_u, k_v) = winds.split_at_mut(length);
        let (flux_x, flux_y) = ([&flux_x[0][..], &flux_x[1][..]], [&flux_y[0][..], &flux_y[1][..]]);
        let (q, b) = ([&q[0][..], &q[1][..]], [&bernoulli[0][..], &bernoulli[1][..]]);
        match model.form {
            VectorInvariant::PotentialEnstrophy => {
                potential_enstrophy_form(constants, flux_x, flux_y, q, b, k_h, k_u, k_v);
            }
            VectorInvariant::Energy => energy_form(constants, flux_x, flux_y, q, b, k_h, k_u, k_v),
        }
        // The tendency is that of the row south of the one pushed.
        let southern_wall = grid.boundary == Boundary::Channel && row == 1;
        if southern_wall {
            k_v.fill(0.0);
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

/// Numbers of the equations.
#[derive(Clone, Copy)]
struct Constants {
    /// f at the corners of the northern row.
    coriolis: f64,
    gravity: f64,
    per_dx: f64,
    per_dy: f64,
}

/// U, V and q of the northern row, B of the southern, in one loop.
#[inline(always)]
fn diagnose(
    constants: Constants,
    h_s: &[f64],
    u_s: &[f64],
    v_s: &[f64],
    h_n: &[f64],
    u_n: &[f64],
    v_n: &[f64],
    flux_x: &mut [f64],
    flux_y: &mut [f64],
    q: &mut [f64],
    b: &mut [f64],
) {
    let Constants { coriolis, gravity, per_dx, per_dy } = constants;
    flux_y[0] = 0.5 * (h_n[0] + h_s[0]) * v_n[0];
    let n = h_s.len() - 1;
    let (h0, h_w, h_s, h_sw) = (&h_n[1..][..n], &h_n[..n], &h_s[1..][..n], &h_s[..n]);
    let (u0, u_s, u_sw) = (&u_n[1..][..n], &u_s[1..][..n], &u_s[..n]);
    let (v0, v_w, v_sw) = (&v_n[1..][..n], &v_n[..n], &v_s[..n]);
    let (flux_x, flux_y) = (&mut flux_x[1..][..n], &mut flux_y[1..][..n]);
    let (q, b) = (&mut q[1..][..n], &mut b[..n]);
    for i in 0..n {
        flux_x[i] = 0.5 * (h0[i] + h_w[i]) * u0[i];
        flux_y[i] = 0.5 * (h0[i] + h_s[i]) * v0[i];
        let vorticity = (v0[i] - v_w[i]) * per_dx - (u0[i] - u_s[i]) * per_dy;
        q[i] = 4.0 * (coriolis + vorticity) / (h0[i] + h_w[i] + h_s[i] + h_sw[i]);
        b[i] = gravity * h_sw[i] + 0.25 * (u_sw[i] * u_sw[i] + u_s[i] * u_s[i] + v_sw[i] * v_sw[i] + v_w[i] * v_w[i]);
    }
}

macro_rules! tendencies {
    ($(#[$doc:meta])* $name:ident, |$q:ident, $q_e:ident, $q_n:ident, $u:ident, $v:ident| $q_v:expr, $q_u:expr) => {
        $(#[$doc])*
        #[inline(always)]
        fn $name(
            constants: Constants,
            [flux_x_s, flux_x]: [&[f64]; 2],
            [flux_y, flux_y_n]: [&[f64]; 2],
            [q, q_n]: [&[f64]; 2],
            [b_s, b]: [&[f64]; 2],
            out_h: &mut [f64],
            out_u: &mut [f64],
            out_v: &mut [f64],
        ) {
            let Constants { per_dx, per_dy, .. } = constants;
            let n = out_h.len() - 2;
            let (u0, u_e, u_s, u_se) =
                (&flux_x[1..][..n], &flux_x[2..][..n], &flux_x_s[1..][..n], &flux_x_s[2..][..n]);
            let (v0, v_w, v_n, v_nw) = (&flux_y[1..][..n], &flux_y[..n], &flux_y_n[1..][..n], &flux_y_n[..n]);
            let (q0, q_e, q_n) = (&q[1..][..n], &q[2..][..n], &q_n[1..][..n]);
            let (b0, b_w, b_s) = (&b[1..][..n], &b[..n], &b_s[1..][..n]);
            let (out_h, out_u, out_v) = (&mut out_h[1..][..n], &mut out_u[1..][..n], &mut out_v[1..][..n]);
            for i in 0..n {
                let ($q, $q_e, $q_n) = (q0[i], q_e[i], q_n[i]);
                let ($u, $v) = ([u0[i], u_e[i], u_s[i], u_se[i]], [v0[i], v_w[i], v_n[i], v_nw[i]]);
                out_h[i] = (u0[i] - u_e[i]) * per_dx + (v0[i] - v_n[i]) * per_dy;
                out_u[i] = (b_w[i] - b0[i]) * per_dx + $q_v;
                out_v[i] = (b_s[i] - b0[i]) * per_dy - $q_u;
            }
        }
    };
}

tendencies!(
    /// The tendencies of a row with q̄ʸ V̄ˣʸ, −q̄ˣ Ūˣʸ: U of the row and south of it, V and q of the row and north of
    /// it, B as U.
    potential_enstrophy_form,
    |q, q_e, q_n, u, v| 0.125 * (q + q_n) * (v[0] + v[1] + v[2] + v[3]),
    0.125 * (q + q_e) * (u[0] + u[1] + u[2] + u[3])
);

tendencies!(
    /// The same with mean_y(q V̄ˣ), −mean_x(q Ūʸ).
    energy_form,
    |q, q_e, q_n, u, v| 0.25 * (q * (v[0] + v[1]) + q_n * (v[2] + v[3])),
    0.25 * (q * (u[0] + u[2]) + q_e * (u[1] + u[3]))
);

/// −r u.
#[inline(always)]
fn add_drag(drag: f64, wind: &[f64], out: &mut [f64]) {
    for (out, wind) in out.iter_mut().zip(wind) {
        *out -= drag * wind;
    }
}
