//! Tangent-linear steps of eight columns at once, each as one sweep over the rows, beside the step of the state they are
//! linearised at: the coefficients of the derivative in a row are computed once for the eight, and neither the trajectory
//! nor the states of the stages nor their coefficients are ever stored for the whole grid.
//!
//! The columns of a group are interleaved for all steps of a forecast, so that one vector operation does the same for all
//! of them, whatever the length of a row, and a sweep reads and writes memory from end to end; the columns missing from a
//! last group are zero. No column knows of the others, so that its bits are those it has alone. Long rows are swept in
//! strips; the outermost places on either side of a strip become wrong by as many places as the stencil reaches with each
//! stage, as a strip takes itself for periodic: the next stage leaves them out.

use super::interleaving::Interleaving;
use super::rows::{Pushed, Ring, Row, TangentRowStream};
use super::strips::{Group, MOST_PLACES, Strip};
use super::tendency::Tendency;
use super::update::{Scheme, combine, leap};
use crate::columns::{Columns, LANES};
use crate::grid::{Boundary, Grid};
use crate::stored::{ColumnsMut, Stored};
use pulp::Arch;
use std::ops::Range;

/// Advances the columns by `steps` steps, eight columns at a time, along the trajectory from `at`; returns false, with
/// nothing done, if the tendency has no row form. State and columns have all levels of the scheme.
pub(crate) fn sweep_tl<T: Tendency>(
    tendency: &T,
    scheme: Scheme<'_>,
    at: &[f64],
    columns: &mut ColumnsMut<'_>,
    steps: usize,
) -> bool {
    match columns {
        ColumnsMut::Double(columns) => sweep_stored(tendency, scheme, at, columns, steps),
        ColumnsMut::Single(columns) => sweep_stored(tendency, scheme, at, columns, steps),
    }
}

fn sweep_stored<T: Tendency, S: Stored>(
    tendency: &T,
    scheme: Scheme<'_>,
    at: &[f64],
    columns: &mut [S],
    steps: usize,
) -> bool {
    if steps == 0 {
        return true;
    }
    let (grid, variables) = (&tendency.layout().grid, tendency.layout().variables.len());
    let wavefront = || {
        let stream = |_| tendency.tangent_row_stream(grid.nx.min(MOST_PLACES));
        let streams: Option<Vec<_>> = (0..scheme.stages()).map(stream).collect();
        Some(TangentWavefront::new(scheme, streams?, grid, variables))
    };
    if tendency.tangent_row_stream(grid.nx.min(MOST_PLACES)).is_none() {
        return false;
    }
    let level = tendency.layout().len();
    let constrain = |levels: &mut [f64]| levels.chunks_exact_mut(level).for_each(|level| tendency.constrain(level));
    let mut start: Vec<f64> = at.chunks_exact(level).flat_map(|at| tendency.linearised_at(at)).copied().collect();
    constrain(&mut start);
    let work = || (wavefront(), Vec::new(), Vec::new());
    Columns::new(columns, at.len()).for_each_group(LANES, work, |group, (wavefront, copy, filled)| {
        let Some(wavefront) = wavefront else { return };
        S::in_double(group, copy, |columns| {
            constrain(columns);
            if columns.len() == LANES * at.len() {
                return wavefront.advance(&start, columns, steps);
            }
            filled.clear();
            filled.extend_from_slice(columns);
            filled.resize(LANES * at.len(), 0.0);
            wavefront.advance(&start, filled, steps);
            columns.copy_from_slice(&filled[..columns.len()]);
        });
    });
    true
}

/// States and slopes at all stages.
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

    /// Part of a row's state at the next stage.
    fn continue_with(&mut self, arch: Arch, scheme: Scheme<'_>, stage: usize, row: isize, part: Range<usize>) {
        let (terms, count) = scheme.terms(stage, &self.slopes, row, part.clone());
        let (first, later) = self.states.split_at_mut(1);
        let x = Row::of(&first[0].row(row)[part.clone()], part.len());
        combine(arch, &mut later[stage].row_mut(row)[part.clone()], x, part.len(), &terms[..count]);
    }
}

/// The sweep over the whole grid.
struct TangentWavefront<'a> {
    arch: Arch,
    scheme: Scheme<'a>,
    grid: &'a Grid,
    variables: usize,
    streams: Vec<Box<dyn TangentRowStream + 'a>>,
    /// Rows pushed to each stage so far.
    pushed: Vec<usize>,
    /// Rows by which each stage is behind the one before.
    stage_reach: isize,
    /// Rows by which the last stage is behind the first row pushed.
    total_reach: isize,
    strip: Strip,
    x: Stages,
    dx: Stages,
    interleaving: Interleaving,
    group: Group,
    /// The first rows of the columns, which come again at the end of a periodic sweep.
    first_rows: Ring,
    /// The state before and after the step, all levels `[variable, y, x]`.
    at: [Vec<f64>; 2],
    /// The state's row of a stage's slopes or of the step, `[variable, x]`.
    row: Vec<f64>,
    last_step: bool,
}

