//! The ensemble transform Kalman filter.

use super::members::{Ensemble, Moments, spread};
use super::saved;
use super::transform::{WhitenedObservations, transform};
use super::{EnsembleSettings, InitialMembers};
use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::error::Error;
use crate::linalg::product;
use crate::problem::Problem;
use isobar_model::{Duration, random};
use isobar_obs::ObservationWindow;
use rand_chacha::ChaCha8Rng;

/// One analysis of all observations in the space of the ensemble (Bishop, Etherton and Majumdar 2001; with the symmetric
/// square root of Hunt, Kostelich and Szunyogh 2007), for the state and the biases alike. Without localisation it needs
/// more members than the errors have directions.
pub struct EnsembleTransformKalmanFilter {
    problem: Problem,
    settings: EnsembleSettings,
    ensemble: Ensemble,
    /// Inflation of the background's covariance in the last analysis.
    variance_factor: f64,
    random: ChaCha8Rng,
}

impl EnsembleTransformKalmanFilter {
    /// A filter with members about the background.
    ///
    /// # Errors
    /// As [`Ensemble::draw`].
    pub fn new(problem: Problem, settings: EnsembleSettings) -> Result<Self, Error> {
        let mut random = stream(&settings);
        let ensemble = Ensemble::draw(&problem, &settings, &mut random)?;
        let variance_factor = settings.inflation.initial_variance_factor();
        Ok(Self { problem, settings, ensemble, variance_factor, random })
    }

    /// The members.
    pub fn ensemble(&self) -> &Ensemble {
        &self.ensemble
    }
}

/// The random stream of an ensemble; methods with the same seed and number of members start from the same ones.
pub(super) fn stream(settings: &EnsembleSettings) -> ChaCha8Rng {
    let purpose = match settings.initial_members {
        InitialMembers::Random => "ensemble",
        InitialMembers::SecondOrderExact => "ensemble/second-order exact",
    };
    random::stream(settings.seed, purpose)
}

impl Assimilator for EnsembleTransformKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.ensemble.forecast(&self.problem, &self.settings, window, &mut self.random)?;
        Ok(self.ensemble.estimate(&self.problem))
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let members = self.ensemble.observe(&self.problem, observed)?;
        let mut innovation_chi2 = 0.0;
        if !observed.is_empty() {
            let whitened = WhitenedObservations::new(&members);
            let inflation = &self.settings.inflation;
            self.variance_factor = inflation.variance_factor(self.variance_factor, &whitened, observed.len() as f64);
            let analysis = transform(&whitened, self.variance_factor, inflation.relaxation_to_prior_perturbations);
            innovation_chi2 = analysis.chi2;
            let Moments { mean, perturbations } = self.ensemble.moments();
            let mut background_spread = spread(&perturbations);
            background_spread.truncate(self.problem.background.values().len());
            let mut moments = Moments::of_deviations(mean, product(perturbations.as_ref(), analysis.weights.as_ref()));
            inflation.relax_spread(&background_spread, &mut moments.perturbations);
            self.ensemble.set(&moments);
        }
        let estimate = self.ensemble.estimate(&self.problem);
        Ok(self.problem.analysis(observed, members.innovations, estimate, innovation_chi2))
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        saved::save(&self.ensemble, std::slice::from_ref(&self.variance_factor), &self.random)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), Error> {
        saved::restore(bytes, &mut self.ensemble, std::slice::from_mut(&mut self.variance_factor), &mut self.random)
    }
}
