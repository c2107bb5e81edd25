//! Innovations whose ensemble covariance is tapered in observation space.

use super::localization::Taper;
use super::members::ObservedEnsemble;
use super::transform::WhitenedObservations;
use crate::error::Error;
use crate::linalg::{
    add_symmetric_product, cholesky, column, product, solve_lower, solve_lower_transposed, squared_norm,
};
use crate::problem::Innovations;
use faer::{Mat, MatRef};
use isobar_model::Grid;

/// The innovations d̃ with their covariance I + L ∘ (Ỹ Ỹᵀ), whitened by R.
///
/// A shared bias belongs to no place, so distance says nothing of its correlation with a state's value. With the taper ρ
/// on the state and 1 on the biases, a constant κ between them keeps the taper `[ρ κ; κ 1]` positive semidefinite as long
/// as κ² is at most the mean of ρ over a homogeneous domain: what it lets through is the correlation with the mean over
/// the domain. That largest κ is used. So with Ỹ = Ỹ_x + Ỹ_c, the parts of the state and of the shared biases,
///
/// ```text
/// L ∘ (Ỹ Ỹᵀ) = ρ ∘ (Ỹ_x Ỹ_xᵀ) + κ (Ỹ_x Ỹ_cᵀ + Ỹ_c Ỹ_xᵀ) + Ỹ_c Ỹ_cᵀ
/// ```
pub(super) struct TaperedInnovations<'a> {
    observed: &'a WhitenedObservations,
    /// Ỹ_x and Ỹ_c, `[n, N]`.
    state_part: Mat<f64>,
    shared_part: Mat<f64>,
    /// κ.
    cross: f64,
    /// The standard deviations of the members' h(x, c) over those of the observations, `[n]`.
    spread: Vec<f64>,
    /// σ of the observations.
    sigma: Vec<f64>,
    /// The Cholesky factor of S = I + L ∘ (Ỹ Ỹᵀ).
    root: Mat<f64>,
}

/// The parameters that many places share, among those that are estimated.
pub(super) struct SharedParameters<'a> {
    /// Their rows among the parameters.
    pub numbers: &'a [usize],
    /// The members' deviations, `[all parameters, N]`.
    pub perturbations: MatRef<'a, f64>,
}

impl<'a> TaperedInnovations<'a> {
    /// `members` is what `observed` was before it was whitened.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]: the observations are too accurate beside the members' spread.
    pub fn new(
        members: &ObservedEnsemble,
        observed: &'a WhitenedObservations,
        shared: &SharedParameters<'_>,
        taper: &Taper,
        cross: f64,
    ) -> Result<Self, Error> {
        let ObservedEnsemble { innovations: Innovations { jacobian, variance, .. }, places, .. } = members;
        let (n, columns) = (observed.perturbations.nrows(), observed.perturbations.ncols());
        let root = ((columns - 1) as f64).sqrt();
        let shared_part = Mat::from_fn(n, columns, |row, j| {
            let entries = jacobian.calibration.row(row).iter().filter(|entry| shared.numbers.contains(&entry.0));
            let sum: f64 = entries.map(|&(number, weight)| weight * shared.perturbations[(number, j)]).sum();
            sum / (variance[row].sqrt() * root)
        });
        let state_part = &observed.perturbations - &shared_part;
        let mut covariance = Mat::zeros(n, n);
        add_symmetric_product(covariance.as_mut(), 1.0, state_part.as_ref(), state_part.transpose());
        let mut correction = Mat::zeros(n, n);
        add_symmetric_product(correction.as_mut(), 1.0, shared_part.as_ref(), shared_part.transpose());
        let between = product(state_part.as_ref(), shared_part.transpose());
        for j in 0..n {
            for i in j..n {
                covariance[(i, j)] = taper.weight(places[i], places[j]) * covariance[(i, j)]
                    + cross * (between[(i, j)] + between[(j, i)])
                    + correction[(i, j)];
            }
        }
        let spread = (0..n).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect();
        let sigma = variance.iter().map(|variance| variance.sqrt()).collect();
        (0..n).for_each(|i| covariance[(i, i)] += 1.0);
        let root = cholesky(covariance, || "the members' tapered innovation covariance H P H' + R".into())?;
        Ok(Self { observed, state_part, shared_part, cross, spread, sigma, root })
    }

