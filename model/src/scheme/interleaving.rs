//! Eight columns interleaved, in the memory in which they lie.

use crate::columns::LANES;
use pulp::{Arch, Simd, WithSimd};

/// Takes the values of eight columns from `[lane, level, variable, y, x]` to `[level, variable, y, x, lane]` and back.
///
/// Whole rows in x are exchanged first, along the cycles of their permutation, and the eight lanes of each row are then
/// transposed by a copy of them.
pub(crate) struct Interleaving {
    arch: Arch,
    /// Rows of a column, of all levels and variables.
    rows: usize,
    nx: usize,
    /// A row of all lanes.
    row: Vec<f64>,
    /// Which rows are where they belong.
    moved: Vec<bool>,
}

impl Interleaving {
    /// For columns of `rows` rows of `nx` places, those of all levels and variables.
    pub fn new(rows: usize, nx: usize) -> Self {
        Self { arch: Arch::new(), rows, nx, row: vec![0.0; LANES * nx], moved: vec![false; LANES * rows] }
    }

    /// To `[row, x, lane]`.
    pub fn interleave(&mut self, columns: &mut [f64]) {
        let rows = self.rows;
        // To [row, lane, x].
        self.exchange(columns, |to| to % LANES * rows + to / LANES);
        for out in columns.chunks_exact_mut(self.row.len()) {
            self.row.copy_from_slice(out);
            self.arch.dispatch(Interleave { row: &self.row, out });
        }
    }

    /// To `[lane, row, x]`.
    pub fn separate(&mut self, columns: &mut [f64]) {
        let rows = self.rows;
        for out in columns.chunks_exact_mut(self.row.len()) {
            self.row.copy_from_slice(out);
            self.arch.dispatch(Separate { row: &self.row, out });
        }
        // From [row, lane, x].
        self.exchange(columns, |to| to % rows * LANES + to / rows);
    }

    /// Puts the rows in the order that says, for each place, where its row is.
    fn exchange(&mut self, columns: &mut [f64], source: impl Fn(usize) -> usize) {
        let nx = self.nx;
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
    row: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for Interleave<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let n = self.row.len() / LANES;
        let [a, b, c, d, e, f, g, h] = std::array::from_fn(|lane| &self.row[lane * n..][..n]);
        let out = &mut self.out.as_chunks_mut::<LANES>().0[..n];
        for i in 0..n {
            out[i] = [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]];
        }
    }
}

struct Separate<'a> {
    row: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for Separate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let n = self.row.len() / LANES;
        let row = &self.row.as_chunks::<LANES>().0[..n];
        for (lane, out) in self.out.chunks_exact_mut(n).enumerate() {
            for i in 0..n {
                out[i] = row[i][lane];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_interleaved_and_separated_where_they_lie() {
        for [rows, nx] in [[1, 4], [15, 7], [24, 5], [12, 100]] {
            let apart: Vec<f64> = (0..LANES * rows * nx).map(|i| i as f64).collect();
            let mut values = apart.clone();
            let mut interleaving = Interleaving::new(rows, nx);
            interleaving.interleave(&mut values);
            for (number, &value) in values.iter().enumerate() {
                let (lane, x, row) = (number % LANES, number / LANES % nx, number / (LANES * nx));
                assert_eq!(value, ((lane * rows + row) * nx + x) as f64);
            }
            interleaving.separate(&mut values);
            assert_eq!(values, apart);
        }
    }
}
