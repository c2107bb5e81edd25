//! A group of columns interleaved, in the memory in which they lie.

use crate::stored::Stored;
use pulp::{Arch, Simd, WithSimd};

/// Takes the values of a group of columns from `[lane, level, variable, y, x]` to `[level, variable, y, x, lane]` and back.
///
/// Whole rows in x are exchanged first, along the cycles of their permutation, and the lanes of each row are then transposed
/// by a copy of them.
pub(crate) struct Interleaving<N> {
    arch: Arch,
    /// Rows of a column, of all levels and variables.
    rows: usize,
    nx: usize,
    /// A row of all lanes.
    row: Vec<N>,
    /// Which rows are where they belong.
    moved: Vec<bool>,
}

impl<N: Stored> Interleaving<N> {
    /// For columns of `rows` rows of `nx` places, those of all levels and variables.
    pub fn new(rows: usize, nx: usize) -> Self {
        let (row, moved) = (vec![N::default(); N::COLUMNS * nx], vec![false; N::COLUMNS * rows]);
        Self { arch: Arch::new(), rows, nx, row, moved }
    }

    /// To `[row, x, lane]`.
    pub fn interleave(&mut self, columns: &mut [N]) {
        let rows = self.rows;
        // To [row, lane, x].
        self.exchange(columns, |to| to % N::COLUMNS * rows + to / N::COLUMNS);
        for out in columns.chunks_exact_mut(self.row.len()) {
            self.row.copy_from_slice(out);
            self.arch.dispatch(Interleave { row: &self.row, out });
        }
    }

    /// To `[lane, row, x]`.
    pub fn separate(&mut self, columns: &mut [N]) {
        let rows = self.rows;
        for out in columns.chunks_exact_mut(self.row.len()) {
            self.row.copy_from_slice(out);
            self.arch.dispatch(Separate { row: &self.row, out });
        }
        // From [row, lane, x].
        self.exchange(columns, |to| to % rows * N::COLUMNS + to / rows);
    }

    /// Puts the rows in the order that says, for each place, where its row is.
    fn exchange(&mut self, columns: &mut [N], source: impl Fn(usize) -> usize) {
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

struct Interleave<'a, N> {
    row: &'a [N],
    out: &'a mut [N],
}

impl<N: Stored> WithSimd for Interleave<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let n = self.row.len() / N::COLUMNS;
        let out = &mut N::as_places_mut(self.out)[..n];
        let row = &self.row[..N::COLUMNS * n];
        for i in 0..n {
            let out = out[i].as_mut();
            for lane in 0..N::COLUMNS {
                out[lane] = row[lane * n + i];
            }
        }
    }
}

struct Separate<'a, N> {
    row: &'a [N],
    out: &'a mut [N],
}

impl<N: Stored> WithSimd for Separate<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let n = self.row.len() / N::COLUMNS;
        let row = &N::as_places(self.row)[..n];
        for (lane, out) in self.out.chunks_exact_mut(n).enumerate() {
            for i in 0..n {
                out[i] = row[i].as_ref()[lane];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<N: Stored>() {
        let lanes = N::COLUMNS;
        for [rows, nx] in [[1, 4], [15, 7], [24, 5], [12, 100]] {
            let apart: Vec<N> = (0..lanes * rows * nx).map(|i| N::narrow(i as f64)).collect();
            let mut values = apart.clone();
            let mut interleaving = Interleaving::new(rows, nx);
            interleaving.interleave(&mut values);
            for (number, &value) in values.iter().enumerate() {
                let (lane, x, row) = (number % lanes, number / lanes % nx, number / (lanes * nx));
                assert_eq!(value.widen(), ((lane * rows + row) * nx + x) as f64);
            }
            interleaving.separate(&mut values);
            assert_eq!(values, apart);
        }
    }

    #[test]
    fn columns_are_interleaved_and_separated_where_they_lie() {
        check::<f64>();
        check::<f32>();
    }
}
