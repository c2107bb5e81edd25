//! Tall matrices: factors, each column of which is an increment.
//!
//! Millions of rows and some tens of columns: every operation goes through the rows in chunks of a fixed number, over
//! threads, and sums are taken in the order of a fixed tree, so that the bits are the same on any number of threads.
//! Nothing here allocates a second matrix of that size.

use crate::linalg::mirror_lower;
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;

/// Rows that one thread works on at a time: with a hundred columns they fit into the cache.
const ROWS: usize = 512;

/// Rows whose sums one thread takes without interruption.
const SUM_ROWS: usize = 16 * ROWS;

/// A column-major matrix `[rows, columns]` without padding, so that its columns are increments one after another.
#[derive(Clone, Debug)]
pub(crate) struct TallMatrix {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl TallMatrix {
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, columns, values: vec![0.0; rows * columns] }
    }

    /// A matrix of the given values, one column after another.
    pub fn from_values(rows: usize, columns: usize, values: Vec<f64>) -> Self {
        assert_eq!(values.len(), rows * columns);
        Self { rows, columns, values }
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    pub fn as_ref(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice(&self.values, self.rows, self.columns)
    }

    fn as_mut(&mut self) -> MatMut<'_, f64> {
        MatMut::from_column_major_slice_mut(&mut self.values, self.rows, self.columns)
    }

    pub fn column(&self, column: usize) -> &[f64] {
        &self.values[column * self.rows..][..self.rows]
    }

    pub fn column_mut(&mut self, column: usize) -> &mut [f64] {
        &mut self.values[column * self.rows..][..self.rows]
    }

    /// All columns, one after another.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// The columns in parallel; none if they have no rows.
    pub fn par_columns_mut(&mut self) -> impl IndexedParallelIterator<Item = &mut [f64]> {
        self.values.par_chunks_exact_mut(self.rows.max(1))
    }

    /// Makes room for so many columns in all, no more.
    pub fn reserve(&mut self, columns: usize) {
        self.values.reserve_exact((self.rows * columns).saturating_sub(self.values.len()));
    }

    /// Appends columns of zeros, and returns them.
    pub fn append(&mut self, columns: usize) -> &mut [f64] {
        let before = self.values.len();
        self.reserve(self.columns + columns);
        self.columns += columns;
        self.values.resize(self.rows * self.columns, 0.0);
        &mut self.values[before..]
    }

    /// Puts columns of zeros before the others, in place.
    pub fn prepend(&mut self, columns: usize) {
        self.append(columns);
        self.values.rotate_right(self.rows * columns);
    }

    /// Takes the first columns out.
    pub fn take_front(&mut self, columns: usize) -> TallMatrix {
        let cut = self.rows * columns;
        let front = self.values[..cut].to_vec();
        self.values.copy_within(cut.., 0);
        self.truncate(self.columns - columns);
        Self::from_values(self.rows, columns, front)
    }

    /// Keeps the first columns only; their memory stays reserved.
    pub fn truncate(&mut self, columns: usize) {
        self.columns = self.columns.min(columns);
        self.values.truncate(self.rows * self.columns);
    }

    /// Returns what is reserved beyond the columns.
    pub fn shrink_to_fit(&mut self) {
        self.values.shrink_to_fit();
    }

    /// A ← \[A B\] T, where B may have no columns.
    pub fn recombine(&mut self, b: MatRef<'_, f64>, t: MatRef<'_, f64>) {
        let (own, new) = (self.columns, t.ncols());
        assert!(t.nrows() == own + b.ncols() && (b.ncols() == 0 || b.nrows() == self.rows));
        self.append(new.saturating_sub(own));
        let width = own + b.ncols();
        self.as_mut().par_row_chunks_mut(ROWS).enumerate().for_each_init(
            || (vec![0.0; ROWS * width], vec![0.0; ROWS * new]),
            |(before, after), (chunk, mut rows)| {
                let count = rows.nrows();
                let before = gather(&[rows.as_ref().get(.., ..own), sub_rows(b, chunk * ROWS, count)], before);
                let mut after = MatMut::from_column_major_slice_mut(&mut after[..count * new], count, new);
                matmul(after.as_mut(), Accum::Replace, before, t, 1.0, Par::Seq);
                rows.as_mut().get_mut(.., ..new).copy_from(after);
            },
        );
        self.truncate(new);
    }

    /// y += A x.
    pub fn multiply_add(&self, x: &[f64], y: &mut [f64]) {
        assert_eq!((x.len(), y.len()), (self.columns, self.rows));
        y.par_chunks_mut(ROWS).enumerate().for_each(|(chunk, y)| {
            for (j, &x) in x.iter().enumerate() {
                let column = &self.column(j)[chunk * ROWS..][..y.len()];
                y.iter_mut().zip(column).for_each(|(y, a)| *y += a * x);
            }
        });
    }

    /// yᵢ += Σ_j aᵢⱼ².
    pub fn add_squared_rows(&self, y: &mut [f64]) {
        assert_eq!(y.len(), self.rows);
        y.par_chunks_mut(ROWS).enumerate().for_each(|(chunk, y)| {
            for j in 0..self.columns {
                let column = &self.column(j)[chunk * ROWS..][..y.len()];
                y.iter_mut().zip(column).for_each(|(y, a)| *y += a * a);
            }
        });
    }
}

