//! A tangent-linear Runge–Kutta step of eight columns at once as one sweep over the rows, beside the step of the state
//! they are linearised at: what the derivative needs to know of a row of the state is computed once for the eight, and
//! neither the stages' states nor their coefficients are ever stored for the whole grid.
//!
//! The columns of a group are interleaved, so that one vector operation does the same for all of them, whatever the
//! length of a row; the columns missing from a last group are zero. No column knows of the others, so that its bits
//! are those it has alone.

use crate::grid::{Boundary, Grid};
use crate::rows::{Ring, combine, wrap};
use crate::wavefront::Weights;
use pulp::Arch;

/// Columns of a group.
pub const LANES: usize = 8;

/// A tendency and its derivative, row by row from the south, for stencils that reach one row and one column.
///
/// Rows of the state are as in [`crate::rows::RowStream`]; rows of increments hold `[variable, x, lane]`.
pub trait TangentRowStream: Send {
    /// Begins a sweep with its first row.
    fn begin(&mut self, x: &[f64], dx: &[f64]);

    /// The row beyond a wall, given the row beside it, with `lanes` values in each place.
    fn beyond_wall(&self, x: &[f64], ghost: &mut [f64], lanes: usize);

    /// As [`crate::rows::RowStream::push`], for state (`x`: southern and northern row, tendency) and increments (`dx`).
    fn push(&mut self, row: usize, x: (&[f64], &[f64], &mut [f64]), dx: (&[f64], &[f64], &mut [f64]));
}

/// States and slopes at the stages, with so many lanes.
struct Stages {
    states: Vec<Ring>,
    slopes: Vec<Ring>,
    ghost: Vec<f64>,
    lanes: usize,
}

impl Stages {
    fn new(stages: usize, row_len: usize, lanes: usize) -> Self {
        let len = row_len * lanes;
        Self {
            states: (0..stages).map(|stage| Ring::new(len, if stage == 0 { stages + 1 } else { 2 })).collect(),
            slopes: (0..stages).map(|stage| Ring::new(len, stages - stage + 1)).collect(),
            ghost: vec![0.0; len],
            lanes,
        }
    }

    /// The state at the next stage.
    fn continue_with(&mut self, arch: Arch, weights: Weights<'_>, stage: usize, row: isize, length: usize) {
        let mut terms: [(f64, &[f64]); 8] = [(0.0, &[]); 8];
        let mut count = 0;
        for (&weight, slopes) in weights.a[stage + 1].iter().zip(&self.slopes) {
            if weight != 0.0 {
                terms[count] = (weights.dt * weight, slopes.row(row));
                count += 1;
            }
        }
        let (first, later) = self.states.split_at_mut(1);
        let state = later[stage].row_mut(row);
        combine(arch, state, first[0].row(row), &terms[..count]);
        if self.lanes == 1 {
            return wrap(state, length);
        }
        for state in state.chunks_exact_mut(length * self.lanes) {
            let (last, lanes) = ((length - 2) * self.lanes, self.lanes);
            state.copy_within(last..last + lanes, 0);
            state.copy_within(lanes..2 * lanes, last + lanes);
        }
    }
}

/// The sweep over the whole grid.
pub(crate) struct TangentWavefront<'a> {
    arch: Arch,
    weights: Weights<'a>,
    grid: &'a Grid,
    variables: usize,
    streams: Vec<Box<dyn TangentRowStream + 'a>>,
    told: Vec<usize>,
    x: Stages,
    dx: Stages,
    /// The first rows of the columns, which come again at the end of a periodic sweep.
    first_rows: Ring,
    /// The columns' last row of a step.
    result: Vec<f64>,
}

impl<'a> TangentWavefront<'a> {
    /// For columns of so many variables, with a stream for each stage.
    pub fn new(
        weights: Weights<'a>,
        streams: Vec<Box<dyn TangentRowStream + 'a>>,
        grid: &'a Grid,
        variables: usize,
    ) -> Self {
        let (stages, row_len) = (streams.len(), variables * (grid.nx + 2));
        Self {
            arch: Arch::new(),
            weights,
            grid,
            variables,
            told: vec![0; stages],
            streams,
            x: Stages::new(stages, row_len, 1),
            dx: Stages::new(stages, row_len, LANES),
            first_rows: Ring::new(row_len * LANES, stages),
            result: vec![0.0; row_len * LANES],
        }
    }

    /// Advances up to eight columns by the step linearised at `at`, in place.
    pub fn sweep(&mut self, at: &[f64], columns: &mut [f64]) {
        let stages = self.streams.len();
        let walls = self.grid.boundary == Boundary::Channel;
        let (ny, reach) = (self.grid.ny as isize, if walls { 0 } else { stages as isize });
        self.told.fill(0);
        for row in -reach..ny + reach {
            self.load_state(at, row);
            if row >= ny {
                self.dx.states[0].row_mut(row).copy_from_slice(self.first_rows.row(row - ny));
            } else {
                self.load_columns(columns, row);
                if (0..stages as isize).contains(&row) {
                    self.first_rows.row_mut(row).copy_from_slice(self.dx.states[0].row(row));
                }
            }
            self.cascade(0, row, columns);
        }
        if walls {
            for stage in 0..stages {
                self.push_beyond(stage, ny - 1, false);
                self.continue_with(stage, ny - 1, columns);
            }
        }
    }

