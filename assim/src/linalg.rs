//! The few dense operations that the methods share, on faer matrices.
//!
//! faer blocks its loops by the number of threads, so that sums would be rounded differently on each. Here every call of
//! it is sequential, and work is divided over threads by columns in chunks of a fixed width: same bits on any number.

use crate::error::Error;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor;
use faer::linalg::solvers::Qr;
use faer::linalg::{matmul::matmul, triangular_solve};
use faer::prelude::ReborrowMut;
use faer::{Accum, ColMut, ColRef, Mat, MatMut, MatRef, Par};
use isobar_model::communicator::Communicator;

/// Columns that one thread works on at a time.
const CHUNK: usize = 128;

/// Largest number of rows and columns that are transposed at once: both matrices fit into the first-level cache.
const TILE: usize = 32;

/// Makes this thread and those of the pool allocate the workspace that matrix products keep: twice the size of the
/// last-level cache for each thread. Call it before a method's memory is measured, or the method that multiplies first is
/// charged with it.
pub fn reserve_workspace() {
    // Smaller products have no need of it.
    let multiply = || drop(product(Mat::identity(64, 64).as_ref(), Mat::identity(64, 64).as_ref()));
    multiply();
    rayon::broadcast(|_| multiply());
}

/// Calls `work` with the number of the first column and the columns of each chunk of a matrix, in parallel.
pub(crate) fn for_each_chunk(matrix: MatMut<'_, f64>, first: usize, work: &(impl Fn(usize, MatMut<'_, f64>) + Sync)) {
    let columns = matrix.ncols();
    if columns <= CHUNK {
        return work(first, matrix);
    }
    let half = columns.div_ceil(CHUNK) / 2 * CHUNK;
    let (left, right) = matrix.split_at_col_mut(half);
    rayon::join(|| for_each_chunk(left, first, work), || for_each_chunk(right, first + half, work));
}

/// A B.
pub(crate) fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut c = Mat::zeros(a.nrows(), b.ncols());
    add_product(c.as_mut(), 1.0, a, b);
    c
}

/// C += α A B.
pub(crate) fn add_product(c: MatMut<'_, f64>, alpha: f64, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    for_each_chunk(c, 0, &|first, chunk| {
        let columns = b.get(.., first..first + chunk.ncols());
        matmul(chunk, Accum::Add, a, columns, alpha, Par::Seq);
    });
}

/// C += α A B where the result is known to be symmetric: little more than its lower triangle is computed, then mirrored.
pub(crate) fn add_symmetric_product(mut c: MatMut<'_, f64>, alpha: f64, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    add_lower_product(c.rb_mut(), alpha, a, b);
    mirror_lower(c);
}

/// The lower triangle of C += α A B; what is above the diagonal is lost.
pub(crate) fn add_lower_product(c: MatMut<'_, f64>, alpha: f64, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    for_each_chunk(c, 0, &|first, chunk| {
        let columns = b.get(.., first..first + chunk.ncols());
        matmul(chunk.get_mut(first.., ..), Accum::Add, a.get(first.., ..), columns, alpha, Par::Seq);
    });
}

/// Copies the lower triangle into the upper one.
pub(crate) fn mirror_lower(mut c: MatMut<'_, f64>) {
    let size = c.ncols();
    if size > TILE {
        let (left, mut above, below, right) = c.split_at_mut(size / 2, size / 2);
        copy_transposed(above.rb_mut(), below.as_ref());
        rayon::join(|| mirror_lower(left), || mirror_lower(right));
        return;
    }
    for j in 1..size {
        for i in 0..j {
            c[(i, j)] = c[(j, i)];
        }
    }
}

