//! Compression of each tile's factors, which preserves every block's own covariance.

use super::local_factors::{LocalFactors, add_to_blocks, divided};
use super::recombination::Recombination;
use super::{Frame, LeftOver, LocalErrors, LocalFactorSettings, Memory};
use crate::linalg::{add_symmetric_product, eigen, product};
use crate::spectral_cut;
use faer::Mat;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use rayon::prelude::*;
use std::sync::Arc;

/// The outcome of a compression of a tile's factors F.
struct Compressed {
    /// F T in the support.
    kept: LocalFactors,
    /// What is dropped: F D, unless it is mixed, and F T outside the support.
    dropped: [LocalFactors; 2],
    /// T, `[factors, factors that stay]`.
    turn: Mat<f64>,
    /// D, if F D is mixed, `[factors, left over]`.
    mixed: Option<Mat<f64>>,
}

impl LocalErrors {
    /// Keeps the leading directions of each tile, in the norm of the scales, on its support. What is left over joins the C_k or
    /// the factors, see [`LeftOver`], as do the variances that are left already; or it is mixed, see [`random_signs`].
    /// The earlier analyses are recombined in the same way, after `recombination`.
    pub(super) fn compress(&mut self, recombination: Option<Recombination>, mut left: Vec<f64>) {
        let frame = Arc::clone(&self.frame);
        let LocalFactorSettings { per_tile, mixed, .. } = frame.settings;
        let factors = std::mem::take(&mut self.memory.factors);
        let signs: Vec<Option<Mat<f64>>> = factors
            .iter()
            .map(LocalFactors::columns)
            .map(|r| (mixed > 0 && r > per_tile).then(|| random_signs(r, mixed, &mut self.memory.random)))
            .collect();
        let compressed: Vec<Compressed> = factors
            .into_par_iter()
            .zip(&frame.supports)
            .zip(signs)
            .map(|((factors, support), signs)| compressed(factors, support, signs, &frame))
            .collect();
        let (mut kept, mut dropped, mut turns, mut of_mixed) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for tile in compressed {
            kept.push(tile.kept);
            dropped.extend(tile.dropped);
            turns.push(tile.turn);
            of_mixed.extend(tile.mixed);
        }
        self.memory.factors = kept;
        self.leave_over(&dropped, &mut left);
        self.lengthen(&left);
        if let Some(before) = recombination {
            // All tiles have the same number of factors, so that either all of them are mixed or none.
            let left = (of_mixed.len() == turns.len()).then(|| before.then(&of_mixed));
            self.recombine_past(&before.then(&turns), left.as_ref().map(|left| (left, per_tile - mixed)));
        }
    }

    /// Takes in parts of factors that are cut off or left over: into the blocks, or into the variances `left` of all block
    /// variables, until the factors are lengthened.
    pub(super) fn leave_over(&mut self, parts: &[LocalFactors], left: &mut [f64]) {
        match self.frame.settings.left_over {
            LeftOver::Blocks => add_to_blocks(&mut self.memory.own, &self.frame.blocks, 1.0, parts),
            LeftOver::Factors => parts.iter().for_each(|part| part.add_squared_rows(left)),
        }
    }

    /// F_j ← S F_j, with S = diag(s) such that each variable has the variance k of the factors and that which is left over, d:
    ///
    /// ```text
    /// s² = 1 + w d / k,     w = min(1, k / d)
    /// ```
    ///
    /// and (1 − w) d joins the blocks: where almost nothing is kept of a variable, its correlations would say little. S Σ F_j F_jᵀ S
    /// is a covariance, and all variances together are k + d exactly.
    pub(super) fn lengthen(&mut self, left: &[f64]) {
        if left.iter().all(|left| *left == 0.0) {
            return;
        }
        let Memory { own, factors, .. } = &mut self.memory;
        let mut of_factors = vec![0.0; left.len()];
        factors.iter().for_each(|factors| factors.add_squared_rows(&mut of_factors));
        let mut longer = vec![1.0; left.len()];
        for (variable, (&k, &d)) in of_factors.iter().zip(left).enumerate() {
            if k > 0.0 {
                longer[variable] = (1.0 + (d / k).min(1.0)).sqrt();
            }
            if d > k {
                let (block, place) = self.frame.blocks.place(variable);
                own.block_mut(&self.frame.blocks, block)[(place, place)] += d - k;
            }
        }
        factors.par_iter_mut().for_each(|factors| factors.scale_rows(&longer));
    }
}

/// Compresses the factors of a tile; those that stay are in a basis that does not depend on rounding.
fn compressed(factors: LocalFactors, support: &[usize], signs: Option<Mat<f64>>, frame: &Frame) -> Compressed {
    let Frame { settings, scales, fixed_basis, .. } = frame;
    let precision = factors.precision();
    let (values, variables) = (factors.to_matrix(), factors.variables);
    let (r, keep) = (values.ncols(), settings.per_tile - settings.mixed);
    let turn =
        |values: &Mat<f64>, columns: usize| fixed_basis.rotation(values.as_ref(), &variables, support, scales, columns);
    let nothing = || Mat::zeros(values.nrows(), 0);
    let (kept, rest, turn, mixed) = if r > settings.per_tile {
        let (leading, left) = cut(&values, &variables, keep, scales);
        let (of_leading, rest) = (product(values.as_ref(), leading.as_ref()), product(values.as_ref(), left.as_ref()));
        let turn_leading = turn(&of_leading, keep);
        let (kept, t) =
            (product(of_leading.as_ref(), turn_leading.as_ref()), product(leading.as_ref(), turn_leading.as_ref()));
        match signs {
            None => (kept, rest, t, None),
            Some(signs) => {
                let sums = product(turn(&rest, r).as_ref(), signs.as_ref());
                let joined = |kept: &Mat<f64>, mixed: &Mat<f64>| {
                    let joint = |i: usize, j: usize| if j < keep { kept[(i, j)] } else { mixed[(i, j - keep)] };
                    Mat::from_fn(kept.nrows(), settings.per_tile, joint)
                };
                let kept = joined(&kept, &product(rest.as_ref(), sums.as_ref()));
                (kept, nothing(), joined(&t, &product(left.as_ref(), sums.as_ref())), Some(left))
            }
        }
    } else {
        let turn = turn(&values, r);
        (product(values.as_ref(), turn.as_ref()), nothing(), turn, None)
    };
    let rest = LocalFactors::new(variables.clone(), rest.as_ref(), precision);
    let (kept, outside) = LocalFactors::new(variables, kept.as_ref(), precision).split(support);
    Compressed { kept, dropped: [rest, outside], turn, mixed }
}

/// L and D, which part F into its leading directions F L, by their energy with each variable divided by its scale, and what is
/// left over, F D, such that the sum of both covariances is F Fᵀ.
///
/// With the eigenvalues λ and eigenvectors of Fᵀ S⁻² F, and the weights w of a [`spectral_cut`], which keeps no direction that
/// only rounding distinguishes from one that is left over, `w² λ` is kept and `(1 − w²) λ` left over.
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
    (leading, rest)
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
