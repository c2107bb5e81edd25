//! Eight columns interleaved, in the memory in which they lie.

use crate::columns::LANES;
use pulp::{Arch, Simd, WithSimd};

/// Takes the values of eight columns from `[lane, level, variable, y, x]` to `[level, y, x, variable, lane]` and back.
///
/// Whole rows in x are exchanged first, along the cycles of their permutation, and each row of all variables and lanes is
/// then transposed by a copy of it.
pub(crate) struct Interleaving {
    arch: Arch,
    /// Numbers of levels, variables, rows and places.
    shape: [usize; 4],
    /// A row of all variables and lanes.
    row: Vec<f64>,
    /// Which rows are where they belong.
    moved: Vec<bool>,
}

impl Interleaving {
    /// For columns of `levels` levels of `variables` fields of `ny` rows of `nx`.
    pub fn new(levels: usize, variables: usize, [nx, ny]: [usize; 2]) -> Self {
        let (row, moved) = (vec![0.0; LANES * variables * nx], vec![false; LANES * levels * variables * ny]);
        Self { arch: Arch::new(), shape: [levels, variables, ny, nx], row, moved }
    }

    /// To `[level, y, x, variable, lane]`.
    pub fn interleave(&mut self, columns: &mut [f64]) {
        let [levels, variables, ny, nx] = self.shape;
        // To [level, y, variable, lane, x].
        self.exchange(columns, |to| {
            let (lane, variable) = (to % LANES, to / LANES % variables);
            let (y, level) = (to / (LANES * variables) % ny, to / (LANES * variables * ny));
            ((lane * levels + level) * variables + variable) * ny + y
        });
        for columns in columns.chunks_exact_mut(self.row.len()) {
            self.row.copy_from_slice(columns);
            for (variable, lanes) in self.row.chunks_exact(LANES * nx).enumerate() {
                let sources = std::array::from_fn(|lane| &lanes[lane * nx..][..nx]);
                let out = &mut columns.as_chunks_mut::<LANES>().0[variable..];
                self.arch.dispatch(Interleave { sources, out, variables });
            }
        }
    }

    /// To `[lane, level, variable, y, x]`.
    pub fn separate(&mut self, columns: &mut [f64]) {
        let [levels, variables, ny, nx] = self.shape;
        for columns in columns.chunks_exact_mut(self.row.len()) {
            self.row.copy_from_slice(columns);
            for (number, out) in columns.chunks_exact_mut(nx).enumerate() {
                let (from, lane) = (&self.row.as_chunks::<LANES>().0[number / LANES..], number % LANES);
                self.arch.dispatch(Separate { from, variables, lane, out });
            }
        }
        // From [level, y, variable, lane, x].
        self.exchange(columns, |to| {
            let (y, variable) = (to % ny, to / ny % variables);
            let (level, lane) = (to / (ny * variables) % levels, to / (ny * variables * levels));
            ((level * ny + y) * variables + variable) * LANES + lane
        });
    }

    /// Puts the rows in the order that says, for each place, where its row is.
    fn exchange(&mut self, columns: &mut [f64], source: impl Fn(usize) -> usize) {
        let nx = self.shape[3];
        let row = |number: usize| number * nx..(number + 1) * nx;
        let first = &mut self.row[..nx];
        self.moved.fill(false);
        for start in 0..self.moved.len() {
            if self.moved[start] {
                continue;
            }
            first.copy_from_slice(&columns[row(start)]);
            let mut to = start;
            loop {
                self.moved[to] = true;
                let from = source(to);
                if from == start {
                    break columns[row(to)].copy_from_slice(first);
                }
                columns.copy_within(row(from), to * nx);
                to = from;
            }
        }
    }
}

struct Interleave<'a> {
    sources: [&'a [f64]; LANES],
    out: &'a mut [[f64; LANES]],
    variables: usize,
}

impl WithSimd for Interleave<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let n = self.sources[0].len();
        let [a, b, c, d, e, f, g, h] = self.sources.map(|source| &source[..n]);
        let out = &mut self.out[..(n - 1) * self.variables + 1];
        for i in 0..n {
            out[i * self.variables] = [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]];
        }
    }
}

struct Separate<'a> {
    from: &'a [[f64; LANES]],
    variables: usize,
    lane: usize,
    out: &'a mut [f64],
}

impl WithSimd for Separate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for (out, from) in self.out.iter_mut().zip(self.from.iter().step_by(self.variables)) {
            *out = from[self.lane];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_interleaved_and_separated_where_they_lie() {
        for [levels, variables, ny, nx] in [[1, 1, 1, 4], [1, 3, 5, 7], [2, 3, 4, 5], [2, 1, 6, 100]] {
            let len = LANES * levels * variables * ny * nx;
            let apart: Vec<f64> = (0..len).map(|i| i as f64).collect();
            let mut values = apart.clone();
            let mut interleaving = Interleaving::new(levels, variables, [nx, ny]);
            interleaving.interleave(&mut values);
            for (number, &value) in values.iter().enumerate() {
                let (lane, variable) = (number % LANES, number / LANES % variables);
                let (x, row) = (number / (LANES * variables) % nx, number / (LANES * variables * nx));
                let (y, level) = (row % ny, row / ny);
                let expected = (((lane * levels + level) * variables + variable) * ny + y) * nx + x;
                assert_eq!(value, expected as f64);
            }
            interleaving.separate(&mut values);
            assert_eq!(values, apart);
        }
    }
}
