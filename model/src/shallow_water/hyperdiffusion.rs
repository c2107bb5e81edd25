//! Hyperdiffusion row by row, behind a stream of the other terms: with the bits of [`super::damping`].
//!
//! With L the five-point Laplacian, L(L x) reaches two rows: when row j is pushed, L x is known up to row j − 1 and
//! L(L x) up to row j − 2, so that all tendencies come one row later than those of the stream within.

use super::adjoint_rows::AdjointRows;
use super::rows::{ShallowWaterRows, continue_evenly};
use super::{ShallowWater, V, VARIABLES};
use crate::grid::Boundary;
use crate::scheme::Lanes;
use crate::scheme::rows::{AdjointRowStream, Pushed, Row, RowStream, TangentRowStream};
use crate::scheme::strips::periodic_row;
use crate::stored::Stored;

use pulp::{Arch, Simd, WithSimd};

/// How the values of a row lie.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Arrangement {
    /// `[variable, x, lane]` with this number of lanes.
    Fields(usize),
    /// `[variable, x, lane]` with this number of lanes, and with the place before the first and that after the last.
    Padded(usize),
}

impl Arrangement {
    /// From a value to that of the next place.
    fn stride(self) -> usize {
        match self {
            Arrangement::Fields(lanes) | Arrangement::Padded(lanes) => lanes,
        }
    }

    /// The values of a variable's row, without what repeats others.
    fn inner<N>(self, row: &[N]) -> &[N] {
        match self {
            Arrangement::Fields(_) => row,
            Arrangement::Padded(lanes) => &row[lanes..row.len() - lanes],
        }
    }
}

/// The tendency with hyperdiffusion.
pub(super) struct HyperdiffusedRows<'a> {
    inner: ShallowWaterRows<'a>,
    damping: Damping<'a>,
}

impl<'a> HyperdiffusedRows<'a> {
    /// For rows of `nx` places of `lanes` states.
    pub fn new(model: &'a ShallowWater, nx: usize, lanes: usize) -> Self {
        let damping = Damping::new(model, Arrangement::Fields(lanes), nx);
        Self { inner: ShallowWaterRows::new(model, nx, lanes), damping }
    }
}

impl RowStream for HyperdiffusedRows<'_> {
    fn reach(&self) -> usize {
        2
    }

    fn begin(&mut self, row: isize, first: Row<'_>) {
        self.inner.begin(row, first);
    }

    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        self.inner.beyond_wall(x, ghost);
    }

    fn push(&mut self, row: usize, south: Row<'_>, north: Row<'_>, tendency: &mut [f64]) {
        self.damping.release(tendency);
        self.inner.push(row, south, north, &mut self.damping.pending[..tendency.len()]);
        self.damping.push(row as isize, south, north, tendency);
    }

    fn finish(&mut self, tendency: &mut [f64]) {
        self.damping.finish(tendency);
    }
}

/// The tendency with hyperdiffusion and its derivative.
pub(super) struct HyperdiffusedTangentRows<'a, N> {
    inner: Box<dyn TangentRowStream<N> + 'a>,
    of_state: Damping<'a>,
    of_columns: Damping<'a, N>,
}

impl<'a, N: Stored> HyperdiffusedTangentRows<'a, N> {
    /// For rows of at most `nx` places, given the stream of the other terms.
    pub fn new(model: &'a ShallowWater, nx: usize, lanes: Lanes, inner: Box<dyn TangentRowStream<N> + 'a>) -> Self {
        Self {
            inner,
            of_state: Damping::new(model, Arrangement::Fields(1), nx),
            of_columns: Damping::new(model, Arrangement::Padded(lanes.count::<N>()), nx),
        }
    }
}

impl<N: Stored> TangentRowStream<N> for HyperdiffusedTangentRows<'_, N> {
    fn reach(&self) -> usize {
        2
    }

    fn begin(&mut self, row: isize, x: Row<'_>, dx: Row<'_, N>) {
        self.inner.begin(row, x, dx);
    }

    fn beyond_wall(&self, x: Row<'_>, dx: Row<'_, N>, ghost: &mut [f64], d_ghost: &mut [N]) {
        self.inner.beyond_wall(x, dx, ghost, d_ghost);
    }

    fn push(&mut self, row: isize, x: Pushed<'_>, dx: Pushed<'_, N>) {
        self.of_state.release(x.tendency);
        self.of_columns.release(dx.tendency);
        let (pending, d_pending) = (&mut self.of_state.pending, &mut self.of_columns.pending);
        let (pending, d_pending) = (&mut pending[..x.tendency.len()], &mut d_pending[..dx.tendency.len()]);
        self.inner.push(row, Pushed { tendency: pending, ..x }, Pushed { tendency: d_pending, ..dx });
        self.of_state.push(row, x.south, x.north, x.tendency);
        self.of_columns.push(row, dx.south, dx.north, dx.tendency);
    }

    fn finish(&mut self, tendency: &mut [f64], d_tendency: &mut [N]) {
        self.of_state.finish(tendency);
        self.of_columns.finish(d_tendency);
    }
}

