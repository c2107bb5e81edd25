//! A tangent-linear step of eight columns at once as one sweep over the rows, beside the step of the state they are
//! linearised at: what the derivative needs to know of a row of the state is computed once for the eight, and neither
//! the stages' states nor their coefficients are ever stored for the whole grid.
//!
//! The columns of a group are interleaved, so that one vector operation does the same for all of them, whatever the
//! length of a row; the columns missing from a last group are zero. No column knows of the others, so that its bits
//! are those it has alone. Long rows are swept in strips; the outermost places on either side of a strip become wrong by
//! as many places as the stencil reaches with each stage, as a strip takes itself for periodic, and only what lies
//! between them is written.

use crate::columns::Columns;
use crate::grid::{Boundary, Grid};
use crate::rows::{Ring, Row};
use crate::scheme::Tendency;
use crate::stored::Stored;
use crate::strips::{Group, Strip};
pub use crate::strips::{LANES, MOST_PLACES};
use crate::update::combine;
use crate::wavefront::Scheme;
use pulp::Arch;

/// A tendency and its derivative, row by row from the south, for stencils that reach one or two rows and columns.
///
/// Rows of the state are as in [`crate::rows::RowStream`], at most [`MOST_PLACES`] long; rows of increments hold
/// `[x, variable, lane]`.
pub trait TangentRowStream: Send {
    /// As [`crate::rows::RowStream::reach`].
    fn reach(&self) -> usize {
        1
    }

    /// Begins a sweep with its first row.
    fn begin(&mut self, x: Row<'_>, dx: &[f64]);

    /// The rows beyond a wall, of the state `[variable, x]` and the increments, given the rows beside it.
    fn beyond_wall(&self, x: Row<'_>, dx: &[f64], ghost: &mut [f64], d_ghost: &mut [f64]);

    /// As [`crate::rows::RowStream::push`], for state (`x`: southern and northern row, tendency) and increments (`dx`).
    fn push(&mut self, row: usize, x: (Row<'_>, Row<'_>, &mut [f64]), dx: (&[f64], &[f64], &mut [f64]));

    /// As [`crate::rows::RowStream::finish`], for state and increments.
    fn finish(&mut self, _tendency: &mut [f64], _d_tendency: &mut [f64]) {}
}

/// One step of the columns, eight at a time; false, and nothing done, if the tendency has no such form. The columns
/// have all levels of the scheme, `at` has the present one.
pub(crate) fn sweep_tl<T: Tendency, S: Stored>(
    tendency: &T,
    scheme: Scheme<'_>,
    at: &[f64],
    columns: &mut [S],
) -> bool {
    let (grid, variables) = (&tendency.layout().grid, tendency.layout().variables.len());
    let wavefront = || {
        let stream = |_| tendency.tangent_row_stream(grid.nx.min(MOST_PLACES));
        let streams: Option<Vec<_>> = (0..scheme.stages()).map(stream).collect();
        Some(TangentWavefront::new(scheme, streams?, grid, variables))
    };
    if tendency.tangent_row_stream(grid.nx.min(MOST_PLACES)).is_none() {
        return false;
    }
    let mut at = at.to_vec();
    tendency.constrain(&mut at);
    let level = tendency.layout().len();
    Columns::new(columns, level * scheme.levels()).for_each_group(LANES, wavefront, |group, wavefront| {
        group.chunks_exact_mut(level).for_each(|column| tendency.constrain(column));
        if let Some(wavefront) = wavefront {
            wavefront.sweep(&at, group);
        }
    });
    true
}

/// States at the later stages and slopes at all, with so many lanes.
struct Stages {
    states: Vec<Ring>,
    slopes: Vec<Ring>,
    ghost: Vec<f64>,
}

impl Stages {
    /// For stages each of which is `reach` rows behind the one before.
    fn new(stages: usize, reach: usize, row_len: usize) -> Self {
        let states = |stage: usize| Ring::new(row_len, if stage == 0 { reach * stages + 1 } else { 2 });
        Self {
            states: (0..stages).map(states).collect(),
            slopes: (1..=stages).map(|stage| Ring::new(row_len, reach * (stages - stage) + 1)).collect(),
            ghost: vec![0.0; row_len],
        }
    }

    /// The state at the next stage.
    fn continue_with(&mut self, arch: Arch, scheme: Scheme<'_>, stage: usize, row: isize, len: usize) {
        let (terms, count) = scheme.terms(stage, &self.slopes, row);
        let (first, later) = self.states.split_at_mut(1);
        let x = Row::of(&first[0].row(row)[..len], len);
        combine(arch, &mut later[stage].row_mut(row)[..len], x, len, &terms[..count]);
    }
}

/// The sweep over the whole grid.
struct TangentWavefront<'a, S> {
    arch: Arch,
    scheme: Scheme<'a>,
    grid: &'a Grid,
    variables: usize,
    streams: Vec<Box<dyn TangentRowStream + 'a>>,
    told: Vec<usize>,
    /// Rows by which each stage is behind the one before, and all of them.
    reach: [isize; 2],
    strip: Strip,
    x: Stages,
    dx: Stages,
    group: Group<S>,
    /// The first rows of the columns, which come again at the end of a periodic sweep.
    first_rows: Ring,
    /// The columns' last row of a step.
    result: Vec<f64>,
}

impl<'a, S: Stored> TangentWavefront<'a, S> {
    /// For columns of so many variables, with a stream for each stage.
    fn new(scheme: Scheme<'a>, streams: Vec<Box<dyn TangentRowStream + 'a>>, grid: &'a Grid, variables: usize) -> Self {
        let (stages, row_len) = (streams.len(), variables * grid.nx.min(MOST_PLACES));
        let of_stage = streams[0].reach();
        let reach = of_stage * stages;
        Self {
            arch: Arch::new(),
            scheme,
            grid,
            variables,
            told: vec![0; stages],
            reach: [of_stage as isize, reach as isize],
            strip: Strip::of_row(grid.nx, reach)[0],
            streams,
            x: Stages::new(stages, of_stage, row_len),
            dx: Stages::new(stages, of_stage, row_len * LANES),
            group: Group::new(variables, variables * scheme.levels(), grid.nx, grid.ny, reach),
            first_rows: Ring::new(row_len * LANES, reach),
            result: vec![0.0; row_len * LANES],
        }
    }

