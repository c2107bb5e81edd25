//! The dense (extended) Kalman filter with one observation at a time: no matrix of the size of the observations.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::augmented::{AugmentedState, entries};
use crate::error::Error;
use crate::linalg::{for_each_chunk, mirror_lower};
use crate::problem::{Innovations, Problem};
use faer::{MatMut, MatRef};
use isobar_model::Duration;
use isobar_obs::ObservationWindow;

/// The Kalman filter of [`crate::kalman`], whose analysis takes one observation after the other: where their errors are
/// uncorrelated, each is a scalar measurement of what the ones before have left (Maybeck 1979, section 7.4; Bierman 1977,
/// section II.7). With the row h of H, the variance r, and P and δ as they stand,
///
/// ```text
/// v = P h        α = hᵀ v + r        K = v / α        δ ← δ + K (d − hᵀ δ)        P ← P − K vᵀ
/// ```
///
/// where the covariance is updated in Joseph's form (I − K hᵀ) P (I − K hᵀ)ᵀ + r K Kᵀ as Bierman's stabilised update,
///
/// ```text
/// P̄ = P − K vᵀ        v̄ = P̄ h        P ← P̄ − (v̄ − r K) Kᵀ
/// ```
///
/// The α are the squared pivots of H P Hᵀ + R in LDLᵀ form, so Σ (d − hᵀ δ)²/α is the normalised innovation squared. Each
/// observation costs one sweep over half of P, n (m + p)² in all; nothing is cubic in n. One linearisation, about the
/// background, serves all observations of a cycle: the analysis is that of [`crate::kalman`] to rounding.
pub struct SerialKalmanFilter {
    augmented: AugmentedState,
}

impl SerialKalmanFilter {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit.
    pub fn new(problem: Problem) -> Result<Self, Error> {
        Ok(Self { augmented: AugmentedState::new(problem)? })
    }

    /// The covariance of the errors of (x, c), `[m + p, m + p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.augmented.covariance.as_ref()
    }

    /// The increment δ and the normalised innovation squared; P becomes that of the analysis.
    fn take(&mut self, innovations: &Innovations) -> Result<(Vec<f64>, f64), Error> {
        let m = self.augmented.state.values().len();
        let covariance = &mut self.augmented.covariance;
        let mut increment = vec![0.0; covariance.nrows()];
        let mut chi2 = 0.0;
        let (n, mut h) = (innovations.departures.len(), Vec::new());
        for (row, (&departure, &variance)) in innovations.departures.iter().zip(&innovations.variance).enumerate() {
            h.clear();
            h.extend(entries(&innovations.jacobian, row, m));
            let v = multiply(&h, covariance.nrows(), |i, j| covariance[(i, j)]);
            let alpha = dot(&h, &v) + variance;
            if !(alpha > 0.0 && alpha.is_finite()) {
                let matrix = "the innovation covariance H P H' + R".into();
                return Err(Error::NotPositiveDefinite { matrix, pivot: row, size: n });
            }
            let gain: Vec<f64> = v.iter().map(|value| value / alpha).collect();
            let innovation = departure - dot(&h, &increment);
            increment.iter_mut().zip(&gain).for_each(|(value, gain)| *value += gain * innovation);
            chi2 += innovation * innovation / alpha;
            update(covariance.as_mut(), &h, variance, &v, &gain);
        }
        mirror_lower(covariance.as_mut());
        Ok((increment, chi2))
    }
}

impl Assimilator for SerialKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.augmented.forecast(window)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let AugmentedState { problem, state, bias, .. } = &self.augmented;
        let innovations = problem.innovations(observed, state, bias)?;
        let (increment, innovation_chi2) = self.take(&innovations)?;
        self.augmented.add(&increment);
        let estimate = self.augmented.estimate()?;
        Ok(self.augmented.problem.analysis(observed, innovations, estimate, innovation_chi2))
    }
}

/// P h for a symmetric P, of which only entries (i, j) with i ≥ j are asked for.
fn multiply(h: &[(usize, f64)], size: usize, lower: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    (0..size).map(|i| h.iter().map(|&(j, weight)| weight * lower(i.max(j), i.min(j))).sum()).collect()
}

/// The stabilised update of the lower triangle of P, both steps in one sweep.
fn update(p: MatMut<'_, f64>, h: &[(usize, f64)], variance: f64, v: &[f64], gain: &[f64]) {
    // The very values that P̄ will have: only then does the second step take back the rounding of the first.
    let mut left = multiply(h, v.len(), |i, j| p[(i, j)] - gain[i] * v[j]);
    left.iter_mut().zip(gain).for_each(|(left, gain)| *left -= variance * gain);
    for_each_chunk(p, 0, &|first, chunk| {
        for (j, column) in (first..).zip(chunk.col_iter_mut()) {
            let column = column.try_as_col_major_mut().expect("columns are contiguous").as_slice_mut();
            for ((p, k), left) in column[j..].iter_mut().zip(&gain[j..]).zip(&left[j..]) {
                *p = (*p - k * v[j]) - left * gain[j];
            }
        }
    });
}

/// hᵀ x.
fn dot(h: &[(usize, f64)], x: &[f64]) -> f64 {
    h.iter().map(|&(index, weight)| weight * x[index]).sum()
}
