//! A Runge–Kutta step as one sweep: the stages follow each other at a distance of one row (see [`crate::rows`]).

use crate::rows::{Band, Ring, RowStream, combine, wrap};
use pulp::Arch;

/// An explicit Runge–Kutta scheme times Δt: rows of a (below the diagonal), and b.
#[derive(Clone, Copy)]
pub(crate) struct Weights<'a> {
    pub a: &'a [&'a [f64]],
    pub b: &'a [f64],
    pub dt: f64,
}

/// The sweep over one band.
pub(crate) struct Wavefront<'a> {
    arch: Arch,
    weights: Weights<'a>,
    streams: Vec<Box<dyn RowStream + 'a>>,
    /// States at each stage: those at the first are x itself.
    states: Vec<Ring>,
    /// Slopes of each stage.
    slopes: Vec<Ring>,
    /// How many rows each stream was told.
    told: Vec<usize>,
    ghost: Vec<f64>,
    length: usize,
}

impl<'a> Wavefront<'a> {
    /// For rows of `variables` times `length` values, with a stream for each stage.
    pub fn new(weights: Weights<'a>, streams: Vec<Box<dyn RowStream + 'a>>, variables: usize, length: usize) -> Self {
        let (stages, row_len) = (streams.len(), variables * length);
        let states = (0..stages).map(|stage| Ring::new(row_len, if stage == 0 { stages + 1 } else { 2 })).collect();
        let slopes = (0..stages).map(|stage| Ring::new(row_len, stages - stage + 1)).collect();
        let ghost = vec![0.0; row_len];
        Self { arch: Arch::new(), weights, streams, states, slopes, told: vec![0; stages], ghost, length }
    }

    /// Advances the band by one step, in place.
    pub fn sweep(&mut self, band: &mut Band<'_>) {
        let stages = self.streams.len();
        let rows = band.reached(stages);
        let (_, north_wall) = band.walls();
        for row in rows.clone() {
            band.load(row, self.states[0].row_mut(row));
            self.cascade(0, row, band);
        }
        if north_wall {
            let last = rows.end - 1;
            for stage in 0..stages {
                let (states, stream) = (&self.states[stage], &mut self.streams[stage]);
                stream.beyond_wall(states.row(last), &mut self.ghost);
                stream.push(rows.end as usize, states.row(last), &self.ghost, self.slopes[stage].row_mut(last));
                self.continue_with(stage, last, band);
            }
        }
    }

    /// Tells a stage's stream the state of a row, and takes whatever that makes known to the later stages.
    fn cascade(&mut self, stage: usize, row: isize, band: &mut Band<'_>) {
        let (states, slopes) = (&self.states[stage], &mut self.slopes[stage]);
        let stream = &mut self.streams[stage];
        self.told[stage] += 1;
        if self.told[stage] == 1 {
            if !band.walls().0 {
                return stream.begin(states.row(row));
            }
            stream.beyond_wall(states.row(row), &mut self.ghost);
            stream.begin(&self.ghost);
            stream.push(band.grid_row(row), &self.ghost, states.row(row), slopes.row_mut(row - 1));
            self.told[stage] = 2;
            return;
        }
        stream.push(band.grid_row(row), states.row(row - 1), states.row(row), slopes.row_mut(row - 1));
        if self.told[stage] > 2 {
            self.continue_with(stage, row - 1, band);
        }
    }

    /// The slope of a row at a stage is known: on to the next stage, or to the end.
    fn continue_with(&mut self, stage: usize, row: isize, band: &mut Band<'_>) {
        let dt = self.weights.dt;
        let mut terms: [(f64, &[f64]); 8] = [(0.0, &[]); 8];
        let mut count = 0;
        let is_last = stage + 1 == self.streams.len();
        let weights = if is_last { self.weights.b } else { self.weights.a[stage + 1] };
        for (&weight, slopes) in weights.iter().zip(&self.slopes) {
            if weight != 0.0 {
                terms[count] = (dt * weight, slopes.row(row));
                count += 1;
            }
        }
        let terms = &terms[..count];
        let (first, later) = self.states.split_at_mut(1);
        let x = first[0].row(row);
        if !is_last {
            let state = later[stage].row_mut(row);
            combine(self.arch, state, x, terms);
            wrap(state, self.length);
            return self.cascade(stage + 1, row, band);
        }
        let nx = self.length - 2;
        let start = (row - band.first as isize) as usize * nx;
        for (variable, field) in band.fields.iter_mut().enumerate() {
            let part = variable * self.length + 1..variable * self.length + 1 + nx;
            let mut own: [(f64, &[f64]); 8] = [(0.0, &[]); 8];
            for (own, (weight, slope)) in own.iter_mut().zip(terms) {
                *own = (*weight, &slope[part.clone()]);
            }
            combine(self.arch, &mut field[start..start + nx], &x[part], &own[..count]);
        }
    }
}