    /// Advances up to eight columns by the step linearised at `at`, in place.
    fn sweep(&mut self, at: &[f64], columns: &mut [S]) {
        for strip in Strip::of_row(self.grid.nx, self.reach[1] as usize) {
            self.strip = strip;
            self.sweep_strip(at, columns);
        }
    }

    fn sweep_strip(&mut self, at: &[f64], columns: &mut [S]) {
        let stages = self.streams.len();
        let walls = self.grid.boundary == Boundary::Channel;
        let (ny, [of_stage, of_all]) = (self.grid.ny as isize, self.reach);
        let reach = if walls { 0 } else { of_all };
        self.told.fill(0);
        for row in -reach..ny + reach {
            self.load_state(at, row);
            let increments = self.dx.states[0].row_mut(row);
            if row >= ny {
                increments.copy_from_slice(self.first_rows.row(row.rem_euclid(ny)));
            } else {
                let increments = &mut increments[..self.strip.places() * self.variables * LANES];
                self.group.read(columns, row.rem_euclid(ny) as usize, self.strip, row >= 0, increments);
                if (0..of_all).contains(&row) {
                    self.first_rows.row_mut(row).copy_from_slice(self.dx.states[0].row(row));
                }
            }
            self.cascade(0, row, columns);
        }
        if walls {
            for stage in 0..stages {
                self.push_beyond(stage, ny - 1, false);
                self.continue_with(stage, ny - of_stage, columns);
                if of_stage > 1 {
                    self.finish(stage, ny - 1);
                    self.continue_with(stage, ny - 1, columns);
                }
            }
        }
    }

    fn load_state(&mut self, at: &[f64], row: isize) {
        let (nx, cells) = (self.grid.nx, self.grid.cells());
        let start = row.rem_euclid(self.grid.ny as isize) as usize * nx;
        let out = self.x.states[0].row_mut(row);
        for (out, field) in out.chunks_exact_mut(self.strip.places()).zip(at.chunks_exact(cells)) {
            self.strip.copy_row(&field[start..start + nx], out);
        }
    }

