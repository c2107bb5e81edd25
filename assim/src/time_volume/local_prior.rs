//! The tiles of a correction that are not chosen, once others are: how wrong they may be, from the data.
//!
//! With a tile held at zero that is not, its neighbours stand for it, and the covariance J_aa^-1 of those that are chosen does
//! not include that. So the others u of the same correction, none of which stands out by itself, are estimated together with
//! those that are chosen, as draws
//!
//! ```text
//! r_u ~ N(0, σ² I),     Ĉ = (J + Σ^-1)^-1 j,     Cov(Ĉ) = (J + Σ^-1)^-1,     Σ^-1 = σ^-2 on the diagonal of u, 0 elsewhere
//! ```
//!
//! in which their variance is part of the others' (the covariance of a Schmidt–Kalman filter, where u is observed enough to be
//! estimated as well). The likelihood of σ² is that of the window's innovations, once the chosen unknowns a have explained what
//! they can (restricted likelihood, Patterson and Thompson 1971, doi:10.1093/biomet/58.3.545):
//!
//! ```text
//! 2 log L(σ²) = Σ_i [ σ² a_i / (1 + σ² λ_i) − log(1 + σ² λ_i) ],     a_i = (v_i' j_u|a)²
//! J_u|a = J_uu − J_ua J_aa^-1 J_au = Σ_i λ_i v_i v_i',               j_u|a = j_u − J_ua J_aa^-1 j_a
//! ```
//!
//! with j about r_u = 0. The likeliest σ² is often 0 where little is observed, although much larger ones are nearly as likely, and
//! the claims would then be those of tiles that are exactly right. So σ² is its mean over L, with every σ from 0 to σ_a as
//! probable before (Gelman 2006, doi:10.1214/06-BA117A):
//!
//! ```text
//! E(σ²) = ∫ σ² L(σ²) dσ / ∫ L(σ²) dσ,     0 ≤ σ ≤ σ_a,     σ_a² = mean square of the chosen ones
//! ```
//!
//! None of them is taken to be more wrong than those that are chosen.

use super::TimeVolume;
use super::window::Information;
use crate::linalg::eigen;
use faer::Mat;
use isobar_model::vector::dot;
use std::ops::Range;

/// The number of values of σ over which the mean is taken.
const VALUES: u32 = 200;

/// How often priors of several corrections are found in turn, since each depends on the others.
const TURNS: usize = 3;

/// Which of C are estimated, and with which priors beside those that were given.
pub(super) struct Estimated {
    /// Those that are chosen, and the other tiles of their corrections.
    pub active: Vec<bool>,
    /// σ^-2 of those tiles; 0 of all else.
    pub precisions: Vec<f64>,
}

impl TimeVolume {
    /// The unknowns of each correction with patterns in space, and the standard deviation of its prior if one is given.
    fn local_corrections(&self) -> Vec<(Range<usize>, Option<f64>)> {
        let Some(transition) = &self.corrections else { return Vec::new() };
        let mut end = self.constant.len();
        let ranges = transition.family.candidates().iter().map(|candidate| {
            let begin = end;
            end += candidate.amplitudes();
            (begin..end, candidate)
        });
        let local = ranges.filter(|(_, candidate)| !candidate.patterns.is_empty());
        local.map(|(range, candidate)| (range, candidate.sigma_prior)).collect()
    }

    /// What is said of C, with priors of these precisions, which are about zero.
    pub(super) fn with_priors(&self, known: &Information, precisions: &[f64]) -> Information {
        let mut known = known.clone();
        for (k, &precision) in precisions.iter().enumerate().filter(|(_, precision)| **precision > 0.0) {
            known.matrix[(k, k)] += precision;
            known.vector[k] -= precision * self.memory.reference[k];
        }
        known
    }