/// The tendency with hyperdiffusion and the transpose of its derivative, which is hyperdiffused as x is.
pub(super) struct HyperdiffusedAdjointRows<'a> {
    inner: AdjointRows<'a>,
    of_state: Damping<'a>,
    of_columns: Damping<'a>,
    /// The row of the columns beyond a wall.
    ghost: Vec<f64>,
}

impl<'a> HyperdiffusedAdjointRows<'a> {
    /// As [`AdjointRows::new`].
    pub fn new(model: &'a ShallowWater, nx: usize, lanes: Lanes, delay: usize) -> Self {
        Self {
            inner: AdjointRows::new(model, nx, lanes, delay),
            of_state: Damping::new(model, Arrangement::Fields(1), nx),
            of_columns: Damping::new(model, Arrangement::Padded(lanes.count::<f64>()), nx),
            ghost: vec![0.0; VARIABLES * (nx + 2) * lanes.count::<f64>()],
        }
    }
}

impl AdjointRowStream for HyperdiffusedAdjointRows<'_> {
    fn reach(&self) -> usize {
        2
    }

    fn begin(&mut self, row: isize, x: Row<'_>) {
        self.inner.begin(row, x);
    }

    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        self.inner.beyond_wall(x, ghost);
    }

    fn push_state(&mut self, row: isize, x: Pushed<'_>) {
        self.of_state.release(x.tendency);
        let pending = &mut self.of_state.pending[..x.tendency.len()];
        self.inner.push_state(row, Pushed { tendency: pending, ..x });
        self.of_state.push(row, x.south, x.north, x.tendency);
    }

    fn finish_state(&mut self, tendency: &mut [f64]) {
        self.of_state.finish(tendency);
    }

    fn push(&mut self, row: isize, south: Row<'_>, north: Row<'_>, out: &mut [f64]) {
        self.of_columns.release(out);
        self.inner.push(row, south, north, &mut self.of_columns.pending[..out.len()]);
        let grid = &self.of_columns.model.layout.grid;
        let (walls, ghost) = (grid.boundary == Boundary::Channel, &mut self.ghost[..out.len()]);
        let stride = out.len() / VARIABLES;
        let (south, north) = if walls && row == 0 {
            continue_evenly(north, ghost);
            (Row::of(ghost, stride), north)
        } else if walls && row == grid.ny as isize {
            continue_evenly(south, ghost);
            (south, Row::of(ghost, stride))
        } else {
            (south, north)
        };
        self.of_columns.push(row, south, north, out);
    }

    fn finish(&mut self, out: &mut [f64]) {
        self.of_columns.finish(out);
    }
}

/// −ν L(L x) of a sweep over rows, and what it waits for.
pub(super) struct Damping<'a, N = f64> {
    model: &'a ShallowWater,
    arch: Arch,
    arrangement: Arrangement,
    /// The row two rows south of the one pushed last, of each variable.
    before: [Vec<N>; VARIABLES],
    /// L x of the three rows south of it, from the south, of each variable.
    laplacians: [[Vec<N>; VARIABLES]; 3],
    /// The other terms of the row south of it.
    pub pending: Vec<N>,
}

impl<'a, N: Stored> Damping<'a, N> {
    /// For rows of at most `nx` places.
    pub fn new(model: &'a ShallowWater, arrangement: Arrangement, nx: usize) -> Self {
        let row = |_| vec![N::default(); nx * arrangement.stride()];
        let rows = || std::array::from_fn(row);
        let pending = match arrangement {
            Arrangement::Fields(lanes) => vec![N::default(); VARIABLES * nx * lanes],
            Arrangement::Padded(lanes) => vec![N::default(); VARIABLES * (nx + 2) * lanes],
        };
        Self { model, arch: Arch::new(), arrangement, before: rows(), laplacians: [rows(), rows(), rows()], pending }
    }

    /// The other terms of the row two rows south of the one that is pushed now.
    pub fn release(&self, tendency: &mut [N]) {
        tendency.copy_from_slice(&self.pending[..tendency.len()]);
    }

