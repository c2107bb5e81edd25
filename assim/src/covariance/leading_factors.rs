//! The leading directions of a covariance as factors.

use super::Covariance;
use crate::linalg::{cholesky, eigen, product, solve_lower};
use crate::spectral_cut;
use crate::tall_matrix::{Precision, TallMatrix, cross_product, scaled_gram};
use faer::{Mat, MatRef};
use isobar_model::random::standard_normals;
use rand_chacha::ChaCha8Rng;

/// Directions beyond the wanted ones that the range finder draws.
pub(crate) const OVERSAMPLING: usize = 10;

/// Multiplications with the covariance after the first, each of which sharpens the leading directions.
const POWER_ITERATIONS: usize = 2;

/// Columns whose images are held beside the matrix at a time.
const IMAGES: usize = 4;

/// `rank` columns F with F Fᵀ ≤ U Uᵀ, column-major `[len, rank]`, that hold most of its energy where every value is
/// first divided by its `scales`.
///
/// Randomised range finder with Nyström's approximation (Halko, Martinsson and Tropp 2011, SIAM Review 53, algorithms
/// 4.4 and 5.5): with a basis Q of the range of A = S⁻¹ U Uᵀ S⁻¹, `A ≈ (A Q)(Qᵀ A Q)⁻¹(A Q)ᵀ`, whose remainder is positive
/// semidefinite, and of this the leading eigenvectors. Columns are in the order of their energy; those that are not above
/// the first one left out are damped, to zero if they are equal to it: a pair of equal eigenvalues is kept or left out as a
/// whole, for which of its directions comes first only rounding says.
pub fn leading_factors(covariance: &dyn Covariance, scales: &[f64], rank: usize, stream: &mut ChaCha8Rng) -> Mat<f64> {
    let columns =
        leading_columns(covariance, scales, TallMatrix::zeros(covariance.len(), 0, Precision::Double), rank, stream);
    columns.part(0, columns.rows(), 0, &mut Vec::new()).to_owned()
}

/// [`leading_factors`], all in the memory of one matrix `[len, rank + 10]` in the precision of one without columns and with as many of
/// the rows on this rank; that memory stays reserved.
///
/// In single precision the basis Q is what is stored, and Qᵀ A Q is right for it to double precision; A Q is rounded.
pub(crate) fn leading_columns(
    covariance: &dyn Covariance,
    scales: &[f64],
    empty: TallMatrix,
    rank: usize,
    stream: &mut ChaCha8Rng,
) -> TallMatrix {
    let (m, precision) = (covariance.len(), empty.precision());
    let rank = rank.min(m);
    let drawn = drawn(m, rank);
    let mut basis = empty;
    basis.append(drawn);
    (0..drawn).for_each(|j| basis.set_column(j, &standard_normals(stream, m)));
    for _ in 0..=POWER_ITERATIONS {
        basis.edit_columns(|column| multiply(covariance, scales, column));
        orthonormalise(&mut basis);
    }
    let core = multiply_all(covariance, scales, &mut basis);
    // A ≈ G Gᵀ with G = (A Q) root; its eigenvectors by the small Gram matrix.
    let root = pseudo_root(core, precision);
    let gram = scaled_gram(&basis, &vec![1.0; m]);
    let gram = product(root.transpose(), product(gram.as_ref(), root.as_ref()).as_ref());
    let rotation = product(root.as_ref(), leading_directions(gram.as_ref(), rank).as_ref());
    basis.recombine(None, rotation.as_ref());
    basis.scale_rows(scales);
    basis
}

/// Takes from the stream what [`leading_columns`] takes from it.
pub(crate) fn skip_draws(len: usize, rank: usize, stream: &mut ChaCha8Rng) {
    (0..drawn(len, rank)).for_each(|_| drop(standard_normals(stream, len)));
}

fn drawn(len: usize, rank: usize) -> usize {
    (rank.min(len) + OVERSAMPLING).min(len)
}

/// x ← S⁻¹ U Uᵀ S⁻¹ x.
fn multiply(covariance: &dyn Covariance, scales: &[f64], x: &mut [f64]) {
    let scaled: Vec<f64> = x.iter().zip(scales).map(|(value, scale)| value / scale).collect();
    x.fill(0.0);
    covariance.multiply_add(&scaled, x);
    x.iter_mut().zip(scales).for_each(|(value, scale)| *value /= scale);
}