    fn cascade(&mut self, stage: usize, row: isize, columns: &mut [S]) {
        self.told[stage] += 1;
        let walls = self.grid.boundary == Boundary::Channel;
        if self.told[stage] == 1 && walls {
            // As if it had been told of as many rows beyond the wall as it reaches.
            self.told[stage] += self.reach[0] as usize;
            return self.push_beyond(stage, row, true);
        }
        let (places, len) = (self.strip.places(), self.strip.places() * self.variables);
        let (x, dx) = (&mut self.x, &mut self.dx);
        let (x_states, dx_states) = (&x.states[stage], &dx.states[stage]);
        let (x_row, dx_row) =
            (|row| Row::of(&x_states.row(row)[..len], places), |row| &dx_states.row(row)[..len * LANES]);
        if self.told[stage] == 1 {
            return self.streams[stage].begin(x_row(row), dx_row(row));
        }
        let known = row - self.reach[0];
        let (slope, d_slope) = (x.slopes[stage].row_mut(known), dx.slopes[stage].row_mut(known));
        self.streams[stage].push(
            row.rem_euclid(self.grid.ny as isize) as usize,
            (x_row(row - 1), x_row(row), &mut slope[..len]),
            (dx_row(row - 1), dx_row(row), &mut d_slope[..len * LANES]),
        );
        if self.told[stage] > 2 * self.reach[0] as usize {
            self.continue_with(stage, known, columns);
        }
    }

    /// Pushes the row beyond a wall, given the row beside it: before that row in the south, after it in the north.
    fn push_beyond(&mut self, stage: usize, row: isize, south: bool) {
        let (places, len) = (self.strip.places(), self.strip.places() * self.variables);
        let (stream, x, dx) = (&mut self.streams[stage], &mut self.x, &mut self.dx);
        let x_row = Row::of(&x.states[stage].row(row)[..len], places);
        let dx_row = &dx.states[stage].row(row)[..len * LANES];
        let (ghost, d_ghost) = (&mut x.ghost[..len], &mut dx.ghost[..len * LANES]);
        stream.beyond_wall(x_row, dx_row, ghost, d_ghost);
        let (x_ghost, pushed) = (Row::of(ghost, places), if south { row } else { row + 1 });
        let slope_row = pushed - self.reach[0];
        let slope = &mut x.slopes[stage].row_mut(slope_row)[..len];
        let d_slope = &mut dx.slopes[stage].row_mut(slope_row)[..len * LANES];
        if south {
            stream.begin(x_ghost, d_ghost);
            stream.push(pushed as usize, (x_ghost, x_row, slope), (d_ghost, dx_row, d_slope));
        } else {
            stream.push(pushed as usize, (x_row, x_ghost, slope), (dx_row, d_ghost, d_slope));
        }
    }

    /// The slopes of the row beside the northern wall, that beyond it having been pushed.
    fn finish(&mut self, stage: usize, row: isize) {
        let len = self.strip.places() * self.variables;
        let slope = &mut self.x.slopes[stage].row_mut(row)[..len];
        self.streams[stage].finish(slope, &mut self.dx.slopes[stage].row_mut(row)[..len * LANES]);
    }

    /// The slopes of a row at a stage are known: on to the next stage, or to the end.
    fn continue_with(&mut self, stage: usize, row: isize, columns: &mut [S]) {
        let (arch, scheme, len) = (self.arch, self.scheme, self.strip.places() * self.variables);
        if stage + 1 < self.streams.len() {
            self.x.continue_with(arch, scheme, stage, row, len);
            self.dx.continue_with(arch, scheme, stage, row, len * LANES);
            return self.cascade(stage + 1, row, columns);
        }
        let len = len * LANES;
        match scheme {
            Scheme::RungeKutta { .. } => {
                let (terms, count) = scheme.terms(stage, &self.dx.slopes, row);
                let x = Row::of(&self.dx.states[0].row(row)[..len], len);
                combine(arch, &mut self.result[..len], x, len, &terms[..count]);
                self.group.write(columns, row as usize, self.strip, &self.result[..len]);
            }
            Scheme::Leapfrog(leapfrog) => {
                let slopes = &self.dx.slopes[0].row(row)[..len];
                self.group.leap(columns, row as usize, self.strip, leapfrog, slopes);
            }
        }
    }
}