impl<'a> TangentWavefront<'a> {
    /// For columns of `variables` variables, with a stream for each stage.
    fn new(scheme: Scheme<'a>, streams: Vec<Box<dyn TangentRowStream + 'a>>, grid: &'a Grid, variables: usize) -> Self {
        let (stages, row_len) = (streams.len(), variables * grid.nx.min(MOST_PLACES));
        let of_stage = streams[0].reach();
        let reach = of_stage * stages;
        Self {
            arch: Arch::new(),
            scheme,
            grid,
            variables,
            pushed: vec![0; stages],
            stage_reach: of_stage as isize,
            total_reach: reach as isize,
            strip: Strip::of_row(grid.nx, reach)[0],
            streams,
            x: Stages::new(stages, of_stage, row_len),
            dx: Stages::new(stages, of_stage, row_len * LANES),
            interleaving: Interleaving::new(scheme.levels(), variables, [grid.nx, grid.ny]),
            group: Group::new(variables, [grid.nx, grid.ny], reach),
            first_rows: Ring::new(row_len * LANES, reach),
            at: [Vec::new(), Vec::new()],
            row: vec![0.0; row_len],
            last_step: false,
        }
    }

    /// Advances eight columns by `steps` steps along the trajectory from `start`, in place.
    fn advance(&mut self, start: &[f64], columns: &mut [f64], steps: usize) {
        self.at[0].clear();
        self.at[0].extend_from_slice(start);
        self.at[1].resize(if steps > 1 { start.len() } else { 0 }, 0.0);
        self.interleaving.interleave(columns);
        for step in 1..=steps {
            self.last_step = step == steps;
            for strip in Strip::of_row(self.grid.nx, self.total_reach as usize) {
                self.strip = strip;
                self.sweep_strip(columns);
            }
            if !self.last_step {
                self.at.swap(0, 1);
            }
        }
        self.interleaving.separate(columns);
    }

