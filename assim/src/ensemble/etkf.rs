//! The ensemble transform Kalman filter.

use super::EnsembleSettings;
use super::cycle::EnsembleCycle;
use super::members::{Ensemble, Moments, ObservedEnsemble};
use super::transform::{WhitenedObservations, transform};
use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::linalg::product;
use crate::problem::Problem;
use faer::MatRef;
use isobar_model::Duration;
use isobar_obs::ObservationWindow;

/// One analysis of all observations in the space of the ensemble (Bishop, Etherton and Majumdar 2001; with the symmetric
/// square root of Hunt, Kostelich and Szunyogh 2007), for the state and the biases alike. Without localisation it needs
/// more members than the errors have directions.
pub struct EnsembleTransformKalmanFilter {
    cycle: EnsembleCycle,
}

impl EnsembleTransformKalmanFilter {
    /// A filter with members about the background.
    ///
    /// # Errors
    /// As [`Ensemble::draw`].
    pub fn new(problem: Problem, settings: EnsembleSettings) -> Result<Self, Error> {
        Ok(Self { cycle: EnsembleCycle::new(problem, settings, 1)? })
    }

    /// The members.
    pub fn ensemble(&self) -> &Ensemble {
        &self.cycle.ensemble
    }

    /// Takes the analysis into the ensemble; returns χ².
    fn update(&mut self, members: &ObservedEnsemble) -> f64 {
        let whitened = WhitenedObservations::new(members);
        let inflation = self.cycle.settings.inflation;
        let factor = &mut self.cycle.variance_factors[0];
        *factor = inflation.variance_factor(*factor, &whitened, whitened.departures.len() as f64);
        let analysis = transform(&whitened, *factor, inflation.relaxation_to_prior_perturbations);
        let background = self.cycle.ensemble.moments();
        let deviations = product(background.perturbations.as_ref(), analysis.weights.as_ref());
        let analysed = Moments::of_deviations(background.mean.clone(), deviations);
        self.cycle.set(&background, analysed);
        analysis.chi2
    }
}

impl Assimilator for EnsembleTransformKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.cycle.forecast(window)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let members = self.cycle.ensemble.observe(&self.cycle.problem, observed)?;
        let innovation_chi2 = if observed.is_empty() { 0.0 } else { self.update(&members) };
        Ok(self.cycle.analysis(observed, members, innovation_chi2))
    }

    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.cycle.covariance_column(unknown)
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        self.cycle.save()
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        self.cycle.restore(saved)
    }

    fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        self.cycle.calibration_accuracy()
    }

    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.cycle.widen_calibration(covariance);
        Ok(())
    }
}