    /// dᵀ S⁻¹ d.
    ///
    /// # Errors
    /// [`Error::Unresolved`] where rounding of S changes what S⁻¹ d adds at an observation by more than 10⁻⁶ of the members'
    /// spread there; see [`Problem::resolved_analysis`](crate::problem::Problem::resolved_analysis).
    pub fn chi2(&self) -> Result<f64, Error> {
        const TOLERANCE: f64 = 1e-6;
        // S⁻¹ d is also the departure that is left, in standard deviations of the observation.
        let left = self.solve(column(&self.observed.departures));
        let left = left.col_as_slice(0);
        let unresolved =
            left.iter().zip(&self.spread).zip(&self.observed.departures).position(|((left, spread), d)| {
                f64::EPSILON * spread * spread * left.abs() > TOLERANCE * spread.max(d.abs())
            });
        if let Some(row) = unresolved {
            let sigma = self.sigma[row];
            return Err(Error::Unresolved {
                observation: format!("{} of the cycle", row + 1),
                departure: sigma * left[row],
                sigma,
                spread: sigma * self.spread[row],
            });
        }
        let mut whitened = column(&self.observed.departures);
        solve_lower(self.root.as_ref(), whitened.as_mut());
        Ok(squared_norm(whitened.col_as_slice(0)))
    }

    /// S⁻¹ times columns.
    pub fn solve(&self, mut columns: Mat<f64>) -> Mat<f64> {
        solve_lower(self.root.as_ref(), columns.as_mut());
        solve_lower_transposed(self.root.as_ref(), columns.as_mut());
        columns
    }

    /// The tapered covariance of deviations `[k, N]` at one place with the observations, `[k, n]`; `weights` is ρ of each.
    pub fn covariance_of_state(&self, deviations: MatRef<'_, f64>, weights: &[f64]) -> Mat<f64> {
        let root = ((deviations.ncols() - 1) as f64).sqrt();
        let tapered = Mat::from_fn(deviations.ncols(), weights.len(), |j, i| {
            (weights[i] * self.state_part[(i, j)] + self.cross * self.shared_part[(i, j)]) / root
        });
        product(deviations, tapered.as_ref())
    }

    /// The tapered covariance of the deviations `[k, N]` of shared parameters with all observations, `[k, n]`.
    pub fn covariance_of_shared(&self, deviations: MatRef<'_, f64>) -> Mat<f64> {
        let root = ((deviations.ncols() - 1) as f64).sqrt();
        let n = self.spread.len();
        let tapered = Mat::from_fn(deviations.ncols(), n, |j, i| {
            (self.cross * self.state_part[(i, j)] + self.shared_part[(i, j)]) / root
        });
        product(deviations, tapered.as_ref())
    }
}

/// How many numbers [`TaperedInnovations`] holds for N members and n observations.
pub(super) fn numbers(members: f64, observations: f64) -> f64 {
    4.0 * observations * observations + 4.0 * members * observations
}

/// The largest κ for which the taper of state and shared parameters is positive semidefinite: the root of the mean of ρ
/// over the domain, as seen from where that is least.
pub(super) fn cross_taper(grid: &Grid, taper: &Taper) -> f64 {
    let place = |i: usize, j: usize| ((i as f64 + 0.5) * grid.dx_m, (j as f64 + 0.5) * grid.dy_m);
    let corner = place(0, 0);
    let cells = (0..grid.cells()).map(|cell| taper.weight(corner, place(cell % grid.nx, cell / grid.nx)));
    (cells.sum::<f64>() / grid.cells() as f64).sqrt()
}