/// Wᵀ diag(1/scales²) W with W the parts side by side, `[columns, columns]`.
pub(crate) fn scaled_gram(parts: &[MatRef<'_, f64>], scales: &[f64]) -> Mat<f64> {
    let width: usize = parts.iter().map(|part| part.ncols()).sum();
    let mut gram = sum_over_rows(0, scales.len(), &|first, count| {
        let mut sum = Mat::zeros(width, width);
        let mut scratch = vec![0.0; ROWS * width];
        for start in (first..first + count).step_by(ROWS) {
            let rows = ROWS.min(first + count - start);
            let chunk: Vec<_> = parts.iter().map(|part| sub_rows(*part, start, rows)).collect();
            gather(&chunk, &mut scratch);
            for column in scratch[..rows * width].chunks_exact_mut(rows) {
                column.iter_mut().zip(&scales[start..]).for_each(|(value, scale)| *value /= scale);
            }
            let scaled = MatRef::from_column_major_slice(&scratch[..rows * width], rows, width);
            triangular::matmul(
                sum.as_mut(),
                BlockStructure::TriangularLower,
                Accum::Add,
                scaled.transpose(),
                BlockStructure::Rectangular,
                scaled,
                BlockStructure::Rectangular,
                1.0,
                Par::Seq,
            );
        }
        sum
    });
    mirror_lower(gram.as_mut());
    gram
}

/// Aᵀ B of two tall matrices.
pub(crate) fn cross_product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    assert_eq!(a.nrows(), b.nrows());
    sum_over_rows(0, a.nrows(), &|first, count| {
        let mut sum = Mat::zeros(a.ncols(), b.ncols());
        for start in (first..first + count).step_by(ROWS) {
            let rows = ROWS.min(first + count - start);
            let (a, b) = (sub_rows(a, start, rows), sub_rows(b, start, rows));
            matmul(sum.as_mut(), Accum::Add, a.transpose(), b, 1.0, Par::Seq);
        }
        sum
    })
}

/// The sum over row ranges (first, count) in the order of a tree that depends on the number of rows alone.
fn sum_over_rows(first: usize, count: usize, sum: &(impl Fn(usize, usize) -> Mat<f64> + Sync)) -> Mat<f64> {
    if count <= SUM_ROWS {
        return sum(first, count);
    }
    let half = count.div_ceil(SUM_ROWS) / 2 * SUM_ROWS;
    let (mut left, right) =
        rayon::join(|| sum_over_rows(first, half, sum), || sum_over_rows(first + half, count - half, sum));
    left += right;
    left
}

