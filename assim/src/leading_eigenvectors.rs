//! The leading eigenvectors of a symmetric matrix.

use crate::linalg::for_each_chunk;
use faer::diag::{DiagMut, DiagRef};
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::evd::{self, ComputeEigenvectors, tridiag};
use faer::linalg::{householder, qr::no_pivoting::factor::recommended_block_size};
use faer::{Conj, Mat, Par};

/// All eigenvalues in descending order, and the eigenvectors of the largest of them, in the same order: `count` is given the
/// eigenvalues and returns how many. Only the lower triangle of the matrix, `[n, n]`, is read.
///
/// With the orthogonal U that makes it tridiagonal, `A = U B Uᵀ` (Golub and Van Loan 2013, Matrix Computations, section 8.3),
/// and the eigenvectors of B, only those that are asked for are multiplied by U.
pub(crate) fn leading_eigenvectors(mut matrix: Mat<f64>, count: impl FnOnce(&[f64]) -> usize) -> (Vec<f64>, Mat<f64>) {
    let n = matrix.nrows();
    if n == 0 {
        return (Vec::new(), Mat::new());
    }
    let block = recommended_block_size::<f64>(n, n);
    let mut coefficients = Mat::zeros(block, n - 1);
    let scratch = StackReq::any_of(&[
        tridiag::tridiag_in_place_scratch::<f64>(n, Par::Seq, Default::default()),
        evd::self_adjoint_evd_scratch::<f64>(n, ComputeEigenvectors::Yes, Par::Seq, Default::default()),
    ]);
    let mut memory = MemBuffer::new(scratch);
    let stack = MemStack::new(&mut memory);
    tridiag::tridiag_in_place(matrix.as_mut(), coefficients.as_mut(), Par::Seq, stack, Default::default());
    let diagonal: Vec<f64> = (0..n).map(|i| matrix[(i, i)]).collect();
    let mut beside: Vec<f64> = (1..n).map(|i| matrix[(i, i - 1)]).collect();
    beside.push(0.0);
    let (mut values, mut vectors) = (vec![0.0; n], Mat::zeros(n, n));
    evd::tridiagonal_self_adjoint_evd(
        DiagRef::from_slice(&diagonal),
        DiagRef::from_slice(&beside),
        DiagMut::from_slice_mut(&mut values),
        Some(vectors.as_mut()),
        Par::Seq,
        stack,
        Default::default(),
    )
    .expect("a finite symmetric matrix has eigenvectors");
    values.reverse();
    let count = count(&values);
    let mut leading = Mat::from_fn(n, count, |i, j| vectors[(i, n - 1 - j)]);
    let basis = matrix.as_ref().get(1.., ..n - 1);
    for_each_chunk(leading.as_mut().get_mut(1.., ..), 0, &|_, columns| {
        let scratch = householder::apply_block_householder_sequence_on_the_left_in_place_scratch::<f64>(
            n - 1,
            block,
            columns.ncols(),
        );
        let mut memory = MemBuffer::new(scratch);
        householder::apply_block_householder_sequence_on_the_left_in_place_with_conj(
            basis,
            coefficients.as_ref(),
            Conj::No,
            columns,
            Par::Seq,
            MemStack::new(&mut memory),
        );
    });
    (values, leading)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::eigen;
    use isobar_model::random::{standard_normals, stream};

    #[test]
    fn they_are_those_of_the_whole_decomposition() {
        for (n, count) in [(1, 1), (2, 1), (3, 0), (40, 7), (300, 300), (301, 130)] {
            let normals = standard_normals(&mut stream(1, "eigenvectors"), n * n);
            let half = Mat::from_fn(n, n, |i, j| normals[j * n + i]);
            let matrix = &half + half.transpose();
            let (expected, _) = eigen(matrix.as_ref());
            let mut given = Vec::new();
            let (values, vectors) = leading_eigenvectors(matrix.clone(), |values| {
                given = values.to_vec();
                count
            });
            assert_eq!((&values, vectors.nrows(), vectors.ncols()), (&given, n, count));
            assert!(values.iter().rev().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12 * n as f64), "{n}");
            let scaled = Mat::from_fn(n, count, |i, j| vectors[(i, j)] * values[j]);
            assert!((&matrix * &vectors - scaled).norm_max() < 1e-12 * n as f64, "{n}");
            let gram = vectors.transpose() * &vectors;
            assert!((gram - Mat::<f64>::identity(count, count)).norm_max() < 1e-13 * n as f64, "{n}");
        }
        assert_eq!(leading_eigenvectors(Mat::new(), <[f64]>::len).0, []);
    }
}
