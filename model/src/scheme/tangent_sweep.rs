//! Tangent-linear steps of a group of columns at once or of one, each as one sweep over the rows, beside the step of the state
//! they are linearised at: the coefficients of the derivative in a row are computed once for all, and neither the trajectory
//! nor the states of the stages nor their coefficients are ever stored for the whole grid.
//!
//! The columns of a group are interleaved for all steps of a forecast, so that one vector operation does the same for all
//! of them, whatever the length of a row; of a column alone it does the same for places beside each other. The lines are the
//! same, so that a column has the bits it has alone. Long rows are swept in [strips](super::strips).
//!
//! The state and the coefficients are computed in double precision. What is done with increments is done in the precision in
//! which they are stored: in single, a rounding to 2⁻²⁴ of each sum and product, with twice as many columns in a vector. No
//! sum is long and none cancels by more than the time step makes good: a step adds Δt F δx, whose size the stability limit
//! holds to that of δx, so that the errors of a step are some 2⁻²⁴ of the increment, in hyperdiffusion as in gravity waves.

use super::ends::{End, ends, needed};
use super::groups::{follows_state, for_each_group, linearised_at};
use super::held_groups::HeldGroups;
use super::rows::{Pushed, Ring, Row, TangentRowStream};
use super::stages::{Stages, load_state, of_strip};
use super::strips::{Lanes, Strip, StripReader};
use super::tendency::Tendency;
use super::update::{Scheme, combine, leap};
use crate::forecast::{Between, Exchange};
use crate::grid::Grid;
use crate::state::State;
use crate::stored::{ColumnsMut, Stored};
use pulp::Arch;

/// Advances the columns by `steps` steps along the trajectory from `at`, which `between` changes after each step but the last;
/// returns false, with nothing done, if the tendency has no row form. State and columns have all levels of the scheme.
pub(crate) fn sweep_tl<T: Tendency>(
    tendency: &T,
    scheme: Scheme<'_>,
    at: &[f64],
    columns: &mut ColumnsMut<'_>,
    steps: usize,
    between: Between<'_>,
) -> bool {
    match columns {
        ColumnsMut::Double(columns) => sweep_in(tendency, scheme, at, columns, steps, between),
        ColumnsMut::Single(columns) => sweep_in(tendency, scheme, at, columns, steps, between),
    }
}

/// [`sweep_tl`] in the precision of the columns.
fn sweep_in<T: Tendency, N: Stored>(
    tendency: &T,
    scheme: Scheme<'_>,
    at: &[f64],
    columns: &mut [N],
    steps: usize,
    between: Between<'_>,
) -> bool {
    if steps == 0 {
        return true;
    }
    let Some(sweep) = sweeps::<T, N>(tendency, scheme) else { return false };
    let start = linearised_at(tendency, at);
    // A state at which another is linearised stays as it is.
    let between: Between<'_> = if follows_state(tendency, at) { between } else { &|_, _| () };
    for_each_group(tendency, scheme.levels(), columns, sweep, |columns, sweep: &mut TangentWavefront<'_, N>| {
        sweep.advance(&start, columns, steps, between);
    });
    true
}

/// Advances a state and columns by `steps` steps, all by each of them after their fields are exchanged; `step` advances the state.
/// Returns false, with nothing done, if the tendency has no row form.
pub(crate) fn sweep_tl_exchanging<T: Tendency>(
    tendency: &T,
    scheme: Scheme<'_>,
    (at, step): (&mut State, impl Fn(&mut State)),
    columns: &mut ColumnsMut<'_>,
    steps: usize,
    exchange: Exchange<'_>,
) -> bool {
    match columns {
        ColumnsMut::Double(columns) => exchanging_in(tendency, scheme, (at, step), columns, steps, exchange),
        ColumnsMut::Single(columns) => exchanging_in(tendency, scheme, (at, step), columns, steps, exchange),
    }
}

