//! The few dense operations that the methods share, on faer matrices.

use crate::error::Error;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::Qr;
use faer::linalg::{matmul::matmul, triangular_solve};
use faer::prelude::ReborrowMut;
use faer::{Accum, Mat, MatMut, MatRef, Par};

/// Threads are worth their overhead only for large matrices; the result is the same bits either way.
pub(crate) fn parallelism(size: usize) -> Par {
    if size >= 512 { Par::rayon(0) } else { Par::Seq }
}

/// A B.
pub(crate) fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut c = Mat::zeros(a.nrows(), b.ncols());
    add_product(c.as_mut(), 1.0, a, b);
    c
}

/// C += α A B.
pub(crate) fn add_product(c: MatMut<'_, f64>, alpha: f64, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    let par = parallelism(c.nrows().max(c.ncols()));
    matmul(c, Accum::Add, a, b, alpha, par);
}

/// C += α A B where the result is known to be symmetric: only its lower triangle is computed, then mirrored.
pub(crate) fn add_symmetric_product(mut c: MatMut<'_, f64>, alpha: f64, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    use BlockStructure::{Rectangular, TriangularLower};
    let par = parallelism(c.nrows());
    triangular::matmul(c.rb_mut(), TriangularLower, Accum::Add, a, Rectangular, b, Rectangular, alpha, par);
    mirror_lower(c);
}

/// Copies the lower triangle into the upper one.
pub(crate) fn mirror_lower(mut c: MatMut<'_, f64>) {
    for j in 1..c.ncols() {
        for i in 0..j {
            c[(i, j)] = c[(j, i)];
        }
    }
}

/// The Cholesky factor L of a symmetric positive definite matrix L Lᵀ, whose lower triangle is read.
pub(crate) fn cholesky(mut matrix: Mat<f64>, name: impl FnOnce() -> String) -> Result<Mat<f64>, Error> {
    let size = matrix.nrows();
    let par = parallelism(size);
    let mut memory = MemBuffer::new(factor::cholesky_in_place_scratch::<f64>(size, par, Default::default()));
    let stack = MemStack::new(&mut memory);
    factor::cholesky_in_place(matrix.as_mut(), Default::default(), par, stack, Default::default()).map_err(
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

/// B ← L⁻¹ B.
pub(crate) fn solve_lower(l: MatRef<'_, f64>, b: MatMut<'_, f64>) {
    let par = parallelism(b.nrows().max(b.ncols()));
    triangular_solve::solve_lower_triangular_in_place(l, b, par);
}

/// B ← L⁻ᵀ B.
pub(crate) fn solve_lower_transposed(l: MatRef<'_, f64>, b: MatMut<'_, f64>) {
    let par = parallelism(b.nrows().max(b.ncols()));
    triangular_solve::solve_upper_triangular_in_place(l.transpose(), b, par);
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

/// The QR factorisation, on one thread: on several, faer splits sums by their number, and the bits would depend on it.
pub(crate) fn qr(matrix: MatRef<'_, f64>) -> Qr<f64> {
    faer::set_global_parallelism(Par::Seq);
    matrix.qr()
}

/// Eigenvalues in ascending order and eigenvectors of a symmetric matrix, on one thread for the same reason.
pub(crate) fn eigen(matrix: MatRef<'_, f64>) -> (Vec<f64>, Mat<f64>) {
    faer::set_global_parallelism(Par::Seq);
    let eigen = matrix.self_adjoint_eigen(faer::Side::Lower).expect("a finite symmetric matrix has eigenvectors");
    let values = (0..matrix.nrows()).map(|i| eigen.S()[i]).collect();
    (values, eigen.U().to_owned())
}

/// Σ aᵢ².
pub(crate) fn squared_norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}