/// C ← Aᵀ.
pub(crate) fn copy_transposed(mut c: MatMut<'_, f64>, a: MatRef<'_, f64>) {
    let (rows, columns) = (c.nrows(), c.ncols());
    if rows.max(columns) > TILE {
        let halves = if rows > columns {
            let ((above, below), (left, right)) = (c.split_at_row_mut(rows / 2), a.split_at_col(rows / 2));
            [(above, left), (below, right)]
        } else {
            let ((left, right), (above, below)) = (c.split_at_col_mut(columns / 2), a.split_at_row(columns / 2));
            [(left, above), (right, below)]
        };
        let [(first, of_first), (second, of_second)] = halves;
        rayon::join(|| copy_transposed(first, of_first), || copy_transposed(second, of_second));
        return;
    }
    for j in 0..columns {
        (0..rows).for_each(|i| c[(i, j)] = a[(j, i)]);
    }
}

/// The Cholesky factor L of a symmetric positive definite matrix L Lᵀ, whose lower triangle is read.
pub(crate) fn cholesky(mut matrix: Mat<f64>, name: impl FnOnce() -> String) -> Result<Mat<f64>, Error> {
    let size = matrix.nrows();
    let mut memory = MemBuffer::new(factor::cholesky_in_place_scratch::<f64>(size, Par::Seq, Default::default()));
    let stack = MemStack::new(&mut memory);
    factor::cholesky_in_place(matrix.as_mut(), Default::default(), Par::Seq, stack, Default::default()).map_err(
        |factor::LltError::NonPositivePivot { index }| Error::NotPositiveDefinite {
            matrix: name(),
            pivot: index,
            size,
        },
    )?;
    for j in 1..size {
        matrix.col_as_slice_mut(j)[..j].fill(0.0);
    }
    Ok(matrix)
}

/// What may be added to the variances of a covariance before it is factored, as shares of them. Covariances such as a balanced B
/// have no full rank; in directions with less than this share of the variances nothing is to be gained.
const NUGGETS: [f64; 4] = [1e-11, 1e-9, 1e-7, 1e-5];

/// The least nugget with which `factor` finds a factor, and this.
///
/// # Errors
/// That of the least nugget, if there is no factor with any.
pub(crate) fn with_nugget(factor: impl Fn(f64) -> Result<Mat<f64>, Error>) -> Result<(f64, Mat<f64>), Error> {
    let with = |nugget: f64| factor(nugget).map(|root| (nugget, root));
    let [least, larger @ ..] = NUGGETS;
    larger.into_iter().fold(with(least), |found, nugget| found.or_else(|error| with(nugget).map_err(|_| error)))
}

/// B ← L⁻¹ B.
pub(crate) fn solve_lower(l: MatRef<'_, f64>, b: MatMut<'_, f64>) {
    for_each_chunk(b, 0, &|_, chunk| triangular_solve::solve_lower_triangular_in_place(l, chunk, Par::Seq));
}

/// L⁻¹ B.
pub(crate) fn solved_lower(l: MatRef<'_, f64>, mut b: Mat<f64>) -> Mat<f64> {
    solve_lower(l, b.as_mut());
    b
}

/// B ← L⁻ᵀ B.
pub(crate) fn solve_lower_transposed(l: MatRef<'_, f64>, b: MatMut<'_, f64>) {
    for_each_chunk(b, 0, &|_, chunk| triangular_solve::solve_upper_triangular_in_place(l.transpose(), chunk, Par::Seq));
}

/// The inverse of L Lᵀ.
pub(crate) fn inverse_from_cholesky(l: MatRef<'_, f64>) -> Mat<f64> {
    let mut inverse = Mat::identity(l.nrows(), l.nrows());
    solve_lower(l, inverse.as_mut());
    let root = inverse;
    let mut inverse = Mat::zeros(l.nrows(), l.nrows());
    add_symmetric_product(inverse.as_mut(), 1.0, root.transpose(), root.as_ref());
    inverse
}