/// [`sweep_tl_exchanging`] in the precision of the columns.
fn exchanging_in<T: Tendency, N: Stored>(
    tendency: &T,
    scheme: Scheme<'_>,
    (at, step): (&mut State, impl Fn(&mut State)),
    columns: &mut [N],
    steps: usize,
    exchange: Exchange<'_>,
) -> bool {
    let cells = tendency.layout().grid.cells();
    let Some(sweep) = sweeps::<T, N>(tendency, scheme) else { return false };
    let mut groups = HeldGroups::new(tendency, scheme.levels(), columns);
    for _ in 0..steps {
        let of_state = at.values_mut().chunks_exact_mut(cells).map(ColumnsMut::Double);
        exchange(&mut of_state.chain(groups.fields()).collect::<Vec<_>>());
        let start = linearised_at(tendency, at.values());
        groups.for_each(&sweep, |columns, sweep| sweep.advance(&start, columns, 1, &|_, _| ()));
        drop(start);
        step(at);
    }
    groups.separate();
    true
}

/// What makes the sweep of a worker over groups or single columns; `None` if the tendency has no row form.
fn sweeps<'a, T: Tendency, N: Stored>(
    tendency: &'a T,
    scheme: Scheme<'a>,
) -> Option<impl Fn(Lanes) -> Option<TangentWavefront<'a, N>> + Sync + 'a> {
    let (grid, variables) = (&tendency.layout().grid, tendency.layout().variables.len());
    let reach = tendency.tangent_row_stream::<N>(grid.nx.min(4), Lanes::One)?.reach() * scheme.stages();
    Some(move |lanes: Lanes| {
        let stream = |_| tendency.tangent_row_stream(lanes.most_places(grid.nx, scheme.stages(), reach), lanes);
        let streams: Option<Vec<_>> = (0..scheme.stages()).map(stream).collect();
        Some(TangentWavefront::new(scheme, streams?, (grid, ends(tendency)), variables, lanes))
    })
}

/// The sweep over the whole grid.
struct TangentWavefront<'a, N> {
    arch: Arch,
    scheme: Scheme<'a>,
    grid: &'a Grid,
    ends: [End; 2],
    variables: usize,
    lanes: Lanes,
    streams: Vec<Box<dyn TangentRowStream<N> + 'a>>,
    /// Rows pushed to each stage so far.
    pushed: Vec<usize>,
    /// Rows by which each stage is behind the one before.
    stage_reach: isize,
    /// Rows by which the last stage is behind the first row pushed.
    total_reach: isize,
    strip: Strip,
    x: Stages,
    dx: Stages<N>,
    reader: StripReader<N>,
    /// The first rows of the columns, which come again at the end of a periodic sweep.
    first_rows: Ring<N>,
    /// The state before and after the later steps, all levels `[variable, y, x]`.
    at: [Vec<f64>; 2],
    last_step: bool,
}