    /// Takes a row and the one south of it; damps the tendency of the row two rows south.
    pub fn push(&mut self, row: isize, south: Row<'_, N>, north: Row<'_, N>, tendency: &mut [N]) {
        self.laplacians.rotate_left(1);
        let (arch, (weights, _), stride) = (self.arch, self.weights(), self.arrangement.stride());
        let rows = south.variables::<VARIABLES>().into_iter().zip(north.variables::<VARIABLES>());
        for ((before, out), (south, north)) in self.before.iter_mut().zip(&mut self.laplacians[2]).zip(rows) {
            let (south, north) = (self.arrangement.inner(south), self.arrangement.inner(north));
            let (before, out) = (&mut before[..south.len()], &mut out[..south.len()]);
            let store = |out: &mut N, value: N| *out = value;
            arch.dispatch(Laplace { weights, stride, rows: [before, south, north], out, store });
            before.copy_from_slice(south);
        }
        let walls = self.model.layout.grid.boundary == Boundary::Channel;
        if walls && row == 1 {
            // L x is continued beyond the wall as x is; v, and L v, are zero at the wall itself.
            let [_, beyond, beside] = &mut self.laplacians;
            beside[V].fill(N::default());
            beyond.iter_mut().zip(beside).for_each(|(beyond, beside)| beyond.copy_from_slice(beside));
        }
        self.damp(tendency);
        if walls && row == 2 {
            let stride = tendency.len() / VARIABLES;
            tendency[V * stride..].fill(N::default());
        }
    }

    /// The damped tendency of the row beside the northern wall, that beyond it having been pushed.
    pub fn finish(&mut self, tendency: &mut [N]) {
        self.release(tendency);
        self.laplacians.rotate_left(1);
        let [_, beside, beyond] = &mut self.laplacians;
        beyond.iter_mut().zip(beside).for_each(|(beyond, beside)| beyond.copy_from_slice(beside));
        beyond[V].fill(N::default());
        self.damp(tendency);
    }

    /// −= ν L(L x).
    fn damp(&self, tendency: &mut [N]) {
        let ((weights, hyperdiffusion), stride) = (self.weights(), self.arrangement.stride());
        let len = tendency.len() / VARIABLES;
        for (variable, row) in tendency.chunks_exact_mut(len).enumerate() {
            let out = match self.arrangement {
                Arrangement::Fields(_) => &mut *row,
                Arrangement::Padded(lanes) => &mut row[lanes..len - lanes],
            };
            let rows = self.laplacians.each_ref().map(|row| &row[variable][..out.len()]);
            let store = |out: &mut N, value: N| *out -= hyperdiffusion * value;
            self.arch.dispatch(Laplace { weights, stride, rows, out, store });
            if let Arrangement::Padded(lanes) = self.arrangement {
                periodic_row(row, lanes);
            }
        }
    }

    /// 1/dx² and 1/dy² times an area a², and ν/a⁴. In single precision the area is about that of a cell, so that L x is as far
    /// from the smallest numbers as x is; it is a power of two, on which no other bits depend.
    fn weights(&self) -> ([N; 2], N) {
        let grid = &self.model.layout.grid;
        let is_double = size_of::<N>() == size_of::<f64>();
        let area = if is_double { 1.0 } else { f64::powi(2.0, (grid.dx_m * grid.dy_m).log2().round() as i32) };
        let weights = [grid.dx_m, grid.dy_m].map(|spacing| N::narrow(area * spacing.powi(-2)));
        (weights, N::narrow(self.model.parameters.hyperdiffusion_m4_per_s / (area * area)))
    }
}

/// Stores each value of L of the middle one of three rows, which is periodic; for [`pulp::Arch::dispatch`].
struct Laplace<'a, N, F> {
    weights: [N; 2],
    stride: usize,
    rows: [&'a [N]; 3],
    out: &'a mut [N],
    store: F,
}

impl<N: Stored, F: Fn(&mut N, N)> WithSimd for Laplace<'_, N, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { weights: [x_weight, y_weight], stride, rows: [south, center, north], out, store } = self;
        let len = out.len();
        let place = |south: N, west: N, center: N, east: N, north: N| {
            let (x_part, y_part) = ((east - center) - (center - west), (north - center) - (center - south));
            x_part * x_weight + y_part * y_weight
        };
        let (south, center, north) = (&south[..len], &center[..len], &north[..len]);
        for k in 0..stride {
            let last = len - stride + k;
            store(&mut out[k], place(south[k], center[last], center[k], center[k + stride], north[k]));
            store(&mut out[last], place(south[last], center[last - stride], center[last], center[k], north[last]));
        }
        let n = len - 2 * stride;
        let (west, east) = (&center[..n], &center[2 * stride..][..n]);
        let (south, center, north) = (&south[stride..][..n], &center[stride..][..n], &north[stride..][..n]);
        let out = &mut out[stride..][..n];
        for k in 0..n {
            store(&mut out[k], place(south[k], west[k], center[k], east[k], north[k]));
        }
    }
}
