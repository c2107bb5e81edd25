//! The adjoint tendency row by row for one column or eight at once: the lines of [`super::adjoint`], of which those of a row
//! reach one row south and north. Beside a wall the rows beyond it are zero, and the corners on it, which are the mean of h on
//! either side and have no vorticity, count twice for h and not for u and v.

use super::adjoint_lanes::{self, Rows};
use super::kernel::Constants;
use super::row_coefficients::RowCoefficients;
use super::rows::ShallowWaterRows;
use super::{ShallowWater, U, V};
use crate::columns::LANES;
use crate::grid::Boundary;
use crate::scheme::rows::{AdjointRowStream, Pushed, Row, RowStream};
use crate::scheme::strips::periodic_row;

use pulp::{Simd, WithSimd};

/// h, u and v.
const VARIABLES: usize = 3;

/// Gradients with respect to the diagnostic quantities of the rows of a sweep, `[x, lane]`, of `L` columns. Place i is at i + 1.
pub(super) struct AdjointRows<'a, const L: usize> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    state: ShallowWaterRows<'a>,
    coefficients: RowCoefficients,
    /// Of the row before the one pushed last.
    flux_x: Vec<[f64; L]>,
    /// Of the last two rows, from the south.
    flux_y: [Vec<[f64; L]>; 2],
    /// q* / h̄ˣʸ of the last two rows.
    vorticity: [Vec<[f64; L]>; 2],
    /// q q* / (4 h̄ˣʸ) of the last two rows.
    thickness: [Vec<[f64; L]>; 2],
    /// Of the two rows before the last.
    bernoulli: [Vec<[f64; L]>; 2],
    /// The row beyond a wall, which is zero.
    beyond: Vec<f64>,
}

impl<'a, const L: usize> AdjointRows<'a, L> {
    /// For rows of at most `nx` places, where rows of increments come `delay` rows after those of the state.
    pub fn new(model: &'a ShallowWater, nx: usize, delay: usize) -> Self {
        let row = || vec![[0.0; L]; nx + 2];
        Self {
            model,
            arch: pulp::Arch::new(),
            state: ShallowWaterRows::new(model, nx),
            coefficients: RowCoefficients::new(model, nx, delay + 2),
            flux_x: row(),
            flux_y: [row(), row()],
            vorticity: [row(), row()],
            thickness: [row(), row()],
            bernoulli: [row(), row()],
            beyond: vec![0.0; (nx + 2) * L],
        }
    }
}

impl<const L: usize> AdjointRowStream for AdjointRows<'_, L> {
    fn begin(&mut self, row: isize, x: Row<'_>) {
        self.state.begin(x);
        self.coefficients.begin(row, x);
    }

    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        self.state.beyond_wall(x, ghost);
    }

    fn push_state(&mut self, row: isize, x: Pushed<'_>) {
        self.state.push(self.model.grid_row(row), x.south, x.north, x.tendency);
        self.arch.dispatch(PushState { rows: self, row, x: [x.south, x.north] });
    }

    fn push(&mut self, row: isize, south: Row<'_>, north: Row<'_>, out: &mut [f64]) {
        self.flux_y.swap(0, 1);
        self.vorticity.swap(0, 1);
        self.thickness.swap(0, 1);
        self.bernoulli.swap(0, 1);
        self.arch.dispatch(Push { rows: self, row, south, north, out });
    }
}

struct PushState<'a, 'b, const L: usize> {
    rows: &'a mut AdjointRows<'b, L>,
    row: isize,
    x: [Row<'a>; 2],
}

impl<const L: usize> WithSimd for PushState<'_, '_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let [south, north] = self.x;
        self.rows.coefficients.push(self.row, &self.rows.state, south, north);
    }
}

/// One row of the columns, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b, const L: usize> {
    rows: &'a mut AdjointRows<'b, L>,
    row: isize,
    south: Row<'a>,
    north: Row<'a>,
    out: &'a mut [f64],
}

