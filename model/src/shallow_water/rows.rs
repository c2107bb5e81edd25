//! The nonlinear tendency row by row: the lines of [`super::tendency`] in one pass, with the diagnostic fields of two
//! or three rows in cache instead of on the whole grid. The bits are those of [`super::tendency`].

use super::{H, ShallowWater, U, V, VectorInvariant};
use crate::grid::Boundary;
use crate::scheme::rows::{Row, RowStream};
use pulp::{Simd, WithSimd};

/// Diagnostic rows of a sweep: the last is that of the row pushed last, unless said otherwise.
///
/// Stencils reach east in U and q, whose rows have their first value again at the end, and west in V and B, whose rows
/// have their last value also at the beginning.
pub(super) struct ShallowWaterRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
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
    /// For rows of `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        let row = || vec![0.0; nx + 1];
        Self {
            model,
            arch: pulp::Arch::new(),
            flux_x: [row(), row(), row()],
            flux_y: [row(), row()],
            q: [row(), row()],
            bernoulli: [row(), row()],
        }
    }
}

impl RowStream for ShallowWaterRows<'_> {
    fn begin(&mut self, first: Row<'_>) {
        let (h, u, flux) = (first.variable(H), first.variable(U), &mut self.flux_x[2]);
        let nx = h.len();
        for i in 0..nx {
            flux[i] = 0.5 * (h[i] + h[if i == 0 { nx - 1 } else { i - 1 }]) * u[i];
        }
        flux[nx] = flux[0];
    }

    /// h and u continued evenly, v = 0.
    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        let nx = x.variable(H).len();
        ghost[..nx].copy_from_slice(x.variable(H));
        ghost[nx..2 * nx].copy_from_slice(x.variable(U));
        ghost[2 * nx..].fill(0.0);
    }

    fn push(&mut self, row: usize, south: Row<'_>, north: Row<'_>, tendency: &mut [f64]) {
        self.flux_x.swap(0, 1);
        self.flux_x.swap(1, 2);
        self.flux_y.swap(0, 1);
        self.q.swap(0, 1);
        self.bernoulli.swap(0, 1);
        self.arch.dispatch(Push { rows: self, row, south, north, tendency });
    }
}

/// One row, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b> {
    rows: &'a mut ShallowWaterRows<'b>,
    row: usize,
    south: Row<'a>,
    north: Row<'a>,
    tendency: &'a mut [f64],
}

impl WithSimd for Push<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Push { rows, row, south, north, tendency } = self;
        let ShallowWaterRows { model, flux_x, flux_y, q, bernoulli, .. } = rows;
        let grid = &model.layout.grid;
        let constants = Constants {
            coriolis: model.coriolis_per_s(row),
            gravity: model.parameters.gravity_m_per_s2,
            per_dx: 1.0 / grid.dx_m,
            per_dy: 1.0 / grid.dy_m,
        };
        diagnose(constants, south, north, &mut flux_x[2], &mut flux_y[1], &mut q[1], &mut bernoulli[1]);
        let nx = north.variable(H).len();
        let (k_h, winds) = tendency.split_at_mut(nx);
        let (k_u, k_v) = winds.split_at_mut(nx);
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
            add_drag(drag, south.variable(U), k_u);
            if !southern_wall {
                add_drag(drag, south.variable(V), k_v);
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
    south: Row<'_>,
    north: Row<'_>,
    flux_x: &mut [f64],
    flux_y: &mut [f64],
    q: &mut [f64],
    b: &mut [f64],
) {
    let ([h_s, u_s, v_s], [h, u, v]) = (south.variables(), north.variables());
    let last = h.len() - 1;
    // The first place, west of which is the last.
    (flux_x[0], flux_y[1], q[0], b[last + 1]) =
        constants.place([h[0], h[last], h_s[0], h_s[last]], [u[0], u_s[0], u_s[last]], [v[0], v[last], v_s[last]]);
    let n = last;
    let (h, h_w, h_s, h_sw) = (&h[1..][..n], &h[..n], &h_s[1..][..n], &h_s[..n]);
    let (u, u_s, u_sw) = (&u[1..][..n], &u_s[1..][..n], &u_s[..n]);
    let (v, v_w, v_sw) = (&v[1..][..n], &v[..n], &v_s[..n]);
    {
        let (flux_x, flux_y) = (&mut flux_x[1..][..n], &mut flux_y[2..][..n]);
        let (q, b) = (&mut q[1..][..n], &mut b[1..][..n]);
        for i in 0..n {
            (flux_x[i], flux_y[i], q[i], b[i]) =
                constants.place([h[i], h_w[i], h_s[i], h_sw[i]], [u[i], u_s[i], u_sw[i]], [v[i], v_w[i], v_sw[i]]);
        }
    }
    (flux_x[last + 1], flux_y[0], q[last + 1], b[0]) = (flux_x[0], flux_y[last + 1], q[0], b[last + 1]);
}

impl Constants {
    /// U, V and q of a place of the northern row, and B south-west of it.
    #[inline(always)]
    fn place(self, [h, h_w, h_s, h_sw]: [f64; 4], [u, u_s, u_sw]: [f64; 3], v: [f64; 3]) -> (f64, f64, f64, f64) {
        let Constants { coriolis, gravity, per_dx, per_dy } = self;
        let [v, v_w, v_sw] = v;
        let vorticity = (v - v_w) * per_dx - (u - u_s) * per_dy;
        (
            0.5 * (h + h_w) * u,
            0.5 * (h + h_s) * v,
            4.0 * (coriolis + vorticity) / (h + h_w + h_s + h_sw),
            gravity * h_sw + 0.25 * (u_sw * u_sw + u_s * u_s + v_sw * v_sw + v_w * v_w),
        )
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
            let n = out_h.len();
            let (u0, u_e, u_s, u_se) = (&flux_x[..n], &flux_x[1..][..n], &flux_x_s[..n], &flux_x_s[1..][..n]);
            let (v0, v_w, v_n, v_nw) = (&flux_y[1..][..n], &flux_y[..n], &flux_y_n[1..][..n], &flux_y_n[..n]);
            let (q0, q_e, q_n) = (&q[..n], &q[1..][..n], &q_n[..n]);
            let (b0, b_w, b_s) = (&b[1..][..n], &b[..n], &b_s[1..][..n]);
            let (out_u, out_v) = (&mut out_u[..n], &mut out_v[..n]);
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
