//! Hyperdiffusion row by row, behind a stream of the other terms: with the bits of [`super::damping`].
//!
//! With L the five-point Laplacian, L(L x) reaches two rows: when row j is pushed, L x is known up to row j − 1 and
//! L(L x) up to row j − 2, so that all tendencies come one row later than those of the stream within.

use super::rows::ShallowWaterRows;
use super::tangent_rows::TangentRows;
use super::{ShallowWater, V};
use crate::columns::LANES;
use crate::grid::Boundary;
use crate::scheme::MOST_PLACES;
use crate::scheme::rows::{Pushed, Row, RowStream, TangentRowStream};

use pulp::{Arch, Simd, WithSimd};

/// h, u and v.
const VARIABLES: usize = 3;

/// How the values of a row lie.
#[derive(Clone, Copy, PartialEq)]
enum Arrangement {
    /// `[variable, x]`.
    Fields,
    /// `[x, variable, lane]`.
    Places,
}

/// The tendency with hyperdiffusion.
pub(super) struct HyperdiffusedRows<'a> {
    inner: ShallowWaterRows<'a>,
    damping: Damping<'a>,
}

impl<'a> HyperdiffusedRows<'a> {
    /// For rows of `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        Self { inner: ShallowWaterRows::new(model, nx), damping: Damping::new(model, Arrangement::Fields, nx) }
    }
}

impl RowStream for HyperdiffusedRows<'_> {
    fn reach(&self) -> usize {
        2
    }

    fn begin(&mut self, first: Row<'_>) {
        self.inner.begin(first);
    }

    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        self.inner.beyond_wall(x, ghost);
    }

    fn push(&mut self, row: usize, south: Row<'_>, north: Row<'_>, tendency: &mut [f64]) {
        self.damping.release(tendency);
        self.inner.push(row, south, north, &mut self.damping.pending[..tendency.len()]);
        self.damping.push(row, &south.variables::<VARIABLES>(), &north.variables::<VARIABLES>(), tendency);
    }

    fn finish(&mut self, tendency: &mut [f64]) {
        self.damping.finish(tendency);
    }
}

/// The tendency with hyperdiffusion and its derivative for eight columns.
pub(super) struct HyperdiffusedTangentRows<'a> {
    inner: TangentRows<'a>,
    of_state: Damping<'a>,
    of_columns: Damping<'a>,
}

impl<'a> HyperdiffusedTangentRows<'a> {
    /// For rows of at most `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        Self {
            inner: TangentRows::new(model, nx),
            of_state: Damping::new(model, Arrangement::Fields, nx),
            of_columns: Damping::new(model, Arrangement::Places, nx),
        }
    }
}

impl TangentRowStream for HyperdiffusedTangentRows<'_> {
    fn reach(&self) -> usize {
        2
    }

    fn begin(&mut self, x: Row<'_>, dx: &[f64]) {
        self.inner.begin(x, dx);
    }

    fn beyond_wall(&self, x: Row<'_>, dx: &[f64], ghost: &mut [f64], d_ghost: &mut [f64]) {
        self.inner.beyond_wall(x, dx, ghost, d_ghost);
    }

    fn push(&mut self, row: usize, x: Pushed<'_, Row<'_>>, dx: Pushed<'_, &[f64]>) {
        self.of_state.release(x.tendency);
        self.of_columns.release(dx.tendency);
        let (pending, d_pending) = (&mut self.of_state.pending, &mut self.of_columns.pending);
        let (pending, d_pending) = (&mut pending[..x.tendency.len()], &mut d_pending[..dx.tendency.len()]);
        self.inner.push(row, Pushed { tendency: pending, ..x }, Pushed { tendency: d_pending, ..dx });
        let [south, north] = [x.south, x.north].map(|row| row.variables::<VARIABLES>());
        self.of_state.push(row, &south, &north, x.tendency);
        self.of_columns.push(row, &[dx.south], &[dx.north], dx.tendency);
    }

    fn finish(&mut self, tendency: &mut [f64], d_tendency: &mut [f64]) {
        self.of_state.finish(tendency);
        self.of_columns.finish(d_tendency);
    }
}

/// −ν L(L x) of a sweep over rows, and what it waits for.
struct Damping<'a> {
    model: &'a ShallowWater,
    arch: Arch,
    arrangement: Arrangement,
    /// The row two rows south of the one pushed last.
    before: Vec<f64>,
    /// L x of the three rows south of it, from the south.
    laplacians: [Vec<f64>; 3],
    /// The other terms of the row south of it.
    pending: Vec<f64>,
}

