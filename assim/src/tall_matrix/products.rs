//! What is computed with tall matrices, chunk by chunk of their rows.

use super::{TallMatrix, Values, stored};
use crate::linalg::{add_lower_product, add_product, entries, entries_mut, mirror_lower};
use faer::linalg::matmul::matmul;
use faer::prelude::ReborrowMut;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use isobar_model::Stored;
use rayon::prelude::*;

/// Rows that one thread works on at a time: with a hundred columns they fit into the cache.
const ROWS: usize = 512;

/// Columns of a product with a triangular matrix that are found together.
const BAND: usize = 64;

/// Rows whose sums one thread takes without interruption.
const SUM_ROWS: usize = 16 * ROWS;

impl TallMatrix {
    /// A ← \[A B\] T, where there may be no B.
    pub fn recombine(&mut self, b: Option<&TallMatrix>, t: MatRef<'_, f64>) {
        self.multiply(b, t, t.ncols().max(1));
    }

    /// A ← A T for a lower triangular T, whose entries above the diagonal are zero: half the operations of
    /// [`TallMatrix::recombine`].
    pub fn multiply_lower(&mut self, t: MatRef<'_, f64>) {
        self.multiply(None, t, BAND);
    }

    /// A ← \[A B\] T, `width` columns of T at a time, which are zero above the diagonal entry of the first of them.
    fn multiply(&mut self, b: Option<&TallMatrix>, t: MatRef<'_, f64>, width: usize) {
        let (rows, own, new) = (self.rows, self.columns, t.ncols());
        let further = b.map_or(0, |b| b.columns);
        assert!(t.nrows() == own + further && b.is_none_or(|b| b.rows == rows));
        self.append(new.saturating_sub(own));
        stored!(&mut self.values, values => {
            let all = MatMut::from_column_major_slice_mut(values, rows, self.columns);
            all.par_row_chunks_mut(ROWS).enumerate().for_each_init(
                || (vec![0.0; ROWS * own], Vec::new(), vec![0.0; ROWS * new]),
                |(of_a, of_b, after), (chunk, rows)| {
                    let count = rows.nrows();
                    let of_b = b.map(move |b| b.part(chunk * ROWS, count, 0, of_b));
                    multiply_rows(rows, own, of_b, (t, width), of_a, after);
                },
            );
        });
        self.truncate(new);
    }

    /// y += A x.
    pub fn multiply_add(&self, x: &[f64], y: &mut [f64]) {
        assert_eq!((x.len(), y.len()), (self.columns, self.rows()));
        self.change_own(y, |y| {
            stored!(&self.values, values => y.par_chunks_mut(ROWS).enumerate().for_each(|(chunk, y)| {
                for (j, &x) in x.iter().enumerate() {
                    let column = &values[j * self.rows + chunk * ROWS..][..y.len()];
                    y.iter_mut().zip(column).for_each(|(y, a)| *y += a.widen() * x);
                }
            }))
        });
    }

    /// yᵢ += Σ_j aᵢⱼ².
    pub fn add_squared_rows(&self, first_column: usize, y: &mut [f64]) {
        assert_eq!(y.len(), self.rows());
        self.change_own(y, |y| {
            stored!(&self.values, values => y.par_chunks_mut(ROWS).enumerate().for_each(|(chunk, y)| {
                for j in first_column..self.columns {
                    let column = &values[j * self.rows + chunk * ROWS..][..y.len()];
                    y.iter_mut().zip(column).for_each(|(y, a)| *y += a.widen() * a.widen());
                }
            }))
        });
    }

    /// Some of this rank's rows of the columns from `column` on: those stored, or their copy in the scratch.
    pub fn part<'a>(&'a self, first: usize, count: usize, column: usize, scratch: &'a mut Vec<f64>) -> MatRef<'a, f64> {
        if self.columns == column {
            return MatRef::from_column_major_slice(&[], count, 0);
        }
        match &self.values {
            Values::Double(values) => {
                let all = MatRef::from_column_major_slice(values, self.rows, self.columns);
                all.get(first..first + count, column..)
            }
            Values::Single(_) => {
                let columns = self.columns - column;
                scratch.resize(count * columns, 0.0);
                self.copy_rows(first, column, scratch);
                MatRef::from_column_major_slice(scratch, count, columns)
            }
        }
    }

    /// Copies rows of the columns from `column` on, as many as there is place for.
    fn copy_rows(&self, first: usize, column: usize, out: &mut [f64]) {
        let count = out.len() / (self.columns - column).max(1);
        stored!(&self.values, values => {
            for (out, j) in out.chunks_exact_mut(count.max(1)).zip(column..) {
                widen_all(&values[j * self.rows + first..][..count], out);
            }
        });
    }
}