/// Some rows of a matrix that may have no columns, and then any number of rows.
fn sub_rows(matrix: MatRef<'_, f64>, first: usize, count: usize) -> MatRef<'_, f64> {
    match matrix.ncols() {
        0 => MatRef::from_column_major_slice(&[], count, 0),
        _ => matrix.get(first..first + count, ..),
    }
}

/// The parts side by side, contiguous in the scratch.
fn gather<'a>(parts: &[MatRef<'_, f64>], scratch: &'a mut [f64]) -> MatRef<'a, f64> {
    let (rows, width) = (parts[0].nrows(), parts.iter().map(|part| part.ncols()).sum());
    let scratch = &mut scratch[..rows * width];
    let columns = parts.iter().flat_map(|part| part.col_iter());
    for (target, source) in scratch.chunks_exact_mut(rows.max(1)).zip(columns) {
        target.copy_from_slice(source.try_as_col_major().expect("columns are contiguous").as_slice());
    }
    MatRef::from_column_major_slice(scratch, rows, width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    fn random(rows: usize, columns: usize, seed: u64) -> TallMatrix {
        TallMatrix::from_values(rows, columns, standard_normals(&mut stream(seed, "tall"), rows * columns))
    }

    fn difference(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
        (a.to_owned() - b).norm_max() / b.norm_max()
    }

    #[test]
    fn products_and_sums_are_those_of_dense_algebra_whatever_the_chunks() {
        for rows in [3, ROWS, ROWS + 1, 3 * SUM_ROWS + 7] {
            let (a, b) = (random(rows, 5, 1), random(rows, 3, 2));
            let scales: Vec<f64> = (0..rows).map(|i| 1.0 + (i % 7) as f64).collect();
            let wide = Mat::from_fn(rows, 8, |i, j| if j < 5 { a.as_ref()[(i, j)] } else { b.as_ref()[(i, j - 5)] });
            let scaled = Mat::from_fn(rows, 8, |i, j| wide[(i, j)] / scales[i]);
            let expected = scaled.transpose() * &scaled;
            assert!(difference(scaled_gram(&[a.as_ref(), b.as_ref()], &scales).as_ref(), expected.as_ref()) < 1e-12);
            let expected = a.as_ref().transpose() * b.as_ref();
            assert!(difference(cross_product(a.as_ref(), b.as_ref()).as_ref(), expected.as_ref()) < 1e-12);
            let x = [0.3, -1.0, 2.0, 0.0, 0.7];
            let (mut sum, mut squares) = (vec![1.0; rows], vec![2.0; rows]);
            a.multiply_add(&x, &mut sum);
            a.add_squared_rows(&mut squares);
            for i in 0..rows {
                let row: Vec<f64> = (0..5).map(|j| a.as_ref()[(i, j)]).collect();
                let expected = 1.0 + row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
                assert!((sum[i] - expected).abs() < 1e-12);
                assert!((squares[i] - 2.0 - row.iter().map(|a| a * a).sum::<f64>()).abs() < 1e-12);
            }
            // To fewer columns, and to more.
            for new in [2, 5, 11] {
                let t = random(8, new, 3);
                let mut combined = a.clone();
                combined.recombine(b.as_ref(), t.as_ref());
                assert_eq!((combined.rows(), combined.columns()), (rows, new));
                assert!(difference(combined.as_ref(), (&wide * t.as_ref()).as_ref()) < 1e-12);
            }
        }
    }

    #[test]
    fn a_matrix_without_rows_has_columns_all_the_same() {
        let mut empty = TallMatrix::zeros(0, 4);
        empty.recombine(MatRef::from_column_major_slice(&[], 0, 2), random(6, 9, 1).as_ref());
        assert_eq!((empty.rows(), empty.columns(), empty.append(3).len()), (0, 9, 0));
        assert_eq!(scaled_gram(&[empty.as_ref()], &[]), Mat::<f64>::zeros(12, 12));
    }
}