/// Q ← A Q; returns Qᵀ A Q.
///
/// A few columns at a time: of the symmetric core only the rows of columns that are not replaced yet are computed.
fn multiply_all(covariance: &dyn Covariance, scales: &[f64], basis: &mut TallMatrix) -> Mat<f64> {
    let n = basis.columns();
    let mut core = Mat::zeros(n, n);
    for first in (0..n).step_by(IMAGES) {
        let count = IMAGES.min(n - first);
        let mut images = basis.zeros_like(count, Precision::Double);
        for j in 0..count {
            images.edit_own_column(j, |image| image.copy_from_slice(&basis.own_column(first + j)));
        }
        images.edit_columns(|column| multiply(covariance, scales, column));
        let rows = cross_product(basis, first, &images);
        core.as_mut().get_mut(first.., first..first + count).copy_from(&rows);
        core.as_mut().get_mut(first..first + count, first..).copy_from(rows.transpose());
        for j in 0..count {
            basis.edit_own_column(first + j, |column| column.copy_from_slice(&images.own_column(j)));
        }
    }
    core
}

/// Passes of Cholesky's orthonormalisation at most: two for columns in general position, more if they nearly depend on
/// each other.
const PASSES: usize = 6;

/// Gives the columns the same span and makes them orthonormal, to six digits: the approximation is that of the span.
///
/// Repeated Cholesky QR, Y ← Y L⁻ᵀ with L Lᵀ = Yᵀ Y, all columns first brought to length one. If the Gram matrix is
/// singular in double precision, a shift makes it positive; each pass then improves the condition by some seven digits
/// (Fukaya, Kannan, Nakatsukasa, Yamamoto and Yanagisawa 2020, SIAM J. Sci. Comput. 42, shifted CholeskyQR3).
fn orthonormalise(basis: &mut TallMatrix) {
    let (m, n) = (basis.rows(), basis.columns());
    let ones = vec![1.0; m];
    for _ in 0..PASSES {
        let gram = scaled_gram(basis, &ones);
        let off = (0..n).flat_map(|j| (0..n).map(move |i| (i, j)));
        if off.map(|(i, j)| (gram[(i, j)] - f64::from(i == j)).abs()).fold(0.0, f64::max) < 1e-6 {
            return;
        }
        let scale: Vec<f64> =
            (0..n).map(|i| if gram[(i, i)] > 0.0 { gram[(i, i)].sqrt().recip() } else { 0.0 }).collect();
        let scaled = |shift: f64| {
            Mat::from_fn(n, n, |i, j| scale[i] * gram[(i, j)] * scale[j] + if i == j { shift } else { 0.0 })
        };
        let rounding = 16.0 * n as f64 * f64::EPSILON;
        let well_posed = |l: &Mat<f64>| (0..n).all(|i| l[(i, i)] * l[(i, i)] > rounding);
        let root = cholesky(scaled(0.0), String::new).ok().filter(well_posed);
        let Some(root) = root.or_else(|| cholesky(scaled(rounding), String::new).ok()) else { return };
        let mut inverse = Mat::identity(n, n);
        solve_lower(root.as_ref(), inverse.as_mut());
        let t = Mat::from_fn(n, n, |i, j| scale[i] * inverse[(j, i)]);
        basis.recombine(None, t.as_ref());
    }
}

/// W with W Wᵀ = M⁺ for a symmetric positive semidefinite M, whose lower triangle is read.
///
/// Directions whose eigenvalue is nothing but rounding are left out: that of M, or that of the columns which are multiplied
/// by W, if these are stored in single precision.
fn pseudo_root(matrix: Mat<f64>, precision: Precision) -> Mat<f64> {
    let (least_pivot, least_eigenvalue) = match precision {
        Precision::Double => (1e-7, 1e-13),
        Precision::Single => (3e-4, 1e-7),
    };
    let n = matrix.nrows();
    if let Ok(l) = cholesky(matrix.clone(), String::new) {
        let diagonal = (0..n).map(|i| l[(i, i)]);
        let (least, largest) = diagonal.fold((f64::INFINITY, 0.0), |(a, b): (f64, f64), x| (a.min(x), b.max(x)));
        if least > least_pivot * largest {
            let mut inverse = Mat::identity(n, n);
            solve_lower(l.as_ref(), inverse.as_mut());
            return inverse.transpose().to_owned();
        }
    }
    let (values, vectors) = eigen(matrix.as_ref());
    let threshold = least_eigenvalue * values.iter().fold(0.0, |a: f64, &b| a.max(b));
    Mat::from_fn(n, n, |i, j| if values[j] > threshold { vectors[(i, j)] / values[j].sqrt() } else { 0.0 })
}

/// The eigenvectors of the `count` largest eigenvalues of a symmetric matrix, in descending order, as columns, each with its
/// weight beside what is left out.
fn leading_directions(matrix: MatRef<'_, f64>, count: usize) -> Mat<f64> {
    let (values, vectors) = eigen(matrix);
    let descending: Vec<f64> = values.into_iter().rev().collect();
    let weights = spectral_cut::weights(&descending, count);
    Mat::from_fn(matrix.nrows(), count, |i, j| vectors[(i, matrix.nrows() - 1 - j)] * weights[j])
}