/// The sum of the matrices that the ranks have.
pub(crate) fn summed(communicator: &dyn Communicator, own: Mat<f64>) -> Mat<f64> {
    let (rows, columns) = own.shape();
    let mut sum: Vec<f64> = (0..columns).flat_map(|j| own.col_as_slice(j)).copied().collect();
    communicator.sum(&mut sum);
    Mat::from_fn(rows, columns, |i, j| sum[j * rows + i])
}

/// The entries of a matrix row by row.
pub(crate) fn row_major(matrix: MatRef<'_, f64>) -> Vec<f64> {
    let mut values = vec![0.0; matrix.nrows() * matrix.ncols()];
    copy_transposed(MatMut::from_column_major_slice_mut(&mut values, matrix.ncols(), matrix.nrows()), matrix);
    values
}

/// The entries of a column of a column-major matrix.
pub(crate) fn entries<T>(column: ColRef<'_, T>) -> &[T] {
    column.try_as_col_major().expect("columns are contiguous").as_slice()
}

/// The entries of a column of a column-major matrix, to be changed.
pub(crate) fn entries_mut<T>(column: ColMut<'_, T>) -> &mut [T] {
    column.try_as_col_major_mut().expect("columns are contiguous").as_slice_mut()
}

/// A column vector.
pub(crate) fn column(values: &[f64]) -> Mat<f64> {
    Mat::from_fn(values.len(), 1, |i, _| values[i])
}

/// A lower triangular L with L Lᵀ = M for a small symmetric positive *semi*definite M, whose lower triangle is read;
/// directions without variance get a column of zeros.
pub(crate) fn semidefinite_root(matrix: MatRef<'_, f64>) -> Mat<f64> {
    let n = matrix.nrows();
    let mut root = Mat::zeros(n, n);
    let threshold = (0..n).map(|i| matrix[(i, i)]).fold(0.0, f64::max) * f64::EPSILON * 8.0 * n as f64;
    for j in 0..n {
        let rest =
            |i: usize, root: &Mat<f64>| matrix[(i, j)] - (0..j).map(|k| root[(i, k)] * root[(j, k)]).sum::<f64>();
        let pivot = rest(j, &root);
        if pivot > threshold {
            root[(j, j)] = pivot.sqrt();
            for i in j + 1..n {
                root[(i, j)] = rest(i, &root) / root[(j, j)];
            }
        }
    }
    root
}

/// The QR factorisation.
pub(crate) fn qr(matrix: MatRef<'_, f64>) -> Qr<f64> {
    faer::set_global_parallelism(Par::Seq);
    matrix.qr()
}

/// Eigenvalues in ascending order and eigenvectors of a symmetric matrix.
pub(crate) fn eigen(matrix: MatRef<'_, f64>) -> (Vec<f64>, Mat<f64>) {
    faer::set_global_parallelism(Par::Seq);
    let eigen = matrix.self_adjoint_eigen(faer::Side::Lower).expect("a finite symmetric matrix has eigenvectors");
    let values = (0..matrix.nrows()).map(|i| eigen.S()[i]).collect();
    (values, eigen.U().to_owned())
}

/// U, σ and V of the thin singular value decomposition A = U diag(σ) Vᵀ, for at least as many rows as columns.
pub(crate) fn singular_values(matrix: MatRef<'_, f64>) -> (Mat<f64>, Vec<f64>, Mat<f64>) {
    faer::set_global_parallelism(Par::Seq);
    let svd = matrix.thin_svd().expect("a finite matrix has singular values");
    let values = (0..matrix.ncols()).map(|i| svd.S()[i]).collect();
    (svd.U().to_owned(), values, svd.V().to_owned())
}

/// The orthogonal U Vᵀ of a square matrix U Σ Vᵀ.
pub(crate) fn polar_factor(matrix: MatRef<'_, f64>) -> Mat<f64> {
    let (u, _, v) = singular_values(matrix);
    product(u.as_ref(), v.transpose())
}

/// Σ aᵢ².
pub(crate) fn squared_norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}