impl<'a, N: Stored> TangentWavefront<'a, N> {
    /// For columns of `variables` variables, with a stream for each stage.
    fn new(
        scheme: Scheme<'a>,
        streams: Vec<Box<dyn TangentRowStream<N> + 'a>>,
        (grid, ends): (&'a Grid, [End; 2]),
        variables: usize,
        lanes: Lanes,
    ) -> Self {
        let (stages, of_stage) = (streams.len(), streams[0].reach());
        let reach = of_stage * stages;
        let places = lanes.most_places(grid.nx, stages, reach);
        let row_len = variables * (places + 2) * lanes.count::<N>();
        Self {
            arch: Arch::new(),
            scheme,
            grid,
            ends,
            variables,
            lanes,
            pushed: vec![0; stages],
            stage_reach: of_stage as isize,
            total_reach: reach as isize,
            strip: Strip::of_row(grid.nx, lanes, stages, reach)[0],
            streams,
            x: Stages::new(stages, of_stage, variables * places),
            dx: Stages::new(stages, of_stage, row_len),
            reader: StripReader::new(variables, [grid.nx, grid.ny], lanes, stages, reach),
            first_rows: Ring::new(row_len, reach),
            at: [Vec::new(), Vec::new()],
            last_step: false,
        }
    }

    /// Advances the columns by `steps` steps along the trajectory from `start`, in place.
    fn advance(&mut self, start: &[f64], columns: &mut [N], steps: usize, between: Between<'_>) {
        let [mut before, mut after] = std::mem::take(&mut self.at);
        after.resize(if steps > 1 { start.len() } else { 0 }, 0.0);
        before.resize(if steps > 2 { start.len() } else { 0 }, 0.0);
        for step in 1..=steps {
            self.last_step = step == steps;
            for strip in Strip::of_row(self.grid.nx, self.lanes, self.streams.len(), self.total_reach as usize) {
                self.strip = strip;
                self.sweep_strip(if step == 1 { start } else { &before }, &mut after, columns);
            }
            if !self.last_step {
                between(step, &mut after);
            }
            std::mem::swap(&mut before, &mut after);
        }
        self.at = [before, after];
    }

    fn sweep_strip(&mut self, at: &[f64], after: &mut [f64], columns: &mut [N]) {
        let stages = self.streams.len();
        let (ny, of_stage) = (self.grid.ny as isize, self.stage_reach);
        let shape = [self.grid.nx, self.grid.cells()];
        self.pushed.fill(0);
        let rows = needed(&(0..self.grid.ny), self.grid.ny, self.ends, self.total_reach as usize);
        // Those that come again at the end of a periodic domain.
        let again = 0..rows.end - ny;
        for row in rows {
            let grid_row = row.rem_euclid(ny);
            load_state(at, shape, grid_row as usize, self.strip, self.x.states[0].row_mut(row));
            let increments = self.dx.states[0].row_mut(row);
            if row >= ny {
                increments.copy_from_slice(self.first_rows.row(grid_row));
            } else {
                self.reader.read(columns, grid_row as usize, self.strip, row >= 0, increments);
                if again.contains(&row) {
                    self.first_rows.row_mut(row).copy_from_slice(self.dx.states[0].row(row));
                }
            }
            self.cascade(0, row, at, after, columns);
        }
        if self.ends[1] == End::Wall {
            for stage in 0..stages {
                self.push_beyond(stage, ny - 1, false);
                self.continue_with(stage, ny - of_stage, at, after, columns);
                if of_stage > 1 {
                    let (x, dx) = self.lengths();
                    let slope = &mut self.x.slopes[stage].row_mut(ny - 1)[..x];
                    self.streams[stage].finish(slope, &mut self.dx.slopes[stage].row_mut(ny - 1)[..dx]);
                    self.continue_with(stage, ny - 1, at, after, columns);
                }
            }
        }
    }

    fn cascade(&mut self, stage: usize, row: isize, at: &[f64], after: &mut [f64], columns: &mut [N]) {
        self.pushed[stage] += 1;
        if self.pushed[stage] == 1 && self.ends[0] == End::Wall {
            // The row beyond the wall stands for all rows there within reach.
            self.pushed[stage] += self.stage_reach as usize;
            return self.push_beyond(stage, row, true);
        }
        let (variables, places, stride, (len, d_len)) =
            (self.variables, self.strip.places(), self.stride(), self.lengths());
        let of_x = |row| of_strip(&self.x.states[stage], row, variables, places);
        let of_dx = |row| of_strip(&self.dx.states[stage], row, variables, stride);
        if self.pushed[stage] == 1 {
            return self.streams[stage].begin(row, of_x(row), of_dx(row));
        }
        let known = row - self.stage_reach;
        let tendency = &mut self.x.slopes[stage].row_mut(known)[..len];
        let d_tendency = &mut self.dx.slopes[stage].row_mut(known)[..d_len];
        let (x, dx) = ([of_x(row - 1), of_x(row)], [of_dx(row - 1), of_dx(row)]);
        self.streams[stage].push(
            row,
            Pushed { south: x[0], north: x[1], tendency },
            Pushed { south: dx[0], north: dx[1], tendency: d_tendency },
        );
        if self.pushed[stage] > 2 * self.stage_reach as usize {
            self.continue_with(stage, known, at, after, columns);
        }
    }

    /// Pushes the row beyond a wall, given the row beside it: before that row in the south, after it in the north.
    fn push_beyond(&mut self, stage: usize, row: isize, south: bool) {
        let (len, d_len) = self.lengths();
        let (places, stride) = (self.strip.places(), self.stride());
        let (stream, x, dx) = (&mut self.streams[stage], &mut self.x, &mut self.dx);
        let x_row = of_strip(&x.states[stage], row, self.variables, places);
        let dx_row = of_strip(&dx.states[stage], row, self.variables, stride);
        let (ghost, d_ghost) = (&mut x.ghost[..len], &mut dx.ghost[..d_len]);
        stream.beyond_wall(x_row, dx_row, ghost, d_ghost);
        let (x_ghost, dx_ghost) = (Row::of(ghost, places), Row::of(d_ghost, stride));
        let pushed = if south { row } else { row + 1 };
        let known = pushed - self.stage_reach;
        let (slope, d_slope) =
            (&mut x.slopes[stage].row_mut(known)[..len], &mut dx.slopes[stage].row_mut(known)[..d_len]);
        if south {
            stream.begin(pushed - 1, x_ghost, dx_ghost);
            let x = Pushed { south: x_ghost, north: x_row, tendency: slope };
            stream.push(pushed, x, Pushed { south: dx_ghost, north: dx_row, tendency: d_slope });
        } else {
            let x = Pushed { south: x_row, north: x_ghost, tendency: slope };
            stream.push(pushed, x, Pushed { south: dx_row, north: dx_ghost, tendency: d_slope });
        }
    }

    /// The slopes of a row at a stage are known: on to the next stage, or to the end.
    fn continue_with(&mut self, stage: usize, row: isize, at: &[f64], after: &mut [f64], columns: &mut [N]) {
        let (arch, scheme, strip) = (self.arch, self.scheme, self.strip);
        let (len, d_len) = self.lengths();
        if stage + 1 < self.streams.len() {
            self.x.continue_with(arch, scheme, stage, row, len);
            self.dx.continue_with(arch, scheme, stage, row, d_len);
            return self.cascade(stage + 1, row, at, after, columns);
        }
        let (now, before) = columns.split_at_mut(columns.len() / scheme.levels());
        for variable in 0..self.variables {
            let (own, inner) = (self.reader.own(variable, row as usize, strip), self.reader.inner(variable, strip));
            let now = &mut now[own.clone()];
            if let Scheme::Leapfrog(leapfrog) = scheme {
                let slope = &self.dx.slopes[0].row(row)[inner];
                leap(arch, leapfrog, &mut [now, &mut before[own]], 0, slope.len(), slope);
            } else {
                let (terms, count) = scheme.terms(stage, &self.dx.slopes, row, inner.clone());
                let x = Row::of(&self.dx.states[0].row(row)[inner], now.len());
                let len = now.len();
                combine(arch, now, x, len, &terms[..count]);
            }
        }
        if !self.last_step {
            let shape = [self.grid.nx, self.grid.cells()];
            self.x.advance_state(arch, scheme, shape, strip, row as usize, at, after);
        }
    }

    /// Values of a variable's row of increments.
    fn stride(&self) -> usize {
        self.strip.stride(self.lanes.count::<N>())
    }

    /// Values of a row of the state and of increments.
    fn lengths(&self) -> (usize, usize) {
        (self.variables * self.strip.places(), self.variables * self.stride())
    }
}
