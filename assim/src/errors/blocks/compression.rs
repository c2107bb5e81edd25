//! Compression of the common factors, which preserves every block's own covariance.

use super::factored_covariance::FactoredCovariance;
use super::factors::Further;
use super::grid_blocks::Blocks;
use super::reflections::Reflections;
use crate::leading_eigenvectors::leading_eigenvectors;
use crate::memory::Matrix;
use crate::spectral_cut;
use faer::Mat;
use isobar_model::vector::scale;

/// What joins the factors in a forecast.
pub(super) struct Joining<'a> {
    /// The factors of the model error, if there is one.
    pub model_error: Option<Further<'a>>,
    /// Standard deviations of what the shared parameters' random walks add, `[p]`.
    pub drift: &'a [f64],
}

/// How many factors stay beside the p that carry the shared parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kept {
    /// Their largest number.
    pub at_most: usize,
    /// No more than hold this share of the factors' energy; 1 for as many as may stay.
    pub retained: f64,
}

impl Kept {
    /// The number of leading directions, given the energies of all in descending order.
    fn count(self, energies: &[f64]) -> usize {
        let wanted = self.retained * energies.iter().sum::<f64>();
        let mut held = 0.0;
        let enough = energies.iter().position(|energy| {
            held += energy;
            held >= wanted
        });
        let needed = if self.retained < 1.0 { enough.map_or(energies.len(), |last| last + 1) } else { energies.len() };
        needed.min(self.at_most)
    }
}

/// Adds factors, and returns to those that are to be kept beside the p that carry the shared parameters.
///
/// `[Φ_b F_Q 0; Φ_c 0 diag(drift)]` is rotated so that p columns carry Φ_c exactly. Of the others the leading
/// directions stay, where every variable is divided by its scale first (else the wind would be thrown away for the
/// height), damped where nothing but rounding tells them from the first that is dropped (see [`spectral_cut`]). All
/// rotations are found from the small Gram matrix of `S⁻¹ [Φ_b F_Q]`, whose F_Q part is the same in every cycle, and applied at
/// once in place.
///
/// Of the block diagonal that goes with the dropped directions Φ_b's part is moved to C_k, so that Cov(b_k) of each
/// block is what it was: `C_k += Φ_b,k Φ_b,kᵀ − Φ'_b,k Φ'_b,kᵀ`, Φ' the factors that stay. The caller has added *all* of
/// Q_k to C_k, that of F_Q included.
pub(super) fn join_and_compress(
    covariance: &mut FactoredCovariance,
    joining: &Joining<'_>,
    kept: Kept,
    scales: &[f64],
    blocks: &Blocks,
) {
    let FactoredCovariance { own, factors, .. } = covariance;
    let p = joining.drift.len();
    let (r, q) = (factors.columns(), joining.model_error.map_or(0, |it| it.factors.columns()));
    let walks = if joining.drift.iter().any(|&sigma| sigma > 0.0) { p } else { 0 };
    if q + walks == 0 && r <= p + kept.at_most && kept.retained >= 1.0 {
        return;
    }
    let shared = Mat::from_fn(r + q + walks, p, |i, j| {
        if i < r {
            factors.shared[(j, i)]
        } else if i >= r + q && i - r - q == j {
            joining.drift[j]
        } else {
            0.0
        }
    });
    let (reflections, carried) = Reflections::new(shared);
    let joint = r + q + walks;
    let of_rest = if kept.at_most < joint - p || kept.retained < 1.0 {
        // The columns of the walks are zero in b.
        let mut gram = Mat::zeros(joint, joint);
        factors.scaled_gram(joining.model_error, scales, gram.as_mut().get_mut(..r + q, ..r + q));
        reflections.conjugate(gram.as_mut());
        let gram = gram.as_ref().get(p.., p..).to_owned();
        let (energies, mut leading) = leading_eigenvectors(gram, |energies| kept.count(energies));
        let weights = spectral_cut::weights(&energies, leading.ncols());
        weights.into_iter().enumerate().for_each(|(j, weight)| scale(leading.col_as_slice_mut(j), weight));
        leading
    } else {
        Mat::identity(joint - p, joint - p)
    };
    let kept = of_rest.ncols();
    let mut recombination = Mat::zeros(joint, p + kept);
    (0..p).for_each(|i| recombination[(i, i)] = 1.0);
    recombination.as_mut().get_mut(p.., p..).copy_from(of_rest);
    reflections.apply(recombination.as_mut());
    let recombination = recombination.as_ref().get(..r + q, ..);
    own.add_factors(blocks, 1.0, factors);
    let mut all = vec![0.0; blocks.variables()];
    own.add_variances(blocks, &mut all);
    factors.recombine(joining.model_error.map(|it| it.factors), recombination);
    own.add_factors(blocks, -1.0, factors);
    own.clear_rounding(blocks, &all, rounding(r + q));
    factors.shared = Matrix(Mat::zeros(p, p + kept));
    factors.shared.as_mut().get_mut(.., ..p).copy_from(carried.transpose());
}

/// The relative rounding error of a variance to which a sum over the factors is added, and from which it is taken again.
pub(in crate::errors) fn rounding(factors: usize) -> f64 {
    8.0 * f64::EPSILON * (factors as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_directions_stay_as_hold_the_wanted_energy() {
        let energies = [4.0, 3.0, 2.0, 1.0, 0.0];
        let count = |retained, at_most| Kept { at_most, retained }.count(&energies);
        assert_eq!([count(0.39, 9), count(0.4, 9), count(0.41, 9), count(0.99, 9)], [1, 1, 2, 4]);
        assert_eq!([count(1.0, 9), count(1.0, 3), count(0.99, 2), count(0.5, 0)], [5, 3, 2, 0]);
        assert_eq!(Kept { at_most: 3, retained: 0.5 }.count(&[]), 0);
    }
}
