//! The ensemble transform Kalman filter.

use super::EnsembleSettings;
use super::cycle::EnsembleCycle;
use super::filter::{EnsembleAnalysis, EnsembleFilter, with_analysis, with_smoother, with_trajectories};
use super::observed::ObservedEnsemble;
use super::transform::{self, WhitenedObservations, transform};
use crate::error::Error;
use crate::problem::Problem;
use isobar_model::Model;

/// One analysis of all observations in the space of the ensemble (Bishop, Etherton and Majumdar 2001; with the symmetric
/// square root of Hunt, Kostelich and Szunyogh 2007), for the state and the biases alike. Without localisation it needs
/// more members than the errors have directions.
pub type EnsembleTransformKalmanFilter = EnsembleFilter<Transform>;

/// The analysis of the [`EnsembleTransformKalmanFilter`].
#[derive(Clone)]
pub struct Transform;

impl EnsembleTransformKalmanFilter {
    /// A filter with members about the background.
    ///
    /// # Errors
    /// As [`Ensemble::draw`](super::Ensemble::draw).
    pub fn new(problem: impl Into<Problem<dyn Model>>, settings: EnsembleSettings) -> Result<Self, Error> {
        with_analysis(problem.into(), settings, 1, Transform)
    }

    /// The filter with its ensemble smoother (EnKS) of the last `lag` analyses before the newest.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if their members do not fit into the memory limit; [`Error::Setting`] with
    /// [`ModelErrorTreatment::SquareRoot`](super::ModelErrorTreatment::SquareRoot), unless nothing is added in a cycle.
    pub fn smoothing(self, lag: usize) -> Result<Self, Error> {
        with_smoother(self, lag)
    }

    /// The same with members that see observations within a window from their own trajectories: the asynchronous filter (Sakov,
    /// Evensen and Bertino 2010).
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the starts of the trajectories do not fit into the memory limit.
    pub fn asynchronous(self) -> Result<Self, Error> {
        with_trajectories(self)
    }
}

impl EnsembleAnalysis for Transform {
    fn numbers(&self, _: &Problem<dyn Model>, members: f64, observations: f64, _: usize) -> f64 {
        transform::numbers(members, observations)
    }

    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> Result<Option<f64>, Error> {
        let whitened = WhitenedObservations::new(members);
        let inflation = cycle.inflation(&whitened);
        Ok(Some(cycle.transform(transform(&whitened, inflation))))
    }
}
