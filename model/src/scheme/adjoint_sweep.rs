//! Adjoint steps of a group of columns at once or of one, each as one sweep over the rows: the transposes of the stages follow
//! each other from the last to the first at the distances of the stages themselves, behind the stages of the state.
//!
//! ```text
//! row  j + 8   x read                       stage 1 has its slope up to row j + 7
//!      j + 5   stage 4 state                and the coefficients of its derivative up to row j + 4
//!      j + 4   y read                       stage 4 has its gradient up to row j + 3
//!      j + 1   stage 1 input                stage 1 has its gradient up to row j
//!      j       all gradients known: y written
//! ```
//!
//! As in [`super::tangent_sweep`] neither states of the stages nor coefficients are stored for the whole grid, columns are
//! interleaved for all steps, and a column has the bits it has alone. The scheme is that of the stages' gradients in
//! [`super::runge_kutta`], with y constrained first.

use super::groups::{for_each_group, linearised_at};
use super::rows::{AdjointRowStream, Pushed, Ring, Row};
use super::stages::{Stages, load_state, of_strip};
use super::strips::{Lanes, Strip, StripReader};
use super::tendency::Tendency;
use super::update::{Scheme, add_slopes, combine, weigh};
use crate::grid::{Boundary, Grid};
use crate::state::State;
use pulp::Arch;
use std::borrow::Cow;

/// Takes the columns back along the states before each step, from the last to the first; returns false, with nothing done,
/// if the tendency has no row form. States and columns have all levels of the scheme.
pub(crate) fn sweep_ad<T: Tendency>(tendency: &T, scheme: Scheme<'_>, states: &[State], columns: &mut [f64]) -> bool {
    let (grid, variables) = (&tendency.layout().grid, tendency.layout().variables.len());
    let Some(stream) = tendency.adjoint_row_stream(grid.nx.min(4), Lanes::One, 1) else { return false };
    if states.is_empty() {
        return true;
    }
    let reach = Reach::new(stream.reach(), scheme.stages());
    let level = tendency.layout().len();
    let states: Vec<Cow<'_, [f64]>> =
        states.iter().map(|state| linearised_at(tendency, &state.values()[..level])).collect();
    let sweep = |lanes: Lanes| {
        let places = lanes.most_places(grid.nx, reach.stages, reach.of_x as usize);
        let stream = |stage| tendency.adjoint_row_stream(places, lanes, reach.delay(stage));
        let streams: Option<Vec<_>> = (0..scheme.stages()).map(stream).collect();
        Some(AdjointWavefront::new(scheme, reach, streams?, grid, variables, lanes))
    };
    for_each_group(tendency, scheme.levels(), columns, sweep, |columns, sweep: &mut AdjointWavefront<'_>| {
        sweep.take_back(&states, columns);
    });
    true
}

/// How many rows a sweep reaches.
#[derive(Clone, Copy)]
struct Reach {
    stages: usize,
    /// Rows by which each stage is behind the one before it, forwards or back.
    of_stage: isize,
    /// Rows of y on either side of a row that is taken back.
    of_y: isize,
    /// Rows of the state.
    of_x: isize,
}

impl Reach {
    fn new(of_stage: usize, stages: usize) -> Self {
        let (of_stage, count) = (of_stage as isize, stages as isize);
        Self { stages, of_stage, of_y: of_stage * count, of_x: of_stage * (2 * count - 1) + 1 }
    }

    /// The row of y to push when a row of the state has been.
    fn row_of_y(self, row: isize) -> isize {
        row - (self.of_x - self.of_y)
    }

    /// The most rows that a stage's adjoint is behind the stage, which is when the latter is done and the former is not.
    fn delay(self, stage: usize) -> usize {
        self.of_stage as usize * (2 * self.stages - 2 - stage) + 1
    }
}

/// The sweep over the whole grid.
struct AdjointWavefront<'a> {
    arch: Arch,
    scheme: Scheme<'a>,
    grid: &'a Grid,
    variables: usize,
    lanes: Lanes,
    streams: Vec<Box<dyn AdjointRowStream + 'a>>,
    reach: Reach,
    /// Rows of the state and of y pushed to each stage so far.
    pushed: [Vec<usize>; 2],
    strip: Strip,
    x: Stages,
    /// y, for leapfrog n* + α f*.
    y: Ring,
    /// k* of each stage.
    inputs: Vec<Ring>,
    /// g of each stage.
    gradients: Vec<Ring>,
    /// Of each level.
    readers: Vec<StripReader>,
    /// A row of the earlier level; beyond a wall, any row.
    row: Vec<f64>,
    /// The first rows of y, which come again at the end of a periodic sweep.
    first_rows: Ring,
}

