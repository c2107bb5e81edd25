//! A basis of a tile's factors that does not depend on rounding.

use crate::linalg::{polar_factor, product};
use faer::{Mat, MatRef};
use isobar_model::random::{standard_normals, stream};

/// Fixed random directions W on the support of each tile, one of which is nearest to each factor.
///
/// F O holds the same covariance for any orthogonal O, and of the eigenvectors that belong to equal eigenvalues rounding
/// chooses O. But two things depend on the columns themselves: what of a packed column leaves one support and lands in the
/// next, and random sums of columns. F R is the same for all F O, where
///
/// ```text
/// Fᵀ S⁻¹ W = U Σ Vᵀ,    R = U Vᵀ,    S the scales
/// ```
///
/// is the rotation that brings F nearest to W (the orthogonal Procrustes problem, Schönemann 1966, Psychometrika 31).
pub(super) struct FixedBasis {
    /// `[variables of the largest support, columns]`; a smaller support has the first rows.
    directions: Mat<f64>,
}

impl FixedBasis {
    /// For supports of at most `variables` values, and at most `columns` factors.
    pub fn new(variables: usize, columns: usize) -> Self {
        let normals = standard_normals(&mut stream(0, "directions of local factors"), variables * columns);
        Self { directions: Mat::from_fn(variables, columns, |i, j| normals[j * variables + i]) }
    }

    /// R of the factors F T, `[variables of the support, r]`: r orthonormal rows, `[r, columns]`, with r ≤ `columns`. `scaled` is
    /// S⁻¹ F.
    pub fn rotation(&self, scaled: MatRef<'_, f64>, t: MatRef<'_, f64>, columns: usize) -> Mat<f64> {
        let directions = self.directions.get(..scaled.nrows(), ..columns);
        // Wᵀ S⁻¹ F T = V Σ Uᵀ has as many rows as columns, or more.
        let alignment = product(product(directions.transpose(), scaled).as_ref(), t);
        polar_factor(alignment.as_ref()).transpose().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::qr;

    fn random(rows: usize, columns: usize, seed: u64) -> Mat<f64> {
        let normals = standard_normals(&mut stream(seed, "matrix"), rows * columns);
        Mat::from_fn(rows, columns, |i, j| normals[j * rows + i])
    }

    /// F O R(F O) is F R(F), also with columns of zeros among those of F, and holds the covariance of F.
    #[test]
    fn turned_factors_do_not_depend_on_the_basis() {
        let basis = FixedBasis::new(30, 7);
        for (zeros, columns) in [(0, 5), (2, 5), (0, 7)] {
            let mut factors = random(20, 5, 1);
            (0..zeros).for_each(|j| factors.col_as_slice_mut(j).fill(0.0));
            let other = product(factors.as_ref(), qr(random(5, 5, 2).as_ref()).compute_Q().as_ref());
            let turned = |factors: &Mat<f64>| {
                let rotation = basis.rotation(factors.as_ref(), Mat::identity(5, 5).as_ref(), columns);
                assert!((&rotation * rotation.transpose() - Mat::<f64>::identity(5, 5)).norm_max() < 1e-13);
                factors * rotation
            };
            let (found, expected) = (turned(&other), turned(&factors));
            assert!((&found - &expected).norm_max() < 1e-12, "{zeros} {columns}");
            let difference = &found * found.transpose() - &factors * factors.transpose();
            assert!(difference.norm_max() < 1e-12);
        }
    }
}