    fn sweep_strip(&mut self, columns: &mut [f64]) {
        let stages = self.streams.len();
        let walls = self.grid.boundary == Boundary::Channel;
        let (ny, of_stage, of_all) = (self.grid.ny as isize, self.stage_reach, self.total_reach);
        let reach = if walls { 0 } else { of_all };
        self.pushed.fill(0);
        for row in -reach..ny + reach {
            self.load_state(row);
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

    fn load_state(&mut self, row: isize) {
        let (nx, cells) = (self.grid.nx, self.grid.cells());
        let start = row.rem_euclid(self.grid.ny as isize) as usize * nx;
        let out = self.x.states[0].row_mut(row);
        for (out, field) in out.chunks_exact_mut(self.strip.places()).zip(self.at[0].chunks_exact(cells)) {
            self.strip.copy_row(&field[start..start + nx], out);
        }
    }

    fn cascade(&mut self, stage: usize, row: isize, columns: &mut [f64]) {
        self.pushed[stage] += 1;
        let walls = self.grid.boundary == Boundary::Channel;
        if self.pushed[stage] == 1 && walls {
            // The row beyond the wall stands for all rows there within reach.
            self.pushed[stage] += self.stage_reach as usize;
            return self.push_beyond(stage, row, true);
        }
        let span = self.span(stage);
        if self.pushed[stage] == 1 {
            let x = span.of_state(&self.x.states[stage], row);
            return self.streams[stage].begin(x, &self.dx.states[stage].row(row)[span.increments()]);
        }
        let known = row - self.stage_reach;
        let (x, dx) = (&self.x.states[stage], &self.dx.states[stage]);
        let d_slope = &mut self.dx.slopes[stage].row_mut(known)[span.increments()];
        self.streams[stage].push(
            row.rem_euclid(self.grid.ny as isize) as usize,
            Pushed {
                south: span.of_state(x, row - 1),
                north: span.of_state(x, row),
                tendency: &mut self.row[..span.len()],
            },
            Pushed {
                south: &dx.row(row - 1)[span.increments()],
                north: &dx.row(row)[span.increments()],
                tendency: d_slope,
            },
        );
        span.keep(&self.row, self.x.slopes[stage].row_mut(known));
        if self.pushed[stage] > 2 * self.stage_reach as usize {
            self.continue_with(stage, known, columns);
        }
    }

    /// Pushes the row beyond a wall, given the row beside it: before that row in the south, after it in the north.
    fn push_beyond(&mut self, stage: usize, row: isize, south: bool) {
        let span = self.span(stage);
        let (stream, x, dx) = (&mut self.streams[stage], &mut self.x, &mut self.dx);
        let x_row = span.of_state(&x.states[stage], row);
        let dx_row = &dx.states[stage].row(row)[span.increments()];
        let (ghost, d_ghost) = (&mut x.ghost[..span.len()], &mut dx.ghost[..span.len() * LANES]);
        stream.beyond_wall(x_row, dx_row, ghost, d_ghost);
        let (x_ghost, pushed) = (Row::of(ghost, span.own.len()), if south { row } else { row + 1 });
        let known = pushed - self.stage_reach;
        let (slope, d_slope) = (&mut self.row[..span.len()], &mut dx.slopes[stage].row_mut(known)[span.increments()]);
        if south {
            stream.begin(x_ghost, d_ghost);
            let x = Pushed { south: x_ghost, north: x_row, tendency: slope };
            stream.push(pushed as usize, x, Pushed { south: d_ghost, north: dx_row, tendency: d_slope });
        } else {
            let x = Pushed { south: x_row, north: x_ghost, tendency: slope };
            stream.push(pushed as usize, x, Pushed { south: dx_row, north: d_ghost, tendency: d_slope });
        }
        span.keep(&self.row, x.slopes[stage].row_mut(known));
    }

    /// The slopes of the row beside the northern wall, that beyond it having been pushed.
    fn finish(&mut self, stage: usize, row: isize) {
        let span = self.span(stage);
        let d_slope = &mut self.dx.slopes[stage].row_mut(row)[span.increments()];
        self.streams[stage].finish(&mut self.row[..span.len()], d_slope);
        span.keep(&self.row, self.x.slopes[stage].row_mut(row));
    }

    /// The slopes of a row at a stage are known: on to the next stage, or to the end.
    fn continue_with(&mut self, stage: usize, row: isize, columns: &mut [f64]) {
        let (arch, scheme, span) = (self.arch, self.scheme, self.span(stage + 1));
        if stage + 1 < self.streams.len() {
            self.x.continue_with(arch, scheme, stage, row, 0..self.strip.places() * self.variables);
            self.dx.continue_with(arch, scheme, stage, row, span.increments());
            return self.cascade(stage + 1, row, columns);
        }
        let part = span.increments();
        let (now, before) = self.group.row_mut(columns, row as usize, self.strip);
        if let Scheme::Leapfrog(leapfrog) = scheme {
            leap(arch, leapfrog, &mut [now, before], 0, part.len(), &self.dx.slopes[0].row(row)[part]);
        } else {
            let (terms, count) = scheme.terms(stage, &self.dx.slopes, row, part.clone());
            let x = Row::of(&self.dx.states[0].row(row)[part], now.len());
            combine(arch, now, x, now.len(), &terms[..count]);
        }
        if !self.last_step {
            self.advance_state(row);
        }
    }

    /// The state's row after the step.
    fn advance_state(&mut self, row: isize) {
        let (places, cells, reach, strip) = (self.strip.places(), self.grid.cells(), self.strip.reach, self.strip);
        let (own, inner) = (strip.of_grid(row as usize), reach..reach + strip.width);
        let (stages, len) = (self.streams.len(), places * self.variables);
        let [before, after] = &mut self.at;
        if let Scheme::RungeKutta { .. } = self.scheme {
            let (terms, count) = self.scheme.terms(stages - 1, &self.x.slopes, row, 0..len);
            let x = Row::of(&self.x.states[0].row(row)[..len], len);
            combine(self.arch, &mut self.row[..len], x, len, &terms[..count]);
            for (field, values) in after.chunks_exact_mut(cells).zip(self.row.chunks_exact(places)) {
                field[own.clone()].copy_from_slice(&values[inner.clone()]);
            }
        }
        if let Scheme::Leapfrog(leapfrog) = self.scheme {
            for (field, from) in after.chunks_exact_mut(cells).zip(before.chunks_exact(cells)) {
                field[own.clone()].copy_from_slice(&from[own.clone()]);
            }
            let (new, filtered) = after.split_at_mut(self.variables * cells);
            let fields = new.chunks_exact_mut(cells).zip(filtered.chunks_exact_mut(cells));
            for ((new, filtered), slope) in fields.zip(self.x.slopes[0].row(row).chunks_exact(places)) {
                let levels = &mut [&mut new[own.clone()], &mut filtered[own.clone()]];
                leap(self.arch, leapfrog, levels, 0, strip.width, &slope[inner.clone()]);
            }
        }
    }

    /// What a stage works with.
    fn span(&self, stage: usize) -> Span {
        let own = self.strip.without(stage * self.stage_reach as usize);
        Span { own, places: self.strip.places(), variables: self.variables }
    }
}

/// The places of a row that a stage works with.
struct Span {
    own: Range<usize>,
    /// Places of the whole row.
    places: usize,
    variables: usize,
}

impl Span {
    /// Values of the state.
    fn len(&self) -> usize {
        self.own.len() * self.variables
    }

    /// Where they are in a row of increments.
    fn increments(&self) -> Range<usize> {
        let place = self.variables * LANES;
        self.own.start * place..self.own.end * place
    }

    /// The state's.
    fn of_state<'a>(&self, states: &'a Ring, row: isize) -> Row<'a> {
        Row::of(&states.row(row)[..self.places * self.variables], self.places).part(self.own.clone())
    }

    /// Puts them where they are in a row of the state's slopes.
    fn keep(&self, slopes: &[f64], row: &mut [f64]) {
        let variables = row.chunks_exact_mut(self.places).take(self.variables);
        for (row, slopes) in variables.zip(slopes.chunks_exact(self.own.len())) {
            row[self.own.clone()].copy_from_slice(slopes);
        }
    }
}
