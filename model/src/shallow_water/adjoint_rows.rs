//! The adjoint tendency row by row for one column or a group at once: [`super::adjoint_lines`], which reach one row south and
//! north. Beside a wall the rows beyond it are zero, and the corners on it, whose thickness is the mean of h on either side
//! and which have no vorticity, count twice for h and not for u and v.

use super::adjoint_lines::{Diagnostics, Prognostics, Shape};
use super::kernel::Constants;
use super::row_coefficients::RowCoefficients;
use super::rows::{ShallowWaterRows, finish_columns};
use super::{ShallowWater, VARIABLES};
use crate::grid::Boundary;
use crate::places::{Lines, at_each_place, at_each_place_of_group};
use crate::scheme::Lanes;
use crate::scheme::rows::{AdjointRowStream, Pushed, Row, RowStream};
use crate::scheme::strips::periodic_row;

use pulp::{Simd, WithSimd};

/// Rows of a sweep: of the state, of its coefficients, and of gradients.
pub(super) struct AdjointRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    /// Values of a place.
    lanes: usize,
    state: ShallowWaterRows<'a>,
    coefficients: RowCoefficients,
    gradients: Gradients,
    /// The row beyond a wall, which is zero.
    beyond: Vec<f64>,
}

impl<'a> AdjointRows<'a> {
    /// For rows of at most `nx` places, where rows of increments come `delay` rows after those of the state.
    pub fn new(model: &'a ShallowWater, nx: usize, lanes: Lanes, delay: usize) -> Self {
        let lanes = lanes.count::<f64>();
        let len = (nx + 2) * lanes;
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
    fn with_simd<S: Simd>(self, simd: S) {
        let [south, north] = self.x;
        self.rows.coefficients.push(simd, self.row, &self.rows.state.diagnostics, south, north);
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
        let (lanes, coefficients, constants, stride) =
            (*lanes, &*coefficients, Constants::new(model), out.len() / VARIABLES);
        let walls = model.layout.grid.boundary == Boundary::Channel;
        let [at_southern_wall, at_northern_wall] = [0, model.layout.grid.ny as isize].map(|wall| walls && row == wall);
        let zero = Row::each([&beyond[..stride]; VARIABLES]);
        let (south, north) = (if at_southern_wall { zero } else { south }, if at_northern_wall { zero } else { north });
        let shape = Shape { count: stride / lanes - 2, lanes };
        evaluate(simd, shape, Diagnostics::new(shape, constants, coefficients, row, [south, north], gradients));
        let Gradients { flux_x, vorticity, thickness, bernoulli, .. } = &mut *gradients;
        for row in [flux_x, &mut vorticity[1], &mut thickness[1], &mut bernoulli[1]] {
            periodic_row(&mut row[..stride], lanes);
        }
        if at_southern_wall || at_northern_wall {
            gradients.vorticity[1].fill(0.0);
            gradients.thickness[1].iter_mut().for_each(|value| *value *= 2.0);
        }
        let (out_h, winds) = out.split_at_mut(stride);
        let (out_u, out_v) = winds.split_at_mut(stride);
        let out_rows = [out_h, out_u, out_v];
        evaluate(simd, shape, Prognostics::new(shape, constants, coefficients, row - 1, gradients, out_rows));
        finish_columns(model, row, south, out, lanes);
    }
}

/// Evaluates the lines at the places of a column or of a group.
#[inline(always)]
fn evaluate<S: Simd>(simd: S, shape: Shape, lines: impl Lines<f64>) {
    match shape.lanes {
        1 => at_each_place(simd, shape.count, lines),
        _ => at_each_place_of_group(simd, shape.count, lines),
    }
}