impl<'a> AdjointWavefront<'a> {
    /// For columns of `variables` variables, with a stream for each stage.
    fn new(
        scheme: Scheme<'a>,
        reach: Reach,
        streams: Vec<Box<dyn AdjointRowStream + 'a>>,
        grid: &'a Grid,
        variables: usize,
        lanes: Lanes,
    ) -> Self {
        let (stages, shape) = (streams.len(), [grid.nx, grid.ny]);
        let places = lanes.most_places(grid.nx, stages, reach.of_x as usize);
        let y_places = lanes.most_places(grid.nx, stages, reach.of_y as usize);
        let row_len = variables * (y_places + 2) * lanes.count::<f64>();
        let of_stage = reach.of_stage as usize;
        let reader = |_| StripReader::new(variables, shape, lanes, stages, reach.of_y as usize);
        Self {
            arch: Arch::new(),
            scheme,
            grid,
            variables,
            lanes,
            streams,
            reach,
            pushed: [vec![0; stages], vec![0; stages]],
            strip: Strip::of_row(grid.nx, lanes, stages, reach.of_x as usize)[0],
            x: Stages::new(stages, of_stage, variables * places),
            y: Ring::new(row_len, reach.of_y as usize + 1),
            inputs: (0..stages).map(|_| Ring::new(row_len, 2)).collect(),
            gradients: (0..stages).map(|stage| Ring::new(row_len, of_stage * stage + 1)).collect(),
            readers: (0..scheme.levels()).map(reader).collect(),
            row: vec![0.0; row_len],
            first_rows: Ring::new(row_len, reach.of_y as usize),
        }
    }

