//! Compression of each tile's factors, which preserves every block's own covariance.

use super::local_factors::{LocalFactors, add_to_blocks, divided};
use super::recombination::Recombination;
use super::{Frame, LeftOver, LocalErrors, LocalFactorSettings, Memory};
use crate::errors::blocks::rounding;
use crate::linalg::{add_symmetric_product, eigen, entries, product};
use crate::spectral_cut;
use faer::{Mat, MatRef};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use rayon::prelude::*;
use std::sync::Arc;

/// How many times as many directions as stay in the end each tile takes into the rotations. Twice as many, or all of them, cost
/// more and change the errors by a few thousandths.
const CARRIED: f64 = 1.5;

/// The outcome of a compression of a tile's factors F.
struct Compressed {
    /// F T.
    kept: LocalFactors,
    left: Left,
    /// T, `[factors, factors that stay]`.
    turn: Mat<f64>,
    /// D, if F D is mixed, `[factors, left over]`.
    mixed: Option<Mat<f64>>,
}

/// What is left over of a tile's factors.
enum Left {
    /// Its columns.
    Columns(LocalFactors),
    /// Its variances, of the variables of the support.
    Variances(Vec<f64>),
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
        let compressed: Vec<Compressed> =
            factors.par_iter().zip(signs).map(|(factors, signs)| compressed(factors, signs, &frame)).collect();
        let (turns, of_mixed) = self.take_compressed(compressed, &mut left);
        self.lengthen(&left);
        if let Some(before) = recombination {
            // All tiles have the same number of factors, so that either all of them are mixed or none.
            let left = (of_mixed.len() == turns.len()).then(|| before.then(&of_mixed));
            self.recombine_past(&before.then(&turns), left.as_ref().map(|left| (left, per_tile - mixed)));
        }
    }

    /// Keeps the leading directions of each tile that rotations and compression go on with. What is left over goes where that of
    /// the compression goes; if that is mixed, all directions are kept, for the mixture to be of all.
    pub(super) fn reduce(&mut self, recombination: Option<&mut Recombination>, left: &mut [f64]) {
        let frame = Arc::clone(&self.frame);
        let LocalFactorSettings { per_tile, mixed, .. } = frame.settings;
        if mixed > 0 {
            return;
        }
        let keep = (CARRIED * per_tile as f64).ceil() as usize;
        let factors = std::mem::take(&mut self.memory.factors);
        let reduced: Vec<Compressed> = factors.into_par_iter().map(|factors| reduced(factors, keep, &frame)).collect();
        let (turns, _) = self.take_compressed(reduced, left);
        if let Some(recombination) = recombination {
            *recombination = recombination.then(&turns);
        }
    }

    /// Takes in the compressed factors of all tiles; returns their T, and D where there is one.
    fn take_compressed(&mut self, all: Vec<Compressed>, left: &mut [f64]) -> (Vec<Mat<f64>>, Vec<Mat<f64>>) {
        let (mut kept, mut dropped, mut turns, mut mixed) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for tile in all {
            match tile.left {
                Left::Columns(columns) => dropped.push(columns),
                Left::Variances(variances) => {
                    let variables = tile.kept.variables.iter();
                    variables.zip(variances).for_each(|(&variable, variance)| left[variable] += variance);
                }
            }
            kept.push(tile.kept);
            turns.push(tile.turn);
            mixed.extend(tile.mixed);
        }
        self.memory.factors = kept;
        self.leave_over(&dropped, left);
        (turns, mixed)
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

/// Keeps the leading directions of a tile's factors, at most `keep`.
fn reduced(factors: LocalFactors, keep: usize, frame: &Frame) -> Compressed {
    let r = factors.columns();
    if r <= keep {
        let turn = Mat::identity(r, r);
        return Compressed { kept: factors, left: Left::Variances(Vec::new()), turn, mixed: None };
    }
    let mut scratch = Vec::new();
    let scaled = divided(factors.rows(&mut scratch), &factors.variables, |variable| frame.scales[variable]);
    let (leading, left) = cut(&scaled, keep);
    let (kept, left) = parted(&factors, &leading, Some(&left), frame.settings.left_over);
    Compressed { kept, left, turn: leading, mixed: None }
}

/// Compresses the factors of a tile, which are on its support; those that stay are in a basis that does not depend on rounding.
fn compressed(factors: &LocalFactors, signs: Option<Mat<f64>>, frame: &Frame) -> Compressed {
    let Frame { settings, scales, fixed_basis, .. } = frame;
    let mut scratch = Vec::new();
    let scaled = divided(factors.rows(&mut scratch), &factors.variables, |variable| scales[variable]);
    let (r, keep) = (factors.columns(), settings.per_tile - settings.mixed);
    let turn = |t: &Mat<f64>, columns: usize| fixed_basis.rotation(scaled.as_ref(), t.as_ref(), columns);
    if r <= settings.per_tile {
        let turn = turn(&Mat::identity(r, r), r);
        let (kept, left) = parted(factors, &turn, None, settings.left_over);
        return Compressed { kept, left, turn, mixed: None };
    }
    let (leading, left) = cut(&scaled, keep);
    let t = product(leading.as_ref(), turn(&leading, keep).as_ref());
    let Some(signs) = signs else {
        let (kept, left) = parted(factors, &t, Some(&left), settings.left_over);
        return Compressed { kept, left, turn: t, mixed: None };
    };
    let sums = product(left.as_ref(), product(turn(&left, r).as_ref(), signs.as_ref()).as_ref());
    let joint = |i: usize, j: usize| if j < keep { t[(i, j)] } else { sums[(i, j - keep)] };
    let t = Mat::from_fn(r, settings.per_tile, joint);
    let (kept, nothing) = parted(factors, &t, None, settings.left_over);
    Compressed { kept, left: nothing, turn: t, mixed: Some(left) }
}

/// F T, and what of F is left over, F D, if anything is.
fn parted(factors: &LocalFactors, t: &Mat<f64>, d: Option<&Mat<f64>>, left_over: LeftOver) -> (LocalFactors, Left) {
    let mut scratch = Vec::new();
    let (all, variables, precision) = (factors.rows(&mut scratch), &factors.variables, factors.precision());
    let kept = product(all, t.as_ref());
    let left = match (d, left_over) {
        (None, _) => Left::Variances(Vec::new()),
        (Some(d), LeftOver::Blocks) => {
            Left::Columns(LocalFactors::new(variables.clone(), product(all, d.as_ref()).as_ref(), precision))
        }
        (Some(_), LeftOver::Factors) => {
            let (before, after) = (squared_rows(all), squared_rows(kept.as_ref()));
            let least = rounding(all.ncols());
            // The squares of F D, since T and D part F; a difference that is nothing but rounding counts as none.
            let difference = |(before, after)| if before - after > least * before { before - after } else { 0.0 };
            Left::Variances(before.into_iter().zip(after).map(difference).collect())
        }
    };
    (LocalFactors::new(variables.clone(), kept.as_ref(), precision), left)
}

/// The sum of the squares of each row.
fn squared_rows(matrix: MatRef<'_, f64>) -> Vec<f64> {
    let mut sums = vec![0.0; matrix.nrows()];
    for column in matrix.col_iter() {
        sums.iter_mut().zip(entries(column)).for_each(|(sum, value)| *sum += value * value);
    }
    sums
}

/// L and D, which part F into its leading directions F L, by their energy with each variable divided by its scale, and what is
/// left over, F D, such that the sum of both covariances is F Fᵀ. `scaled` is S⁻¹ F, S the scales.
///
/// With the eigenvalues λ and eigenvectors of Fᵀ S⁻² F, and the weights w of a [`spectral_cut`], which keeps no direction that
/// only rounding distinguishes from one that is left over, `w² λ` is kept and `(1 − w²) λ` left over.
fn cut(scaled: &Mat<f64>, keep: usize) -> (Mat<f64>, Mat<f64>) {
    let r = scaled.ncols();
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
