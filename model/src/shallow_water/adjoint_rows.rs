//! The adjoint tendency row by row for one column or a group at once: the lines of [`super::adjoint`], which reach one row
//! south and north. Beside a wall the rows beyond it are zero, and the corners on it, whose thickness is the mean of h on either side
//! and which have no vorticity, count twice for h and not for u and v.

use super::adjoint_lanes;
use super::kernel::Constants;
use super::row_coefficients::RowCoefficients;
use super::rows::{ShallowWaterRows, finish_columns};
use super::{ShallowWater, VARIABLES};
use crate::arithmetic::Arithmetic;
use crate::grid::Boundary;
use crate::scheme::Lanes;
use crate::scheme::rows::{AdjointRowStream, Pushed, Row, RowStream};

use pulp::{Simd, WithSimd};

/// Rows of a sweep: of the state, of its coefficients, and of gradients.
pub(super) struct AdjointRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    lanes: Lanes,
    state: ShallowWaterRows<'a>,
    coefficients: RowCoefficients,
    gradients: Gradients,
    /// The row beyond a wall, which is zero.
    beyond: Vec<f64>,
}

impl<'a> AdjointRows<'a> {
    /// For rows of at most `nx` places, where rows of increments come `delay` rows after those of the state.
    pub fn new(model: &'a ShallowWater, nx: usize, lanes: Lanes, delay: usize) -> Self {
        let len = (nx + 2) * lanes.count::<f64>();
        Self {
            model,
            arch: pulp::Arch::new(),
            lanes,
            state: ShallowWaterRows::new(model, nx, 1),
            coefficients: RowCoefficients::new(model, nx, delay + 2),
            gradients: Gradients::new(len),
            beyond: vec![0.0; len],
        }
    }
}

/// Gradients with respect to the diagnostic quantities of the rows of a sweep, `[x, lane]`. Place i is at i + 1.
pub(super) struct Gradients {
    /// U* of the row before the one pushed last.
    pub flux_x: Vec<f64>,
    /// V* of the last two rows, from the south.
    pub flux_y: [Vec<f64>; 2],
    /// q* / h̄ˣʸ of the last two rows.
    pub vorticity: [Vec<f64>; 2],
    /// q q* / (4 h̄ˣʸ) of the last two rows.
    pub thickness: [Vec<f64>; 2],
    /// B* of the two rows before the last.
    pub bernoulli: [Vec<f64>; 2],
}

impl Gradients {
    /// For rows of at most `len` values.
    fn new(len: usize) -> Self {
        let row = || vec![0.0; len];
        Self {
            flux_x: row(),
            flux_y: [row(), row()],
            vorticity: [row(), row()],
            thickness: [row(), row()],
            bernoulli: [row(), row()],
        }
    }

    /// Makes room for the next row.
    fn advance(&mut self) {
        self.flux_y.swap(0, 1);
        self.vorticity.swap(0, 1);
        self.thickness.swap(0, 1);
        self.bernoulli.swap(0, 1);
    }

    /// The newest row of each, in the order of the fields.
    #[inline(always)]
    pub fn newest_mut(&mut self) -> [&mut [f64]; 5] {
        let Self { flux_x, flux_y, vorticity, thickness, bernoulli } = self;
        [flux_x, &mut flux_y[1], &mut vorticity[1], &mut thickness[1], &mut bernoulli[1]]
    }
}

impl AdjointRowStream for AdjointRows<'_> {
    fn begin(&mut self, row: isize, x: Row<'_>) {
        self.state.begin(row, x);
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
        self.gradients.advance();
        self.arch.dispatch(Push { rows: self, row, south, north, out });
    }
}

struct PushState<'a, 'b> {
    rows: &'a mut AdjointRows<'b>,
    row: isize,
    x: [Row<'a>; 2],
}

impl WithSimd for PushState<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let [south, north] = self.x;
        self.rows.coefficients.push(self.row, &self.rows.state.diagnostics, south, north);
    }
}

/// One row of the columns, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b> {
    rows: &'a mut AdjointRows<'b>,
    row: isize,
    south: Row<'a>,
    north: Row<'a>,
    out: &'a mut [f64],
}