impl<const L: usize> WithSimd for Push<'_, '_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Push { rows, row, south, north, out } = self;
        let AdjointRows { model, coefficients, flux_x, flux_y, vorticity, thickness, bernoulli, beyond, .. } = rows;
        let (constants, stride) = (Constants::new(model), out.len() / VARIABLES);
        let walls = model.layout.grid.boundary == Boundary::Channel;
        let [at_southern_wall, at_northern_wall] = [0, model.layout.grid.ny as isize].map(|wall| walls && row == wall);
        let zero = Row::each([&beyond[..stride]; VARIABLES]);
        let (south, north) = (if at_southern_wall { zero } else { south }, if at_northern_wall { zero } else { north });
        let ([flux_y_s, flux_y], [vorticity_s, vorticity]) = (flux_y, vorticity);
        let ([thickness_s, thickness], [bernoulli_s, bernoulli]) = (thickness, bernoulli);
        let mut lanes = Rows {
            flux_x: flux_x.as_flattened_mut(),
            flux_y: [flux_y_s.as_flattened_mut(), flux_y.as_flattened_mut()],
            vorticity: [vorticity_s.as_flattened_mut(), vorticity.as_flattened_mut()],
            thickness: [thickness_s.as_flattened_mut(), thickness.as_flattened_mut()],
            bernoulli: [bernoulli_s.as_flattened_mut(), bernoulli.as_flattened_mut()],
        };
        if L == LANES {
            adjoint_lanes::diagnostics(simd, model, coefficients, row, [south, north], &mut lanes);
        } else {
            let Rows {
                flux_x,
                flux_y: [_, flux_y],
                vorticity: [_, vorticity],
                thickness: [_, thickness],
                bernoulli: [_, b],
            } = &mut lanes;
            let [flux_x, flux_y, vorticity, thickness, bernoulli] =
                [flux_x, flux_y, vorticity, thickness, b].map(|row| row.as_chunks_mut::<L>().0);
            diagnostics(constants, coefficients, row, south, north, flux_x, flux_y, vorticity, thickness, bernoulli);
        }
        if at_southern_wall || at_northern_wall {
            lanes.vorticity[1].fill(0.0);
            lanes.thickness[1].iter_mut().for_each(|value| *value *= 2.0);
        }
        if L == LANES {
            adjoint_lanes::prognostics(simd, model, coefficients, row - 1, &lanes, out);
        } else {
            let (out_h, winds) = out.split_at_mut(stride);
            let (out_u, out_v) = winds.split_at_mut(stride);
            let gradients = Gradients {
                flux_x: lanes.flux_x.as_chunks::<L>().0,
                flux_y: places(&lanes.flux_y),
                vorticity: places(&lanes.vorticity),
                thickness: places(&lanes.thickness),
                bernoulli: places(&lanes.bernoulli),
            };
            prognostics(constants, model, coefficients, row - 1, gradients, out_h, out_u, out_v);
        }
        let (out_h, winds) = out.split_at_mut(stride);
        let (out_u, out_v) = winds.split_at_mut(stride);
        let drag = model.parameters.drag_per_s;
        if drag != 0.0 {
            for (out, wind) in [(&mut *out_u, south.variable(U)), (&mut *out_v, south.variable(V))] {
                for (out, wind) in out.iter_mut().zip(wind) {
                    *out -= drag * wind;
                }
            }
        }
        if walls && row == 1 {
            out_v.fill(0.0);
        }
        for row in [out_h, out_u, out_v] {
            periodic_row(row, L);
        }
    }
}

/// Places of two rows.
#[inline(always)]
fn places<'a, const L: usize>(rows: &'a [&mut [f64]; 2]) -> [&'a [[f64; L]]; 2] {
    [rows[0].as_chunks().0, rows[1].as_chunks().0]
}

/// V*, q*/h̄ˣʸ and q q*/(4 h̄ˣʸ) of the northern row, U* and B* of the southern, in one loop.
#[inline(always)]
fn diagnostics<const L: usize>(
    constants: Constants,
    coefficients: &RowCoefficients,
    row: isize,
    south: Row<'_>,
    north: Row<'_>,
    flux_x: &mut [[f64; L]],
    flux_y: &mut [[f64; L]],
    vorticity: &mut [[f64; L]],
    thickness: &mut [[f64; L]],
    bernoulli: &mut [[f64; L]],
) {
    let [h_s, u_s, v_s] = south.variables().map(|row| row.as_chunks::<L>().0);
    let [h, u, v] = north.variables().map(|row| row.as_chunks::<L>().0);
    let n = h.len() - 2;
    {
        let (at, term, term_s) =
            (coefficients.places(row, n), coefficients.vorticity_term(row, n), coefficients.vorticity_term(row - 1, n));
        let (per_thickness, quarter_q) = (&at.per_thickness[1..][..n], &at.quarter_q_per_thickness[1..][..n]);
        let (of_q, of_v, of_v_e) = (&term.x[0][1..][..n], &term.x[2][1..][..n], &term.x[2][2..][..n]);
        let (of_q_s, of_v_s, of_v_se) = (&term_s.x[1][1..][..n], &term_s.x[3][1..][..n], &term_s.x[3][2..][..n]);
        let (of_q_y, of_q_w) = (&term.y[0][1..][..n], &term.y[1][..n]);
        let (of_u, of_u_w) = (&term.y[2][1..][..n], &term.y[3][..n]);
        let (of_u_s, of_u_sw) = (&term_s.y[2][1..][..n], &term_s.y[3][..n]);
        let (h, h_s, h_sw) = (&h[1..][..n], &h_s[1..][..n], &h_s[..n]);
        let (u, u_e, u_s, u_se) = (&u[1..][..n], &u[2..][..n], &u_s[1..][..n], &u_s[2..][..n]);
        let (v, v_w, v_s, v_sw) = (&v[1..][..n], &v[..n], &v_s[1..][..n], &v_s[..n]);
        let (flux_x, flux_y, bernoulli) = (&mut flux_x[1..][..n], &mut flux_y[1..][..n], &mut bernoulli[1..][..n]);
        let (vorticity, thickness) = (&mut vorticity[1..][..n], &mut thickness[1..][..n]);
        for i in 0..n {
            for l in 0..L {
                let q = (of_q[i] * u[i][l] + of_q_s[i] * u_s[i][l]) - (of_q_y[i] * v[i][l] + of_q_w[i] * v_w[i][l]);
                vorticity[i][l] = per_thickness[i] * q;
                thickness[i][l] = quarter_q[i] * q;
                flux_y[i][l] = constants.minus_gradient_y(h[i][l], h_s[i][l])
                    + ((of_v[i] * u[i][l] + of_v_e[i] * u_e[i][l]) + (of_v_s[i] * u_s[i][l] + of_v_se[i] * u_se[i][l]));
                flux_x[i][l] = constants.minus_gradient_x(h_s[i][l], h_sw[i][l])
                    - ((of_u_s[i] * v_s[i][l] + of_u_sw[i] * v_sw[i][l]) + (of_u[i] * v[i][l] + of_u_w[i] * v_w[i][l]));
                bernoulli[i][l] = constants.minus_divergence([u_se[i][l], u_s[i][l]], [v[i][l], v_s[i][l]]);
            }
        }
    }
    for row in [flux_x, vorticity, thickness, bernoulli] {
        (row[0], row[n + 1]) = (row[n], row[1]);
    }
}

