//! Compression of each tile's factors, which preserves every block's own covariance.

use super::local_factors::{LocalFactors, add_to_blocks, divided};
use super::{Frame, LocalErrors, LocalFactorSettings};
use crate::linalg::{add_symmetric_product, eigen, product};
use crate::spectral_cut;
use faer::Mat;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use rayon::prelude::*;
use std::sync::Arc;

impl LocalErrors {
    /// Keeps the leading directions of each tile, in the norm of the scales, on its support. The block diagonal of the
    /// others joins the C_k, as does that of the values outside the support; or the others are mixed, see [`random_signs`].
    pub(super) fn compress(&mut self) {
        let frame = Arc::clone(&self.frame);
        let LocalFactorSettings { per_tile, mixed, .. } = frame.settings;
        let factors = std::mem::take(&mut self.memory.factors);
        let signs: Vec<Option<Mat<f64>>> = factors
            .iter()
            .map(LocalFactors::columns)
            .map(|r| (mixed > 0 && r > per_tile).then(|| random_signs(r, mixed, &mut self.memory.random)))
            .collect();
        let compressed: Vec<(LocalFactors, [LocalFactors; 2])> = factors
            .into_par_iter()
            .zip(&frame.supports)
            .zip(signs)
            .map(|((factors, support), signs)| compressed(factors, support, signs, &frame))
            .collect();
        let (kept, dropped): (Vec<_>, Vec<_>) = compressed.into_iter().unzip();
        self.memory.factors = kept;
        add_to_blocks(&mut self.memory.own, &frame.blocks, 1.0, dropped.as_flattened());
    }
}

/// The factors of a tile that stay, in its support and in a basis that rounding has no part in; and what is dropped.
fn compressed(
    factors: LocalFactors,
    support: &[usize],
    signs: Option<Mat<f64>>,
    frame: &Frame,
) -> (LocalFactors, [LocalFactors; 2]) {
    let Frame { settings, scales, fixed_basis, .. } = frame;
    let LocalFactors { variables, values } = factors;
    let (r, keep) = (values.ncols(), settings.per_tile - settings.mixed);
    let turn =
        |values: &Mat<f64>, columns: usize| fixed_basis.rotation(values.as_ref(), &variables, support, scales, columns);
    let (kept, rest) = if r > settings.per_tile {
        let (leading, rest) = cut(&values, &variables, keep, scales);
        let kept = product(leading.as_ref(), turn(&leading, keep).as_ref());
        match signs {
            None => (kept, rest),
            Some(signs) => {
                let sums = product(turn(&rest, r).as_ref(), signs.as_ref());
                let mixed = product(rest.as_ref(), sums.as_ref());
                let joint = |i: usize, j: usize| if j < keep { kept[(i, j)] } else { mixed[(i, j - keep)] };
                (Mat::from_fn(kept.nrows(), settings.per_tile, joint), Mat::zeros(kept.nrows(), 0))
            }
        }
    } else {
        (product(values.as_ref(), turn(&values, r).as_ref()), Mat::zeros(values.nrows(), 0))
    };
    let rest = LocalFactors::new(variables.clone(), rest);
    let (inside, outside) = LocalFactors::new(variables, kept).split(support);
    (inside, [rest, outside])
}

/// F parted into its leading directions, by their energy with each variable divided by its scale, and what is left over, such
/// that the sum of both covariances is F Fᵀ.
///
/// With the eigenvalues λ and eigenvectors of Fᵀ S⁻² F, and the weights w of a [`spectral_cut`], by which no direction that
/// nothing but rounding tells from one that is left over is kept, `w² λ` is kept and `(1 − w²) λ` left over.
fn cut(values: &Mat<f64>, variables: &[usize], keep: usize, scales: &[f64]) -> (Mat<f64>, Mat<f64>) {
    let r = values.ncols();
    let scaled = divided(values, variables, |variable| scales[variable]);
    let mut gram = Mat::zeros(r, r);
    add_symmetric_product(gram.as_mut(), 1.0, scaled.transpose(), scaled.as_ref());
    let (energies, directions) = eigen(gram.as_ref());
    let descending: Vec<f64> = energies.into_iter().rev().collect();
    let weights = spectral_cut::weights(&descending, keep);
    let leading = Mat::from_fn(r, keep, |i, j| directions[(i, r - 1 - j)] * weights[j]);
    let left: Vec<(usize, f64)> = (0..r)
        .map(|j| (j, weights.get(j).map_or(1.0, |weight| (1.0 - weight * weight).sqrt())))
        .filter(|(_, weight)| *weight > 0.0)
        .collect();
    let rest = Mat::from_fn(r, left.len(), |i, j| directions[(i, r - 1 - left[j].0)] * left[j].1);
    (product(values.as_ref(), leading.as_ref()), product(values.as_ref(), rest.as_ref()))
}

/// ±1/√s, `[rows, s]`: R with E(R Rᵀ) = I.
fn random_signs(rows: usize, columns: usize, random: &mut ChaCha8Rng) -> Mat<f64> {
    let size = (columns as f64).sqrt().recip();
    let signs: Vec<f64> = (0..rows * columns).map(|_| if random.next_u32() & 1 == 0 { size } else { -size }).collect();
    Mat::from_fn(rows, columns, |i, j| signs[j * rows + i])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Σ R Rᵀ over draws tends to I, and its diagonal is that of I in each draw: sums are unbiased.
    #[test]
    fn sums_with_random_signs_keep_what_they_are_made_of_in_the_mean() {
        let (draws, random) = (4000, &mut isobar_model::random::stream(1, "signs"));
        let mut mean = Mat::<f64>::zeros(5, 5);
        for _ in 0..draws {
            let signs = random_signs(5, 2, random);
            let squares = &signs * signs.transpose();
            (0..5).for_each(|i| assert!((squares[(i, i)] - 1.0).abs() < 1e-15));
            mean += squares * faer::Scale(1.0 / draws as f64);
        }
        assert!((mean - Mat::<f64>::identity(5, 5)).norm_max() < 4.0 / (2.0 * draws as f64).sqrt());
    }
}