/// Some rows of [`TallMatrix::multiply`], of which the first `own` columns are A; `of_a` has room for a copy of these.
fn multiply_rows<S: Stored>(
    mut rows: MatMut<'_, S>,
    own: usize,
    of_b: Option<MatRef<'_, f64>>,
    (t, width): (MatRef<'_, f64>, usize),
    of_a: &mut [f64],
    after: &mut [f64],
) {
    let (count, new) = (rows.nrows(), t.ncols());
    let of_a = &mut of_a[..count * own];
    for (column, out) in rows.as_ref().col_iter().zip(of_a.chunks_exact_mut(count)) {
        widen_all(entries(column), out);
    }
    let of_a = MatRef::from_column_major_slice(of_a, count, own);
    let after = &mut after[..count * new];
    let mut product = MatMut::from_column_major_slice_mut(&mut *after, count, new);
    for first in (0..new).step_by(width) {
        let columns = first..new.min(first + width);
        let (of_a, t) = (of_a.get(.., first..), t.get(first..own, columns.clone()));
        matmul(product.rb_mut().get_mut(.., columns), Accum::Replace, of_a, t, 1.0, Par::Seq);
    }
    if let Some(of_b) = of_b {
        matmul(product, Accum::Add, of_b, t.get(own.., ..), 1.0, Par::Seq);
    }
    for (column, values) in rows.as_mut().col_iter_mut().zip(after.chunks_exact(count)) {
        S::narrow_all(values, entries_mut(column));
    }
}

fn widen_all<S: Stored>(stored: &[S], out: &mut [f64]) {
    out.iter_mut().zip(stored).for_each(|(out, value)| *out = value.widen());
}

/// Aᵀ diag(1/scales²) A, `[columns, columns]`.
pub(crate) fn scaled_gram(a: &TallMatrix, scales: &[f64]) -> Mat<f64> {
    let mut gram = Mat::zeros(a.columns, a.columns);
    add_scaled_gram(gram.as_mut(), a, None, scales);
    mirror_lower(gram.as_mut());
    gram
}

/// Adds to `gram` the columns of \[A B\]ᵀ diag(1/scales²) \[A B\] that belong to A: the lower triangle of A's part, and all
/// of B's part. The columns that belong to B are left as they are.
pub(crate) fn add_scaled_gram(mut gram: MatMut<'_, f64>, a: &TallMatrix, b: Option<&TallMatrix>, scales: &[f64]) {
    let (own, width) = (a.columns, a.columns + b.map_or(0, |b| b.columns));
    let scales = &a.own_part(scales);
    let sum = sum_over_rows(0, scales.len(), &|first, count| {
        let mut sum = Mat::zeros(width, own);
        let mut scaled = vec![0.0; ROWS.min(count) * own];
        let (mut of_a, mut of_b) = (Vec::new(), Vec::new());
        for start in (first..first + count).step_by(ROWS) {
            let rows = ROWS.min(first + count - start);
            let scaled = &mut scaled[..rows * own];
            a.copy_rows(start, 0, scaled);
            for column in scaled.chunks_exact_mut(rows) {
                column.iter_mut().zip(&scales[start..]).for_each(|(value, scale)| *value /= scale * scale);
            }
            let scaled = MatRef::from_column_major_slice(scaled, rows, own);
            let (with_a, with_b) = sum.as_mut().split_at_row_mut(own);
            add_lower_product(with_a, 1.0, a.part(start, rows, 0, &mut of_a).transpose(), scaled);
            if let Some(b) = b {
                add_product(with_b, 1.0, b.part(start, rows, 0, &mut of_b).transpose(), scaled);
            }
        }
        sum
    });
    let mut target = gram.rb_mut().get_mut(.., ..own);
    target += a.summed(sum);
}

/// Aᵀ B of two tall matrices, A without the columns before `first_column`.
pub(crate) fn cross_product(a: &TallMatrix, first_column: usize, b: &TallMatrix) -> Mat<f64> {
    assert_eq!(a.rows, b.rows);
    let sum = sum_over_rows(0, a.rows, &|first, count| {
        let mut sum = Mat::zeros(a.columns - first_column, b.columns);
        let (mut of_a, mut of_b) = (Vec::new(), Vec::new());
        for start in (first..first + count).step_by(ROWS) {
            let rows = ROWS.min(first + count - start);
            let (a, b) = (a.part(start, rows, first_column, &mut of_a), b.part(start, rows, 0, &mut of_b));
            matmul(sum.as_mut(), Accum::Add, a.transpose(), b, 1.0, Par::Seq);
        }
        sum
    });
    a.summed(sum)
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

#[cfg(test)]
pub(super) mod tests {
    use super::super::Precision;
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    pub const PRECISIONS: [(Precision, f64); 2] = [(Precision::Double, 1e-12), (Precision::Single, 1e-6)];

    pub fn random(rows: usize, columns: usize, seed: u64, precision: Precision) -> TallMatrix {
        let normals = standard_normals(&mut stream(seed, "tall"), rows * columns);
        match precision {
            Precision::Double => TallMatrix::from_values(rows, columns, normals),
            Precision::Single => {
                TallMatrix::from_values(rows, columns, normals.into_iter().map(f32::narrow).collect::<Vec<_>>())
            }
        }
    }

    pub fn dense(matrix: &TallMatrix) -> Mat<f64> {
        Mat::from_fn(matrix.rows, matrix.columns, |i, j| matrix.value(i, j))
    }

    fn difference(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
        (a.to_owned() - b).norm_max() / b.norm_max()
    }

    /// What is only read is as good in single precision as in double; what is written is rounded.
    #[test]
    fn products_and_sums_are_those_of_dense_algebra_whatever_the_chunks() {
        let sizes = [3, ROWS, ROWS + 1, 3 * SUM_ROWS + 7];
        for ((precision, rounded), rows) in PRECISIONS.into_iter().flat_map(|it| sizes.map(|rows| (it, rows))) {
            let (a, b) = (random(rows, 5, 1, precision), random(rows, 3, 2, precision));
            let scales: Vec<f64> = (0..rows).map(|i| 1.0 + (i % 7) as f64).collect();
            let wide = Mat::from_fn(rows, 8, |i, j| if j < 5 { a.value(i, j) } else { b.value(i, j - 5) });
            let scaled = Mat::from_fn(rows, 8, |i, j| wide[(i, j)] / scales[i]);
            let expected = scaled.transpose() * &scaled;
            let mut found = Mat::zeros(8, 8);
            found.as_mut().get_mut(5.., 5..).copy_from(scaled_gram(&b, &scales));
            add_scaled_gram(found.as_mut(), &a, Some(&b), &scales);
            mirror_lower(found.as_mut());
            assert!(difference(found.as_ref(), expected.as_ref()) < 1e-12);
            let expected = dense(&a).transpose() * dense(&b);
            for first in [0, 2, 5] {
                let found = cross_product(&a, first, &b);
                assert_eq!((found.nrows(), found.ncols()), (5 - first, 3));
                assert!((found.as_ref() - expected.get(first.., ..)).norm_max() < 1e-12 * expected.norm_max());
            }
            let x = [0.3, -1.0, 2.0, 0.0, 0.7];
            let (mut sum, mut squares) = (vec![1.0; rows], vec![2.0; rows]);
            a.multiply_add(&x, &mut sum);
            a.add_squared_rows(0, &mut squares);
            for i in 0..rows {
                let row: Vec<f64> = (0..5).map(|j| a.value(i, j)).collect();
                let expected = 1.0 + row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
                assert!((sum[i] - expected).abs() < 1e-12);
                assert!((squares[i] - 2.0 - row.iter().map(|a| a * a).sum::<f64>()).abs() < 1e-12);
            }
            // To fewer columns, and to more.
            for new in [2, 5, 11] {
                let t = random(8, new, 3, Precision::Double);
                let t = dense(&t);
                let mut combined = a.clone();
                combined.recombine(Some(&b), t.as_ref());
                assert_eq!((combined.rows(), combined.columns()), (rows, new));
                assert_eq!(combined.precision(), precision);
                assert!(difference(dense(&combined).as_ref(), (&wide * &t).as_ref()) < rounded);
            }
        }
    }

    #[test]
    fn a_matrix_without_rows_has_columns_all_the_same() {
        for (precision, _) in PRECISIONS {
            let mut empty = TallMatrix::zeros(0, 4, precision);
            let t = dense(&random(6, 9, 1, Precision::Double));
            empty.recombine(Some(&TallMatrix::zeros(0, 2, precision)), t.as_ref());
            empty.append(3);
            assert_eq!((empty.rows(), empty.columns(), empty.columns_mut().len()), (0, 12, 12));
            assert_eq!(scaled_gram(&empty, &[]), Mat::<f64>::zeros(12, 12));
        }
    }

    #[test]
    fn a_lower_triangle_multiplies_as_any_matrix_does() {
        for ((precision, rounded), columns) in
            PRECISIONS.into_iter().flat_map(|it| [1, BAND, 2 * BAND + 3].map(|n| (it, n)))
        {
            let (a, t) = (random(ROWS + 7, columns, 1, precision), random(columns, columns, 4, Precision::Double));
            let t = Mat::from_fn(columns, columns, |i, j| if i >= j { t.value(i, j) } else { 0.0 });
            let mut multiplied = a.clone();
            multiplied.multiply_lower(t.as_ref());
            assert!(difference(dense(&multiplied).as_ref(), (dense(&a) * &t).as_ref()) < rounded);
        }
    }
}