    /// Takes the columns back by a step from each of the states, in place.
    fn take_back(&mut self, states: &[Cow<'_, [f64]>], columns: &mut [f64]) {
        for at in states.iter().rev() {
            for strip in Strip::of_row(self.grid.nx, self.lanes, self.reach.stages, self.reach.of_x as usize) {
                self.strip = strip;
                self.sweep_strip(at, columns);
            }
        }
    }

    fn sweep_strip(&mut self, at: &[f64], columns: &mut [f64]) {
        let walls = self.grid.boundary == Boundary::Channel;
        let (ny, reach) = (self.grid.ny as isize, self.reach);
        let [of_x, of_y] = [reach.of_x, reach.of_y].map(|rows| if walls { 0 } else { rows });
        let shape = [self.grid.nx, self.grid.cells()];
        self.pushed.iter_mut().for_each(|pushed| pushed.fill(0));
        for row in -of_x..ny + of_x {
            load_state(at, shape, row.rem_euclid(ny) as usize, self.strip, self.x.states[0].row_mut(row));
            self.cascade_state(0, row);
            let row = reach.row_of_y(row);
            if row >= -of_y {
                self.push(row, columns);
            }
        }
        if walls {
            self.push_northern_wall(columns);
        }
    }

    /// In a channel all rows of the state have been pushed but that beyond the northern wall.
    fn push_northern_wall(&mut self, columns: &mut [f64]) {
        let (ny, of_stage, stages) = (self.grid.ny as isize, self.reach.of_stage, self.streams.len());
        for stage in 0..stages {
            self.push_state_beyond(stage, ny - 1, false);
            self.continue_state(stage, ny - of_stage);
            if of_stage > 1 {
                let len = self.state_len();
                self.streams[stage].finish_state(&mut self.x.slopes[stage].row_mut(ny - 1)[..len]);
                self.continue_state(stage, ny - 1);
            }
        }
        for row in self.reach.row_of_y(ny).max(0)..ny {
            self.push(row, columns);
        }
        for stage in (0..stages).rev() {
            let len = self.variables * self.stride();
            let south = of_strip(&self.inputs[stage], ny - 1, self.variables, self.stride());
            let out = &mut self.gradients[stage].row_mut(ny - of_stage)[..len];
            self.streams[stage].push(ny, south, south, out);
            self.continue_with(stage, ny - of_stage, columns);
            if of_stage > 1 {
                self.streams[stage].finish(&mut self.gradients[stage].row_mut(ny - 1)[..len]);
                self.continue_with(stage, ny - 1, columns);
            }
        }
    }

    /// Pushes the state of a row to a stage, and what that makes known to the later ones.
    fn cascade_state(&mut self, stage: usize, row: isize) {
        let pushed = &mut self.pushed[0][stage];
        *pushed += 1;
        let (pushed, of_stage) = (*pushed, self.reach.of_stage);
        if pushed == 1 && self.grid.boundary == Boundary::Channel {
            // The row beyond the wall stands for all rows there within reach.
            self.pushed[0][stage] += of_stage as usize;
            return self.push_state_beyond(stage, row, true);
        }
        let (len, stream) = (self.state_len(), &mut self.streams[stage]);
        let of_x = |row| of_strip(&self.x.states[stage], row, self.variables, self.strip.places());
        if pushed == 1 {
            return stream.begin(row, of_x(row));
        }
        let tendency = &mut self.x.slopes[stage].row_mut(row - of_stage)[..len];
        stream.push_state(row, Pushed { south: of_x(row - 1), north: of_x(row), tendency });
        if pushed > 2 * of_stage as usize {
            self.continue_state(stage, row - of_stage);
        }
    }

    /// Pushes the row of the state beyond a wall, given the row beside it.
    fn push_state_beyond(&mut self, stage: usize, row: isize, south: bool) {
        let (len, places) = (self.state_len(), self.strip.places());
        let (stream, x) = (&mut self.streams[stage], &mut self.x);
        let x_row = of_strip(&x.states[stage], row, self.variables, places);
        stream.beyond_wall(x_row, &mut x.ghost[..len]);
        let ghost = Row::of(&x.ghost[..len], places);
        let pushed = if south { row } else { row + 1 };
        let tendency = &mut x.slopes[stage].row_mut(pushed - self.reach.of_stage)[..len];
        if south {
            stream.begin(pushed - 1, ghost);
            stream.push_state(pushed, Pushed { south: ghost, north: x_row, tendency });
        } else {
            stream.push_state(pushed, Pushed { south: x_row, north: ghost, tendency });
        }
    }

    /// The slopes of the state's row at a stage are known: on to the next.
    fn continue_state(&mut self, stage: usize, row: isize) {
        if stage + 1 < self.streams.len() {
            self.x.continue_with(self.arch, self.scheme, stage, row, self.state_len());
            self.cascade_state(stage + 1, row);
        }
    }

    /// Pushes a row of y to the last stage.
    fn push(&mut self, row: isize, columns: &mut [f64]) {
        let ny = self.grid.ny as isize;
        let (level, strip) = (columns.len() / self.scheme.levels(), self.strip_of_y());
        let y = self.y.row_mut(row);
        if row >= ny {
            y.copy_from_slice(self.first_rows.row(row.rem_euclid(ny)));
        } else {
            let (grid_row, to_be_advanced) = (row.rem_euclid(ny) as usize, row >= 0);
            self.readers[0].read(columns, grid_row, strip, to_be_advanced, y);
            if let Scheme::Leapfrog(leapfrog) = self.scheme {
                self.readers[1].read(&columns[level..], grid_row, strip, to_be_advanced, &mut self.row);
                let len = y.len();
                add_slopes(self.arch, &mut [&mut *y], 0, len, &[(leapfrog.alpha, &self.row)]);
            }
            if (0..self.reach.of_y).contains(&row) {
                self.first_rows.row_mut(row).copy_from_slice(self.y.row(row));
            }
        }
        self.cascade(self.streams.len() - 1, row, columns);
    }

    /// All gradients that a row of a stage's k* consists of are known: pushes it, and what that makes known to earlier stages.
    fn cascade(&mut self, stage: usize, row: isize, columns: &mut [f64]) {
        let (len, stride, of_stage) = (self.variables * self.stride(), self.stride(), self.reach.of_stage);
        let (terms, count) = self.scheme.terms_ad(stage, &self.y.row(row)[..len], &self.gradients, row);
        weigh(self.arch, &mut self.inputs[stage].row_mut(row)[..len], &terms[..count]);
        let pushed = &mut self.pushed[1][stage];
        *pushed += 1;
        if *pushed == 1 {
            if self.grid.boundary == Boundary::Periodic {
                return;
            }
            // The row beyond the wall stands for all rows there within reach.
            *pushed += of_stage as usize;
        }
        let is_known = *pushed > 2 * of_stage as usize;
        let input = |row| of_strip(&self.inputs[stage], row, self.variables, stride);
        let out = &mut self.gradients[stage].row_mut(row - of_stage)[..len];
        self.streams[stage].push(row, input(row - 1), input(row), out);
        if is_known {
            self.continue_with(stage, row - of_stage, columns);
        }
    }

    /// The gradient of a stage is known in a row: on to the stage before, or to the end.
    fn continue_with(&mut self, stage: usize, row: isize, columns: &mut [f64]) {
        if stage > 0 {
            return self.cascade(stage - 1, row, columns);
        }
        let (strip, reader) = (self.strip_of_y(), &self.readers[0]);
        let (now, before) = columns.split_at_mut(columns.len() / self.scheme.levels());
        for variable in 0..self.variables {
            let (own, inner) = (reader.own(variable, row as usize, strip), reader.inner(variable, strip));
            let (now, y, len) = (&mut now[own.clone()], &self.y.row(row)[inner.clone()], own.len());
            if let Scheme::Leapfrog(leapfrog) = self.scheme {
                let gradient = &self.gradients[0].row(row)[inner];
                leapfrog.take_back(now, &mut before[own], y, gradient);
            } else {
                let mut terms: [(f64, &[f64]); 8] = [(1.0, &[]); 8];
                for (term, gradients) in terms.iter_mut().zip(self.gradients.iter().rev()) {
                    term.1 = &gradients.row(row)[inner.clone()];
                }
                combine(self.arch, now, Row::of(y, len), len, &terms[..self.gradients.len()]);
            }
        }
    }

    /// The strip with as many places on either side as y needs.
    fn strip_of_y(&self) -> Strip {
        self.strip.reaching(self.reach.of_y as usize)
    }

    /// Values of a variable's row of columns.
    fn stride(&self) -> usize {
        self.strip_of_y().stride(self.lanes.count::<f64>())
    }

    /// Values of a row of the state.
    fn state_len(&self) -> usize {
        self.variables * self.strip.places()
    }
}