    /// What is estimated beside the unknowns that are chosen.
    pub(super) fn estimated(&self, window: &Information, chosen: &[bool]) -> Estimated {
        let (mut active, mut precisions) = (chosen.to_vec(), vec![0.0; chosen.len()]);
        let mut groups = self.local_corrections();
        groups.retain(|(range, _)| range.clone().any(|k| chosen[k]));
        for _ in 0..if groups.len() > 1 { TURNS } else { 1 } {
            for (range, sigma_prior) in &groups {
                let others: Vec<usize> = range.clone().filter(|&k| !chosen[k]).collect();
                if sigma_prior.is_some() {
                    others.iter().for_each(|&k| active[k] = true);
                    continue;
                }
                others.iter().for_each(|&k| (active[k], precisions[k]) = (false, 0.0));
                let known = self.with_priors(window, &precisions);
                let variance = self.expected_variance(&known, &active, range, &others);
                if variance > 0.0 {
                    others.iter().for_each(|&k| (active[k], precisions[k]) = (true, 1.0 / variance));
                }
            }
        }
        Estimated { active, precisions }
    }

    /// σ² of the amplitudes `others` of a correction with some of `range` among the active unknowns.
    fn expected_variance(&self, known: &Information, active: &[bool], range: &Range<usize>, others: &[usize]) -> f64 {
        let (_, shift) = self.solve_with(known, active);
        let chosen: Vec<usize> = range.clone().filter(|&k| active[k]).collect();
        let square = |&k: &usize| (self.memory.reference[k] + shift[k]).powi(2);
        let most = chosen.iter().map(square).sum::<f64>() / chosen.len() as f64;
        let to_zero: Vec<f64> =
            active.iter().zip(&self.memory.reference).map(|(&active, own)| if active { 0.0 } else { -own }).collect();
        let mut about_zero = known.clone();
        about_zero.shift(&to_zero);
        let left = about_zero.without(active);
        let n = others.len();
        let (values, vectors) = eigen(Mat::from_fn(n, n, |i, j| left.matrix[(others[i], others[j])]).as_ref());
        let squares: Vec<f64> =
            (0..n).map(|i| (0..n).map(|j| vectors[(j, i)] * left.vector[others[j]]).sum::<f64>().powi(2)).collect();
        expected(&values, &squares, most)
    }
}

/// E(σ²) with L(σ²), for σ evenly from 0 to the root of `most`, given the eigenvalues λ and the squares a.
fn expected(values: &[f64], squares: &[f64], most: f64) -> f64 {
    let log_likelihood = |variance: f64| -> f64 {
        let of_one = |(&value, &square): (&f64, &f64)| {
            // Rounding of what nothing is known of.
            let value = value.max(0.0);
            variance * square / (1.0 + variance * value) - (variance * value).ln_1p()
        };
        0.5 * values.iter().zip(squares).map(of_one).sum::<f64>()
    };
    let variances: Vec<f64> = (0..VALUES).map(|k| most * ((f64::from(k) + 0.5) / f64::from(VALUES)).powi(2)).collect();
    let logs: Vec<f64> = variances.iter().map(|&variance| log_likelihood(variance)).collect();
    let largest = logs.iter().fold(f64::NEG_INFINITY, |largest, &log| largest.max(log));
    let weights: Vec<f64> = logs.iter().map(|log| (log - largest).exp()).collect();
    dot(&weights, &variances) / weights.iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without anything known every σ stays as probable as before: E(σ²) = σ_a²/3.
    #[test]
    fn what_nothing_is_known_of_keeps_what_was_probable_before() {
        assert!((expected(&[0.0, -1e-18], &[0.0; 2], 6.0) - 2.0).abs() < 1e-4);
        assert_eq!(expected(&[1.0], &[1.0], 0.0), 0.0);
    }

    /// With many equal eigenvalues λ the mean is where the likelihood is largest: σ² + 1/λ is the mean square of the estimates j/λ.
    #[test]
    fn with_much_known_it_is_what_the_errors_of_the_estimates_do_not_account_for() {
        let (value, n) = (4.0, 4000);
        let squares: Vec<f64> = (0..n).map(|k| 130.0 * f64::from(k % 4) / 6.0).collect();
        let of_estimates = squares.iter().map(|square| square / (value * value)).sum::<f64>() / f64::from(n);
        let found = expected(&vec![value; squares.len()], &squares, 100.0);
        assert!((found - (of_estimates - 1.0 / value)).abs() < 0.02 * found, "{found}");
        // Where the estimates are no larger than their errors little is left, and never nothing.
        let noise: Vec<f64> = squares.iter().map(|square| 0.1 * square).collect();
        let found = expected(&vec![value; noise.len()], &noise, 1.0);
        assert!(found > 0.0 && found < 1e-2, "{found}");
    }
}