/// Gradients around a row: U* of the row, V*, q*/h̄ˣʸ and q q*/(4 h̄ˣʸ) of the row and north of it, B* south of it and of the
/// row.
#[derive(Clone, Copy)]
struct Gradients<'a, const L: usize> {
    flux_x: &'a [[f64; L]],
    flux_y: [&'a [[f64; L]]; 2],
    vorticity: [&'a [[f64; L]]; 2],
    thickness: [&'a [[f64; L]]; 2],
    bernoulli: [&'a [[f64; L]]; 2],
}

/// h*, u* and v* of a row.
#[inline(always)]
fn prognostics<const L: usize>(
    constants: Constants,
    model: &ShallowWater,
    coefficients: &RowCoefficients,
    row: isize,
    gradients: Gradients<'_, L>,
    out_h: &mut [f64],
    out_u: &mut [f64],
    out_v: &mut [f64],
) {
    let gravity = model.parameters.gravity_m_per_s2;
    let [out_h, out_u, out_v] = [out_h, out_u, out_v].map(|row| row.as_chunks_mut::<L>().0);
    let n = out_h.len() - 2;
    let (at, half_v_n) = (coefficients.places(row, n), &coefficients.places(row + 1, n).half_v[1..][..n]);
    let (thickness_x, thickness_y) = (&at.thickness_x[1..][..n], &at.thickness_y[1..][..n]);
    let (half_u, half_u_e, half_v) = (&at.half_u[1..][..n], &at.half_u[2..][..n], &at.half_v[1..][..n]);
    let (flux_x, flux_x_e) = (&gradients.flux_x[1..][..n], &gradients.flux_x[2..][..n]);
    let [flux_y, flux_y_n] = gradients.flux_y.map(|row| &row[1..][..n]);
    let [z, z_n] = gradients.vorticity.map(|row| &row[1..][..n]);
    let z_e = &gradients.vorticity[0][2..][..n];
    let [q, q_n] = gradients.thickness.map(|row| &row[1..][..n]);
    let [q_e, q_ne] = gradients.thickness.map(|row| &row[2..][..n]);
    let [b_s, b] = gradients.bernoulli.map(|row| &row[1..][..n]);
    let b_w = &gradients.bernoulli[1][..n];
    let (out_h, out_u, out_v) = (&mut out_h[1..][..n], &mut out_u[1..][..n], &mut out_v[1..][..n]);
    for i in 0..n {
        for l in 0..L {
            let kinetic = (half_u[i] * flux_x[i][l] + half_u_e[i] * flux_x_e[i][l])
                + (half_v[i] * flux_y[i][l] + half_v_n[i] * flux_y_n[i][l]);
            let corners = (q[i][l] + q_e[i][l]) + (q_n[i][l] + q_ne[i][l]);
            out_h[i][l] = (gravity * b[i][l] + kinetic) - corners;
            out_u[i][l] = (thickness_x[i] * flux_x[i][l] + half_u[i] * (b[i][l] + b_w[i][l]))
                - constants.minus_gradient_y(z[i][l], z_n[i][l]);
            out_v[i][l] = (thickness_y[i] * flux_y[i][l] + half_v[i] * (b[i][l] + b_s[i][l]))
                + constants.minus_gradient_x(z[i][l], z_e[i][l]);
        }
    }
}
