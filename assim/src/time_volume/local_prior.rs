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
//! estimated as well). σ² is that for which the window's innovations are most likely, once the chosen unknowns a have explained
//! what they can (restricted maximum likelihood, Patterson and Thompson 1971, doi:10.1093/biomet/58.3.545):
//!
//! ```text
//! 2 log L(σ²) = Σ_i [ σ² a_i / (1 + σ² λ_i) − log(1 + σ² λ_i) ],     a_i = (v_i' j_u|a)²
//! J_u|a = J_uu − J_ua J_aa^-1 J_au = Σ_i λ_i v_i v_i',               j_u|a = j_u − J_ua J_aa^-1 j_a
//! ```
//!
//! with j about r_u = 0. None of them is taken to be more wrong than those that are chosen: σ² is at most the mean square of these.
//! Where it is 0 they are held at zero.

use super::TimeVolume;
use super::window::Information;
use crate::linalg::eigen;
use faer::Mat;
use std::ops::Range;

/// The number of values of σ² among which the best is sought first, evenly in its logarithm.
const VALUES: i32 = 60;

/// The least of them, relative to the largest.
const LEAST: f64 = 1e-6;

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
                if let Some(variance) = self.likely_variance(&known, &active, range, &others) {
                    others.iter().for_each(|&k| (active[k], precisions[k]) = (true, 1.0 / variance));
                }
            }
        }
        Estimated { active, precisions }
    }

    /// σ² of the amplitudes `others` of a correction with some of `range` among the active unknowns; `None` for 0.
    fn likely_variance(
        &self,
        known: &Information,
        active: &[bool],
        range: &Range<usize>,
        others: &[usize],
    ) -> Option<f64> {
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
        most_likely(&values, &squares, most)
    }
}

/// The σ² from 0 to `most` with the largest likelihood, given the eigenvalues λ and the squares a; `None` for 0.
fn most_likely(values: &[f64], squares: &[f64], most: f64) -> Option<f64> {
    let likelihood = |variance: f64| -> f64 {
        let of_one = |(&value, &square): (&f64, &f64)| {
            // Rounding of what nothing is known of.
            let value = value.max(0.0);
            variance * square / (1.0 + variance * value) - (variance * value).ln_1p()
        };
        values.iter().zip(squares).map(of_one).sum()
    };
    let at = |step: f64| most * LEAST.powf(1.0 - step / f64::from(VALUES));
    let best = (0..=VALUES).max_by(|&a, &b| likelihood(at(f64::from(a))).total_cmp(&likelihood(at(f64::from(b)))))?;
    // Between its neighbours there is one maximum, up to the width of the grid.
    let (mut low, mut high) = (f64::from(best - 1), f64::from((best + 1).min(VALUES)));
    for _ in 0..40 {
        let [a, b] = [1.0, 2.0].map(|third| low + third * (high - low) / 3.0);
        if likelihood(at(a)) < likelihood(at(b)) { low = a } else { high = b }
    }
    let variance = at(0.5 * (low + high));
    (likelihood(variance) > 0.0).then_some(variance)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of equal eigenvalues λ the likelihood is largest where σ² + 1/λ is the mean square of the estimates j/λ.
    #[test]
    fn the_likeliest_variance_is_what_noise_does_not_account_for() {
        let (value, squares) = (4.0, [30.0f64, 2.0, 81.0, 17.0]);
        let of_estimates = squares.iter().map(|square| square / (value * value)).sum::<f64>() / 4.0;
        let found = most_likely(&[value; 4], &squares, 100.0).unwrap();
        assert!((found - (of_estimates - 1.0 / value)).abs() < 1e-6, "{found}");
        assert_eq!(most_likely(&[value; 4], &squares.map(|square| 0.1 * square), 100.0), None);
        let bounded = most_likely(&[value; 4], &squares, 0.5).unwrap();
        assert!((bounded - 0.5).abs() < 1e-6, "{bounded}");
        // What nothing is known of says nothing.
        let with_unknown = most_likely(&[-1e-18, value, value, value, value], &[0.0, 30.0, 2.0, 81.0, 17.0], 100.0);
        assert!((with_unknown.unwrap() - found).abs() < 1e-6);
    }
}
