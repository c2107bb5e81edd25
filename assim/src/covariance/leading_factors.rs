//! The leading directions of a covariance as factors.

use super::Covariance;
use crate::linalg::{add_symmetric_product, cholesky, eigen, product, qr, solve_lower};
use faer::{Mat, MatRef};
use isobar_model::random::standard_normals;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Directions beyond the wanted ones that the range finder draws.
const OVERSAMPLING: usize = 10;

/// Multiplications with the covariance after the first, each of which sharpens the leading directions.
const POWER_ITERATIONS: usize = 2;

/// `rank` columns F with F Fᵀ ≤ U Uᵀ, column-major `[len, rank]`, that hold most of its energy where every value is
/// first divided by its `scales`.
///
/// Randomised range finder with Nyström's approximation (Halko, Martinsson and Tropp 2011, SIAM Review 53, algorithms
/// 4.4 and 5.5): with an orthonormal basis Q of the range of A = S⁻¹ U Uᵀ S⁻¹, `A ≈ (A Q)(Qᵀ A Q)⁻¹(A Q)ᵀ`, whose
/// remainder is positive semidefinite, and of this the leading eigenvectors. Columns are in the order of their energy.
pub fn leading_factors(covariance: &dyn Covariance, scales: &[f64], rank: usize, stream: &mut ChaCha8Rng) -> Mat<f64> {
    let m = covariance.len();
    let rank = rank.min(m);
    let drawn = (rank + OVERSAMPLING).min(m);
    let multiply = |basis: MatRef<'_, f64>| -> Mat<f64> {
        let columns: Vec<Vec<f64>> = (0..basis.ncols())
            .into_par_iter()
            .map(|j| {
                let scaled: Vec<f64> = (0..m).map(|i| basis[(i, j)] / scales[i]).collect();
                let mut image = super::multiply(covariance, &scaled);
                image.iter_mut().zip(scales).for_each(|(value, scale)| *value /= scale);
                image
            })
            .collect();
        Mat::from_fn(m, basis.ncols(), |i, j| columns[j][i])
    };
    let start = standard_normals(stream, m * drawn);
    let mut basis = qr(multiply(MatRef::from_column_major_slice(&start, m, drawn)).as_ref()).compute_thin_Q();
    for _ in 0..POWER_ITERATIONS {
        basis = qr(multiply(basis.as_ref()).as_ref()).compute_thin_Q();
    }
    let image = multiply(basis.as_ref());
    let core = product(basis.transpose(), image.as_ref());
    let root = pseudo_root(core);
    // A ≈ G Gᵀ with G = (A Q) root; its eigenvectors by the small Gram matrix.
    let nystrom = product(image.as_ref(), root.as_ref());
    let rotation = principal_rotation(nystrom.as_ref());
    let mut factors = product(nystrom.as_ref(), rotation.as_ref().get(.., ..rank));
    for j in 0..factors.ncols() {
        factors.col_as_slice_mut(j).iter_mut().zip(scales).for_each(|(value, scale)| *value *= scale);
    }
    factors
}

/// W with W Wᵀ = M⁺ for a symmetric positive semidefinite M, whose lower triangle is read.
fn pseudo_root(matrix: Mat<f64>) -> Mat<f64> {
    let n = matrix.nrows();
    if let Ok(l) = cholesky(matrix.clone(), String::new) {
        let diagonal = (0..n).map(|i| l[(i, i)]);
        let (least, largest) = diagonal.fold((f64::INFINITY, 0.0), |(a, b): (f64, f64), x| (a.min(x), b.max(x)));
        if least > 1e-7 * largest {
            let mut inverse = Mat::identity(n, n);
            solve_lower(l.as_ref(), inverse.as_mut());
            return inverse.transpose().to_owned();
        }
    }
    let (values, vectors) = eigen(matrix.as_ref());
    let threshold = 1e-13 * values.iter().fold(0.0, |a: f64, &b| a.max(b));
    Mat::from_fn(n, n, |i, j| if values[j] > threshold { vectors[(i, j)] / values[j].sqrt() } else { 0.0 })
}

/// The right singular vectors of a tall matrix, `[columns, columns]`, in descending order of its singular values, by the
/// eigenvectors of its Gram matrix.
pub(crate) fn principal_rotation(tall: MatRef<'_, f64>) -> Mat<f64> {
    let columns = tall.ncols();
    let mut gram = Mat::zeros(columns, columns);
    add_symmetric_product(gram.as_mut(), 1.0, tall.transpose(), tall);
    let (_, vectors) = eigen(gram.as_ref());
    Mat::from_fn(columns, columns, |i, j| vectors[(i, columns - 1 - j)])
}