impl WithSimd for Push<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Push { rows, row, south, north, out } = self;
        let AdjointRows { model, lanes, coefficients, gradients, beyond, .. } = rows;
        let (coefficients, constants, stride) = (&*coefficients, Constants::new(model), out.len() / VARIABLES);
        let walls = model.layout.grid.boundary == Boundary::Channel;
        let [at_southern_wall, at_northern_wall] = [0, model.layout.grid.ny as isize].map(|wall| walls && row == wall);
        let zero = Row::each([&beyond[..stride]; VARIABLES]);
        let (south, north) = (if at_southern_wall { zero } else { south }, if at_northern_wall { zero } else { north });
        match lanes {
            Lanes::One => {
                let [flux_x, flux_y, vorticity, thickness, bernoulli] = gradients.newest_mut();
                diagnostics(
                    constants,
                    coefficients,
                    row,
                    south,
                    north,
                    flux_x,
                    flux_y,
                    vorticity,
                    thickness,
                    bernoulli,
                );
            }
            Lanes::Group => adjoint_lanes::diagnostics(simd, constants, coefficients, row, [south, north], gradients),
        }
        if at_southern_wall || at_northern_wall {
            gradients.vorticity[1].fill(0.0);
            gradients.thickness[1].iter_mut().for_each(|value| *value *= 2.0);
        }
        match lanes {
            Lanes::One => {
                let (out_h, winds) = out.split_at_mut(stride);
                let (out_u, out_v) = winds.split_at_mut(stride);
                prognostics(constants, coefficients, row - 1, gradients, out_h, out_u, out_v);
                finish_columns(model, row, south, out, 1);
            }
            Lanes::Group => {
                adjoint_lanes::prognostics(simd, constants, coefficients, row - 1, gradients, out);
                finish_columns(model, row, south, out, f64::COLUMNS);
            }
        }
    }
}

/// V*, q*/h̄ˣʸ and q q*/(4 h̄ˣʸ) of the northern row, U* and B* of the southern, in one loop.
#[inline(always)]
fn diagnostics(
    constants: Constants,
    coefficients: &RowCoefficients,
    row: isize,
    south: Row<'_>,
    north: Row<'_>,
    flux_x: &mut [f64],
    flux_y: &mut [f64],
    vorticity: &mut [f64],
    thickness: &mut [f64],
    bernoulli: &mut [f64],
) {
    let [h_s, u_s, v_s] = south.variables();
    let [h, u, v] = north.variables();
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
            let q = (of_q[i] * u[i] + of_q_s[i] * u_s[i]) - (of_q_y[i] * v[i] + of_q_w[i] * v_w[i]);
            vorticity[i] = per_thickness[i] * q;
            thickness[i] = quarter_q[i] * q;
            flux_y[i] = constants.minus_gradient_y(h[i], h_s[i])
                + ((of_v[i] * u[i] + of_v_e[i] * u_e[i]) + (of_v_s[i] * u_s[i] + of_v_se[i] * u_se[i]));
            flux_x[i] = constants.minus_gradient_x(h_s[i], h_sw[i])
                - ((of_u_s[i] * v_s[i] + of_u_sw[i] * v_sw[i]) + (of_u[i] * v[i] + of_u_w[i] * v_w[i]));
            bernoulli[i] = constants.minus_divergence([u_se[i], u_s[i]], [v[i], v_s[i]]);
        }
    }
    for row in [flux_x, vorticity, thickness, bernoulli] {
        (row[0], row[n + 1]) = (row[n], row[1]);
    }
}

/// h*, u* and v* of a row.
#[inline(always)]
fn prognostics(
    constants: Constants,
    coefficients: &RowCoefficients,
    row: isize,
    gradients: &Gradients,
    out_h: &mut [f64],
    out_u: &mut [f64],
    out_v: &mut [f64],
) {
    let n = out_h.len() - 2;
    let (at, half_v_n) = (coefficients.places(row, n), &coefficients.places(row + 1, n).half_v[1..][..n]);
    let (thickness_x, thickness_y) = (&at.thickness_x[1..][..n], &at.thickness_y[1..][..n]);
    let (half_u, half_u_e, half_v) = (&at.half_u[1..][..n], &at.half_u[2..][..n], &at.half_v[1..][..n]);
    let (flux_x, flux_x_e) = (&gradients.flux_x[1..][..n], &gradients.flux_x[2..][..n]);
    let [flux_y, flux_y_n] = gradients.flux_y.each_ref().map(|row| &row[1..][..n]);
    let [z, z_n] = gradients.vorticity.each_ref().map(|row| &row[1..][..n]);
    let z_e = &gradients.vorticity[0][2..][..n];
    let [q, q_n] = gradients.thickness.each_ref().map(|row| &row[1..][..n]);
    let [q_e, q_ne] = gradients.thickness.each_ref().map(|row| &row[2..][..n]);
    let [b_s, b] = gradients.bernoulli.each_ref().map(|row| &row[1..][..n]);
    let b_w = &gradients.bernoulli[1][..n];
    let (out_h, out_u, out_v) = (&mut out_h[1..][..n], &mut out_u[1..][..n], &mut out_v[1..][..n]);
    for i in 0..n {
        let kinetic =
            (half_u[i] * flux_x[i] + half_u_e[i] * flux_x_e[i]) + (half_v[i] * flux_y[i] + half_v_n[i] * flux_y_n[i]);
        let corners = (q[i] + q_e[i]) + (q_n[i] + q_ne[i]);
        out_h[i] = (constants.gravity * b[i] + kinetic) - corners;
        out_u[i] =
            (thickness_x[i] * flux_x[i] + half_u[i] * (b[i] + b_w[i])) - constants.minus_gradient_y(z[i], z_n[i]);
        out_v[i] =
            (thickness_y[i] * flux_y[i] + half_v[i] * (b[i] + b_s[i])) + constants.minus_gradient_x(z[i], z_e[i]);
    }
}
