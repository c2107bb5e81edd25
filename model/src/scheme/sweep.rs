//! A step as one sweep: the stages of a Runge–Kutta scheme follow each other at a distance of one row or two (see
//! [`super::rows`]); leapfrog has one stage.

use super::bands::{Band, bands};
use super::ends::ends;
use super::rows::{Ring, Row, RowStream};
use super::tendency::Tendency;
use super::update::{Scheme, add_slopes, combine, leap};
use pulp::Arch;
use rayon::prelude::*;

/// f(x) by a sweep over the rows, for a tendency that has no other form.
///
/// # Panics
/// If it has none by rows either.
pub(crate) fn tendency_by_rows<T: Tendency>(tendency: &T, x: &[f64], out: &mut [f64]) {
    out.copy_from_slice(x);
    assert!(sweep(tendency, Scheme::Slope, out, 1, 1), "the tendency has no row form");
}

/// Steps of x, of `lanes` states interleaved, row by row; returns false, with nothing done, if the tendency has no row form.
pub(crate) fn sweep<T: Tendency>(tendency: &T, scheme: Scheme<'_>, x: &mut [f64], lanes: usize, steps: usize) -> bool {
    let (grid, variables, stages) = (&tendency.layout().grid, tendency.layout().variables.len(), scheme.stages());
    let wavefront = || {
        let streams: Option<Vec<_>> = (0..stages).map(|_| tendency.row_stream(grid.nx, lanes)).collect();
        Some(Wavefront::new(scheme, streams?, variables, grid.nx * lanes))
    };
    let Some(first) = wavefront() else { return false };
    let reach = stages * first.reach;
    let mut wavefronts = vec![first];
    for _ in 0..steps {
        let mut bands = bands((grid, ends(tendency)), x, variables, lanes, reach);
        let missing = bands.len() - wavefronts.len();
        wavefronts.extend((0..missing).filter_map(|_| wavefront()));
        match (&mut bands[..], &mut wavefronts[..]) {
            ([band], [wavefront]) => wavefront.sweep(band),
            (bands, wavefronts) => {
                bands.par_iter_mut().zip(wavefronts).for_each(|(band, wavefront)| wavefront.sweep(band));
            }
        }
    }
    true
}

/// The sweep over one band.
struct Wavefront<'a> {
    arch: Arch,
    scheme: Scheme<'a>,
    streams: Vec<Box<dyn RowStream + 'a>>,
    /// States at the later stages; those at the first are x itself.
    states: Vec<Ring>,
    /// Slopes of each stage.
    slopes: Vec<Ring>,
    /// Rows pushed to each stage so far.
    pushed: Vec<usize>,
    ghost: Vec<f64>,
    /// Values of a variable's row.
    row_len: usize,
    /// Rows by which each stage is behind the one before.
    reach: usize,
}

impl<'a> Wavefront<'a> {
    /// For rows of `variables` times `row_len` values, with a stream for each stage.
    fn new(scheme: Scheme<'a>, streams: Vec<Box<dyn RowStream + 'a>>, variables: usize, row_len: usize) -> Self {
        let (stages, all, reach) = (streams.len(), variables * row_len, streams[0].reach());
        let states = (1..stages).map(|_| Ring::new(all, 2)).collect();
        let slopes = (1..=stages).map(|stage| Ring::new(all, reach * (stages - stage) + 1)).collect();
        let ghost = vec![0.0; all];
        Self { arch: Arch::new(), scheme, streams, states, slopes, pushed: vec![0; stages], ghost, row_len, reach }
    }

    /// Advances the band by one step, in place.
    fn sweep(&mut self, band: &mut Band<'_>) {
        let stages = self.streams.len();
        self.pushed.fill(0);
        let rows = band.reached(stages * self.reach);
        let (_, north_wall) = band.walls();
        for row in rows.clone() {
            self.cascade(0, row, band);
        }
        if north_wall {
            let last = rows.end - 1;
            for stage in 0..stages {
                let (south, stream) = (state(&self.states, self.row_len, stage, last, band), &mut self.streams[stage]);
                stream.beyond_wall(south, &mut self.ghost);
                let ghost = Row::of(&self.ghost, self.row_len);
                let newest = rows.end - self.reach as isize;
                stream.push(rows.end as usize, south, ghost, self.slopes[stage].row_mut(newest));
                self.continue_with(stage, newest, band);
                if newest < last {
                    self.streams[stage].finish(self.slopes[stage].row_mut(last));
                    self.continue_with(stage, last, band);
                }
            }
        }
    }

    /// Pushes the state of a row to the stream of a stage, and what that makes known to the later stages.
    fn cascade(&mut self, stage: usize, row: isize, band: &mut Band<'_>) {
        let (stream, slopes) = (&mut self.streams[stage], &mut self.slopes[stage]);
        let north = state(&self.states, self.row_len, stage, row, band);
        let known = row - self.reach as isize;
        self.pushed[stage] += 1;
        if self.pushed[stage] == 1 {
            if !band.walls().0 {
                return stream.begin(row, north);
            }
            stream.beyond_wall(north, &mut self.ghost);
            let ghost = Row::of(&self.ghost, self.row_len);
            stream.begin(row - 1, ghost);
            stream.push(band.grid_row(row), ghost, north, slopes.row_mut(known));
            // The row beyond the wall stands for all rows there within reach.
            self.pushed[stage] += self.reach;
            return;
        }
        let south = state(&self.states, self.row_len, stage, row - 1, band);
        stream.push(band.grid_row(row), south, north, slopes.row_mut(known));
        if self.pushed[stage] > 2 * self.reach {
            self.continue_with(stage, known, band);
        }
    }

    /// The slope of a row at a stage is known: on to the next stage, or to the end.
    fn continue_with(&mut self, stage: usize, row: isize, band: &mut Band<'_>) {
        let (arch, row_len) = (self.arch, self.row_len);
        let (terms, count) = self.scheme.terms(stage, &self.slopes, row, 0..self.ghost.len());
        if stage + 1 < self.streams.len() {
            combine(arch, self.states[stage].row_mut(row), band.row(row), row_len, &terms[..count]);
            return self.cascade(stage + 1, row, band);
        }
        let start = (row - band.first as isize) as usize * row_len;
        match self.scheme {
            Scheme::RungeKutta { .. } => add_slopes(arch, &mut band.fields, start, row_len, &terms[..count]),
            Scheme::Leapfrog(numbers) => leap(arch, numbers, &mut band.fields, start, row_len, self.slopes[0].row(row)),
            Scheme::Slope => {
                for (field, slope) in band.fields.iter_mut().zip(self.slopes[0].row(row).chunks_exact(row_len)) {
                    field[start..start + row_len].copy_from_slice(slope);
                }
            }
        }
    }
}

/// The state of a row at a stage.
fn state<'b>(states: &'b [Ring], row_len: usize, stage: usize, row: isize, band: &'b Band<'_>) -> Row<'b> {
    if stage == 0 { band.row(row) } else { Row::of(states[stage - 1].row(row), row_len) }
}
