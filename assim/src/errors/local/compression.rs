//! Compression of each tile's factors, which preserves every block's own covariance.

use super::local_factors::{LocalFactors, add_to_blocks};
use super::{Frame, LocalErrors};
use crate::linalg::{add_symmetric_product, eigen, product};
use faer::Mat;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use rayon::prelude::*;
use std::sync::Arc;

impl LocalErrors {
    /// Keeps the leading directions of each tile, in the norm of the scales, on its support. The block diagonal of the
    /// others, and of what is outside of the support, joins the C_k.
    pub(super) fn compress(&mut self) {
        let frame = Arc::clone(&self.frame);
        let Frame { blocks, supports, settings, scales, .. } = &*frame;
        let keep = settings.per_tile - settings.mixed;
        let compressed: Vec<(LocalFactors, LocalFactors)> = std::mem::take(&mut self.memory.factors)
            .into_par_iter()
            .map(|factors| leading(factors, keep, scales))
            .collect();
        let mut dropped = Vec::with_capacity(2 * compressed.len());
        for ((mut kept, rest), support) in compressed.into_iter().zip(supports) {
            if settings.mixed > 0 && rest.columns() > settings.mixed {
                let signs = random_signs(rest.columns(), settings.mixed, &mut self.memory.random);
                let mixed = product(rest.values.as_ref(), signs.as_ref());
                let joint = |i: usize, j: usize| if j < keep { kept.values[(i, j)] } else { mixed[(i, j - keep)] };
                kept.values = Mat::from_fn(mixed.nrows(), keep + settings.mixed, joint).into();
            } else {
                dropped.push(rest);
            }
            let (inside, outside) = kept.split(support);
            self.memory.factors.push(inside);
            dropped.push(outside);
        }
        add_to_blocks(&mut self.memory.own, blocks, 1.0, &dropped);
    }
}

/// The leading directions, by their energy with each variable divided by its scale, and the others.
fn leading(factors: LocalFactors, keep: usize, scales: &[f64]) -> (LocalFactors, LocalFactors) {
    let LocalFactors { variables, values } = factors;
    let r = values.ncols();
    if r <= keep {
        let rest = LocalFactors::new(variables.clone(), Mat::zeros(variables.len(), 0));
        return (LocalFactors { variables, values }, rest);
    }
    let scaled = Mat::from_fn(values.nrows(), r, |i, j| values[(i, j)] / scales[variables[i]]);
    let mut gram = Mat::zeros(r, r);
    add_symmetric_product(gram.as_mut(), 1.0, scaled.transpose(), scaled.as_ref());
    let (_, directions) = eigen(gram.as_ref());
    // In descending order.
    let ordered = Mat::from_fn(r, r, |i, j| directions[(i, r - 1 - j)]);
    let rotated = product(values.as_ref(), ordered.as_ref());
    let part =
        |columns: std::ops::Range<usize>| LocalFactors::new(variables.clone(), rotated.get(.., columns).to_owned());
    (part(0..keep), part(keep..r))
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
