//! States and slopes of the rows that a sweep over a strip works with, at all stages of a scheme.

use super::rows::{Ring, Row};
use super::strips::Strip;
use super::update::{Scheme, combine, leap};
use crate::stored::Stored;
use pulp::Arch;

/// Rows of states and slopes at all stages.
pub(super) struct Stages<N = f64> {
    pub states: Vec<Ring<N>>,
    pub slopes: Vec<Ring<N>>,
    /// The row beyond a wall.
    pub ghost: Vec<N>,
}

impl<N: Stored> Stages<N> {
    /// For rows of at most `row_len` values, where each stage is `reach` rows behind the one before.
    pub fn new(stages: usize, reach: usize, row_len: usize) -> Self {
        let states = |stage: usize| Ring::new(row_len, if stage == 0 { reach * stages + 1 } else { 2 });
        Self {
            states: (0..stages).map(states).collect(),
            slopes: (1..=stages).map(|stage| Ring::new(row_len, reach * (stages - stage) + 1)).collect(),
            ghost: vec![N::default(); row_len],
        }
    }

    /// A row's state at the next stage, of its first `len` values.
    pub fn continue_with(&mut self, arch: Arch, scheme: Scheme<'_>, stage: usize, row: isize, len: usize) {
        let (terms, count) = scheme.terms(stage, &self.slopes, row, 0..len);
        let (first, later) = self.states.split_at_mut(1);
        let x = Row::of(&first[0].row(row)[..len], len);
        combine(arch, &mut later[stage].row_mut(row)[..len], x, len, &terms[..count]);
    }
}

impl Stages {
    /// The state's row after the step, given the slopes of all stages: its own places go to `after`, all levels
    /// `[variable, y, x]`, as those of `before`.
    pub fn advance_state(
        &self,
        arch: Arch,
        scheme: Scheme<'_>,
        [nx, cells]: [usize; 2],
        strip: Strip,
        row: usize,
        before: &[f64],
        after: &mut [f64],
    ) {
        let (places, variables) = (strip.places(), before.len() / scheme.levels() / cells);
        for variable in 0..variables {
            let start = variable * cells + row * nx + strip.first;
            let own = start..start + strip.width;
            let start = variable * places + strip.reach;
            let inner = start..start + strip.width;
            if let Scheme::Leapfrog(leapfrog) = scheme {
                let (now, filtered) = after.split_at_mut(variables * cells);
                let (now, filtered) = (&mut now[own.clone()], &mut filtered[own.clone()]);
                now.copy_from_slice(&before[own.clone()]);
                filtered.copy_from_slice(&before[variables * cells..][own]);
                let slope = &self.slopes[0].row(row as isize)[inner];
                leap(arch, leapfrog, &mut [now, filtered], 0, strip.width, slope);
            } else {
                let (terms, count) = scheme.terms(self.slopes.len() - 1, &self.slopes, row as isize, inner);
                let x = Row::of(&before[own.clone()], strip.width);
                combine(arch, &mut after[own], x, strip.width, &terms[..count]);
            }
        }
    }
}

/// A strip's row in a ring of longer rows: `values` values of each of `variables` variables.
pub(super) fn of_strip<N: Stored>(ring: &Ring<N>, row: isize, variables: usize, values: usize) -> Row<'_, N> {
    Row::of(&ring.row(row)[..variables * values], values)
}

/// Copies the strip of a row of the first level of a state, `[variable, y, x]`.
pub(super) fn load_state(at: &[f64], [nx, cells]: [usize; 2], row: usize, strip: Strip, out: &mut [f64]) {
    for (out, field) in out.chunks_exact_mut(strip.places()).zip(at.chunks_exact(cells)) {
        strip.copy_row(&field[row * nx..][..nx], out);
    }
}