impl<'a> Damping<'a> {
    fn new(model: &'a ShallowWater, arrangement: Arrangement, nx: usize) -> Self {
        let len = match arrangement {
            Arrangement::Fields => VARIABLES * nx,
            Arrangement::Places => VARIABLES * LANES * nx.min(MOST_PLACES),
        };
        let row = || vec![0.0; len];
        let laplacians = [row(), row(), row()];
        Self { model, arch: Arch::new(), arrangement, before: row(), laplacians, pending: row() }
    }

    /// The other terms of the row two rows south of the one that is pushed now.
    fn release(&self, tendency: &mut [f64]) {
        tendency.copy_from_slice(&self.pending[..tendency.len()]);
    }

    /// Takes a row, given in its contiguous parts with the one south of it; damps the tendency of the row two rows south.
    fn push(&mut self, row: usize, south: &[&[f64]], north: &[&[f64]], tendency: &mut [f64]) {
        self.laplacians.rotate_left(1);
        let (arch, weights, stride) = (self.arch, self.weights(), self.stride());
        let mut first = 0;
        for (south, north) in south.iter().zip(north) {
            let part = first..first + south.len();
            let before = &mut self.before[part.clone()];
            let out = &mut self.laplacians[2][part];
            let store = |out: &mut f64, value: f64| *out = value;
            arch.dispatch(Laplace { weights, stride, rows: [before, south, north], out, store });
            before.copy_from_slice(south);
            first += south.len();
        }
        let walls = self.model.layout.grid.boundary == Boundary::Channel;
        if walls && row == 1 {
            // L x is continued beyond the wall as x is; v, and L v, are zero at the wall itself.
            let [_, beyond, beside] = &mut self.laplacians;
            without_v(self.arrangement, &mut beside[..first]);
            beyond[..first].copy_from_slice(&beside[..first]);
        }
        self.damp(tendency);
        if walls && row == 2 {
            without_v(self.arrangement, tendency);
        }
    }

    /// The damped tendency of the row beside the northern wall, that beyond it having been pushed.
    fn finish(&mut self, tendency: &mut [f64]) {
        self.release(tendency);
        self.laplacians.rotate_left(1);
        let [_, beside, beyond] = &mut self.laplacians;
        let beyond = &mut beyond[..tendency.len()];
        beyond.copy_from_slice(&beside[..tendency.len()]);
        without_v(self.arrangement, beyond);
        self.damp(tendency);
    }

    /// −= ν L(L x).
    fn damp(&self, tendency: &mut [f64]) {
        let (weights, stride) = (self.weights(), self.stride());
        let hyperdiffusion = self.model.parameters.hyperdiffusion_m4_per_s;
        let part = match self.arrangement {
            Arrangement::Fields => tendency.len() / VARIABLES,
            Arrangement::Places => tendency.len(),
        };
        for (number, out) in tendency.chunks_exact_mut(part).enumerate() {
            let rows = self.laplacians.each_ref().map(|row| &row[number * part..][..part]);
            let store = |out: &mut f64, value: f64| *out -= hyperdiffusion * value;
            self.arch.dispatch(Laplace { weights, stride, rows, out, store });
        }
    }

    /// 1/dx² and 1/dy².
    fn weights(&self) -> [f64; 2] {
        let grid = &self.model.layout.grid;
        [grid.dx_m.powi(-2), grid.dy_m.powi(-2)]
    }

    /// From a value to that of the next place.
    fn stride(&self) -> usize {
        match self.arrangement {
            Arrangement::Fields => 1,
            Arrangement::Places => VARIABLES * LANES,
        }
    }
}

/// v = 0.
fn without_v(arrangement: Arrangement, row: &mut [f64]) {
    match arrangement {
        Arrangement::Fields => {
            let nx = row.len() / VARIABLES;
            row[V * nx..].fill(0.0);
        }
        Arrangement::Places => row.chunks_exact_mut(LANES).skip(V).step_by(VARIABLES).for_each(|v| v.fill(0.0)),
    }
}

/// Stores each value of L of the middle one of three rows, which is periodic; for [`pulp::Arch::dispatch`].
struct Laplace<'a, F> {
    weights: [f64; 2],
    stride: usize,
    rows: [&'a [f64]; 3],
    out: &'a mut [f64],
    store: F,
}

impl<F: Fn(&mut f64, f64)> WithSimd for Laplace<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { weights: [x_weight, y_weight], stride, rows: [south, center, north], out, store } = self;
        let len = out.len();
        let place = |south: f64, west: f64, center: f64, east: f64, north: f64| {
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
