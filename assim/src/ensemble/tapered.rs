//! Innovations whose ensemble covariance is tapered in observation space.

use super::localization::Taper;
use super::members::ObservedEnsemble;
use super::transform::WhitenedObservations;
use crate::linalg::{add_symmetric_product, eigen, product};
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
    /// Eigenvalues and eigenvectors of the tapered covariance.
    values: Vec<f64>,
    vectors: Mat<f64>,
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
    pub fn new(
        members: &ObservedEnsemble,
        observed: &'a WhitenedObservations,
        shared: &SharedParameters<'_>,
        taper: &Taper,
        cross: f64,
    ) -> Self {
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
        let (mut values, vectors) = eigen(covariance.as_ref());
        values.iter_mut().for_each(|value| *value = value.max(0.0));
        Self { observed, state_part, shared_part, cross, values, vectors }
    }

    /// dᵀ S⁻¹ d.
    pub fn chi2(&self) -> f64 {
        let d = Mat::from_fn(self.values.len(), 1, |i, _| self.observed.departures[i]);
        let projected = product(self.vectors.transpose(), d.as_ref());
        self.values.iter().enumerate().map(|(i, value)| projected[(i, 0)].powi(2) / (1.0 + value)).sum()
    }

    /// g(S) times columns, for a function g of the eigenvalues of S − I.
    pub fn apply(&self, function: impl Fn(f64) -> f64, columns: MatRef<'_, f64>) -> Mat<f64> {
        let mut inner = product(self.vectors.transpose(), columns);
        for j in 0..inner.ncols() {
            inner.col_as_slice_mut(j).iter_mut().zip(&self.values).for_each(|(x, &value)| *x *= function(value));
        }
        product(self.vectors.as_ref(), inner.as_ref())
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
        let n = self.values.len();
        let tapered = Mat::from_fn(deviations.ncols(), n, |j, i| {
            (self.cross * self.state_part[(i, j)] + self.shared_part[(i, j)]) / root
        });
        product(deviations, tapered.as_ref())
    }
}

/// The largest κ for which the taper of state and shared parameters is positive semidefinite: the root of the mean of ρ
/// over the domain, as seen from where that is least.
pub(super) fn cross_taper(grid: &Grid, taper: &Taper) -> f64 {
    let place = |i: usize, j: usize| ((i as f64 + 0.5) * grid.dx_m, (j as f64 + 0.5) * grid.dy_m);
    let corner = place(0, 0);
    let cells = (0..grid.cells()).map(|cell| taper.weight(corner, place(cell % grid.nx, cell / grid.nx)));
    (cells.sum::<f64>() / grid.cells() as f64).sqrt()
}