    fn load_state(&mut self, at: &[f64], row: isize) {
        let (nx, cells) = (self.grid.nx, self.grid.cells());
        let start = row.rem_euclid(self.grid.ny as isize) as usize * nx;
        let out = self.x.states[0].row_mut(row);
        for (out, field) in out.chunks_exact_mut(nx + 2).zip(at.chunks_exact(cells)) {
            out[1..=nx].copy_from_slice(&field[start..start + nx]);
        }
        wrap(out, nx + 2);
    }

    fn load_columns(&mut self, columns: &[f64], row: isize) {
        let (nx, cells) = (self.grid.nx, self.grid.cells());
        let start = row.rem_euclid(self.grid.ny as isize) as usize * nx;
        let out = self.dx.states[0].row_mut(row);
        for (variable, out) in out.chunks_exact_mut((nx + 2) * LANES).enumerate() {
            let (out, _) = out.as_chunks_mut::<LANES>();
            let sources: [&[f64]; LANES] = std::array::from_fn(|lane| {
                let from = (lane * self.variables + variable) * cells + start;
                columns.get(from..from + nx).unwrap_or_default()
            });
            if sources[LANES - 1].is_empty() {
                for (lane, source) in sources.iter().enumerate() {
                    out[1..=nx]
                        .iter_mut()
                        .enumerate()
                        .for_each(|(i, out)| out[lane] = source.get(i).copied().unwrap_or(0.0));
                }
            } else {
                interleave(&mut out[1..=nx], sources);
            }
            out[0] = out[nx];
            out[nx + 1] = out[1];
        }
    }

    fn cascade(&mut self, stage: usize, row: isize, columns: &mut [f64]) {
        self.told[stage] += 1;
        let walls = self.grid.boundary == Boundary::Channel;
        if self.told[stage] == 1 && !walls {
            return self.streams[stage].begin(self.x.states[stage].row(row), self.dx.states[stage].row(row));
        }
        if self.told[stage] == 1 {
            self.told[stage] = 2;
            return self.push_beyond(stage, row, true);
        }
        let grid_row = row.rem_euclid(self.grid.ny as isize) as usize;
        let (x, dx) = (&mut self.x, &mut self.dx);
        let (x_states, dx_states) = (&x.states[stage], &dx.states[stage]);
        self.streams[stage].push(
            grid_row,
            (x_states.row(row - 1), x_states.row(row), x.slopes[stage].row_mut(row - 1)),
            (dx_states.row(row - 1), dx_states.row(row), dx.slopes[stage].row_mut(row - 1)),
        );
        if self.told[stage] > 2 {
            self.continue_with(stage, row - 1, columns);
        }
    }

    /// Pushes the row beyond a wall, given the row beside it: before that row in the south, after it in the north.
    fn push_beyond(&mut self, stage: usize, row: isize, south: bool) {
        let (stream, x, dx) = (&mut self.streams[stage], &mut self.x, &mut self.dx);
        let (x_row, dx_row) = (x.states[stage].row(row), dx.states[stage].row(row));
        stream.beyond_wall(x_row, &mut x.ghost, 1);
        stream.beyond_wall(dx_row, &mut dx.ghost, LANES);
        let (slope, d_slope) = (&mut x.slopes[stage], &mut dx.slopes[stage]);
        if south {
            stream.begin(&x.ghost, &dx.ghost);
            let (slope, d_slope) = (slope.row_mut(row - 1), d_slope.row_mut(row - 1));
            stream.push(row as usize, (&x.ghost, x_row, slope), (&dx.ghost, dx_row, d_slope));
        } else {
            let (slope, d_slope) = (slope.row_mut(row), d_slope.row_mut(row));
            stream.push(row as usize + 1, (x_row, &x.ghost, slope), (dx_row, &dx.ghost, d_slope));
        }
    }

    /// The slopes of a row at a stage are known: on to the next stage, or to the end.
    fn continue_with(&mut self, stage: usize, row: isize, columns: &mut [f64]) {
        let length = self.grid.nx + 2;
        if stage + 1 < self.streams.len() {
            self.x.continue_with(self.arch, self.weights, stage, row, length);
            self.dx.continue_with(self.arch, self.weights, stage, row, length);
            return self.cascade(stage + 1, row, columns);
        }
        let mut terms: [(f64, &[f64]); 8] = [(0.0, &[]); 8];
        for ((term, weight), slopes) in terms.iter_mut().zip(self.weights.b).zip(&self.dx.slopes) {
            *term = (self.weights.dt * weight, slopes.row(row));
        }
        combine(self.arch, &mut self.result, self.dx.states[0].row(row), &terms[..self.weights.b.len()]);
        let (nx, cells) = (self.grid.nx, self.grid.cells());
        let start = row as usize * nx;
        let (lanes, _) = self.result.as_chunks::<LANES>();
        for (lane, column) in columns.chunks_exact_mut(self.variables * cells).enumerate() {
            for (variable, field) in column.chunks_exact_mut(cells).enumerate() {
                let values = &lanes[variable * length + 1..][..nx];
                for (out, value) in field[start..start + nx].iter_mut().zip(values) {
                    *out = value[lane];
                }
            }
        }
    }
}

fn interleave(out: &mut [[f64; LANES]], sources: [&[f64]; LANES]) {
    let n = out.len();
    let [a, b, c, d, e, f, g, h] = sources;
    let (a, b, c, d) = (&a[..n], &b[..n], &c[..n], &d[..n]);
    let (e, f, g, h) = (&e[..n], &f[..n], &g[..n], &h[..n]);
    for i in 0..n {
        out[i] = [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]];
    }
}
