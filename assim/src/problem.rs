//! What every method is given at its start, and the innovations it computes from a window of observations.

use crate::assimilator::{Analysis, BiasTreatment, Estimate};
use crate::covariance::Covariance;
use crate::error::Error;
use isobar_model::{Adjoint, Duration, State};
use isobar_obs::{Calibration, Jacobian, ObservationWindow, SparseRows};
use std::sync::Arc;

/// An assimilation problem: everything that a method may know. The truth is not part of it.
#[derive(Clone)]
pub struct Problem {
    /// The forecast model.
    pub model: Arc<dyn Adjoint>,
    /// The background at the start.
    pub background: State,
    /// Covariance of its error.
    pub background_error: Arc<dyn Covariance>,
    /// Covariance of the model error that a cycle adds; `None` for a perfect model.
    pub model_error: Option<Arc<dyn Covariance>>,
    /// The calibration parameters, with prior mean zero.
    pub calibration: Calibration,
    /// What becomes of the biases.
    pub bias: BiasTreatment,
    /// The most memory that the method may use \[bytes\].
    pub memory_limit_bytes: u64,
}

impl Problem {
    /// The time steps of a forecast over `window`.
    pub(crate) fn steps(&self, window: Duration) -> Result<usize, Error> {
        window.steps_of(self.model.time_step()).ok_or_else(|| {
            Error::Setting(format!(
                "the window of {window} is not a whole number of time steps of {}",
                self.model.time_step()
            ))
        })
    }

    /// The calibration parameters that the method estimates: all or none.
    pub(crate) fn estimated_calibration(&self) -> Calibration {
        match self.bias {
            BiasTreatment::Estimate => self.calibration.clone(),
            BiasTreatment::Ignore | BiasTreatment::Known => Calibration::default(),
        }
    }

    /// Innovations about an estimate; `calibration` holds all parameters of the experiment.
    pub(crate) fn innovations(
        &self,
        observed: &ObservationWindow,
        state: &State,
        calibration: &[f64],
    ) -> Result<Innovations, Error> {
        let mut jacobian = observed.operator.linearize(state, calibration);
        if self.bias != BiasTreatment::Estimate {
            jacobian.calibration = SparseRows::new();
            (0..observed.len()).for_each(|_| jacobian.calibration.push_row([]));
        }
        let departures = self.departures(observed, state, calibration);
        if let Some(row) = departures.iter().position(|departure| !departure.is_finite()) {
            let report = &observed.reports[row];
            return Err(Error::NotFinite { what: format!("the innovation of {}/{}", report.network, report.platform) });
        }
        let variance = observed.sigma.iter().map(|sigma| sigma * sigma).collect();
        Ok(Innovations { departures, jacobian, variance })
    }

    /// y − h(x, c), with the biases removed from y if they are known.
    pub(crate) fn departures(&self, observed: &ObservationWindow, state: &State, calibration: &[f64]) -> Vec<f64> {
        let simulated = observed.operator.simulate(state, calibration);
        self.values(observed).iter().zip(simulated).map(|(value, simulated)| value - simulated).collect()
    }

    /// y, with the biases removed if they are known.
    pub(crate) fn values<'a>(&self, observed: &'a ObservationWindow) -> &'a [f64] {
        match self.bias {
            BiasTreatment::Known => &observed.values_bias_removed,
            BiasTreatment::Estimate | BiasTreatment::Ignore => &observed.values,
        }
    }

    /// What an analysis did with `observed`, from the innovations that it began with and the estimate that it came to.
    pub(crate) fn analysis(
        &self,
        observed: &ObservationWindow,
        innovations: Innovations,
        estimate: Estimate,
        innovation_chi2: impl Into<Option<f64>>,
    ) -> Analysis {
        let analysis_departures = self.departures(observed, &estimate.state, &estimate.calibration);
        Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: innovation_chi2.into(),
            partition: None,
            warnings: Vec::new(),
        }
    }

    /// [`Problem::analysis`] of a method that holds covariances as sums: H P Hᵀ + R, or I + Lᵀ Hᵀ R⁻¹ H L.
    ///
    /// With s² a diagonal entry of H P Hᵀ, rounding changes H P Hᵀ by ε s², and the analysis at the observations by
    /// δ(H x) ≈ (H K) δ(H P Hᵀ) z, where z = (H P Hᵀ + R)⁻¹ d = R⁻¹ (y − H x_a). As |H K| ≤ 1, the analysis is uncertain by
    /// ε s² |y − H x_a|/σ². That matters where observations whose σ is beyond rounding contradict each other: of two, 1 ± σ
    /// and 2 ± σ, nothing is left in the sums to show that both count the same.
    ///
    /// # Errors
    /// [`Error::Unresolved`] where this exceeds 10⁻⁶ of s and of the background's departure. s is that of B, which bounds the method's from above but for errors
    /// that grow; what is left of an observation that is fitted to 10⁻⁶ s is no contradiction.
    pub(crate) fn resolved_analysis(
        &self,
        observed: &ObservationWindow,
        innovations: Innovations,
        estimate: Estimate,
        innovation_chi2: impl Into<Option<f64>>,
    ) -> Result<Analysis, Error> {
        const TOLERANCE: f64 = 1e-6;
        let (jacobian, variance) = (innovations.jacobian.clone(), innovations.variance.clone());
        let analysis = self.analysis(observed, innovations, estimate, innovation_chi2);
        for (row, (departure, variance)) in analysis.analysis_departures.iter().zip(variance).enumerate() {
            // Nothing else can exceed the tolerance by both measures, and B is asked of these few alone.
            if departure * departure < variance * TOLERANCE.powi(2) / f64::EPSILON {
                continue;
            }
            let of_state = jacobian.state.row(row).iter();
            let of_state = of_state.map(|&(i, weight)| weight.abs() * self.background_error.covariance(i, i).sqrt());
            let of_biases = jacobian.calibration.row(row).iter();
            let of_biases = of_biases.map(|&(i, weight)| weight.abs() * self.calibration.prior_covariance(i, i).sqrt());
            let spread = of_state.sum::<f64>() + of_biases.sum::<f64>();
            let uncertainty = f64::EPSILON * spread * spread * departure.abs() / variance;
            let scale = spread.max(analysis.background_departures[row].abs());
            if uncertainty > TOLERANCE * scale && departure.abs() > TOLERANCE * spread {
                let report = &observed.reports[row];
                return Err(Error::Unresolved {
                    observation: format!("{}/{}", report.network, report.platform),
                    departure: *departure,
                    sigma: variance.sqrt(),
                    spread,
                });
            }
        }
        Ok(analysis)
    }
}

/// The observations of a cycle as seen from an estimate.
pub(crate) struct Innovations {
    /// d = y − h(x, c).
    pub departures: Vec<f64>,
    /// X and G.
    pub jacobian: Jacobian,
    /// The diagonal of R.
    pub variance: Vec<f64>,
}

impl Innovations {
    /// R^-½ dy.
    pub fn whiten(&self, mut dy: Vec<f64>) -> Vec<f64> {
        dy.iter_mut().zip(&self.variance).for_each(|(value, variance)| *value /= variance.sqrt());
        dy
    }
}
