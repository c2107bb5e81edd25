//! An ensemble Kalman filter: members in their cycle, and an analysis.

use super::cycle::EnsembleCycle;
use super::fixed_lag::FixedLag;
use super::members::{Ensemble, ObservedEnsemble};
use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use faer::MatRef;
use isobar_model::Duration;
use isobar_obs::ObservationWindow;

/// What the ensemble methods differ in.
pub(super) trait EnsembleAnalysis: Send {
    /// Takes the analysis of the observations, of which there are some, into the ensemble; returns χ² where double precision
    /// has it.
    ///
    /// # Errors
    /// That of an analysis which double precision cannot resolve.
    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> Result<Option<f64>, Error>;
}

/// An ensemble Kalman filter with an analysis: [`EnsembleTransformKalmanFilter`](super::EnsembleTransformKalmanFilter),
/// [`LocalEnsembleTransformKalmanFilter`](super::LocalEnsembleTransformKalmanFilter),
/// [`StochasticEnsembleKalmanFilter`](super::StochasticEnsembleKalmanFilter).
pub struct EnsembleFilter<A> {
    pub(super) cycle: EnsembleCycle,
    pub(super) analysis: A,
}

impl<A> EnsembleFilter<A> {
    /// The members.
    pub fn ensemble(&self) -> &Ensemble {
        &self.cycle.ensemble
    }
}

impl<A: EnsembleAnalysis> Assimilator for EnsembleFilter<A> {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.cycle.forecast(window)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let Self { cycle, analysis } = self;
        let members = cycle.ensemble.observe(&cycle.problem, observed)?;
        if let Some(smoother) = &mut cycle.smoother {
            smoother.shorten();
        }
        let innovation_chi2 = if observed.is_empty() { Some(0.0) } else { analysis.update(cycle, &members)? };
        if let Some(smoother) = &mut cycle.smoother {
            smoother.push(cycle.ensemble.moments());
        }
        Ok(cycle.analysis(observed, members, innovation_chi2))
    }

    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.cycle.covariance_column(unknown)
    }

    fn smoother_lag(&self) -> Option<usize> {
        self.cycle.smoother.as_ref().map(FixedLag::lag)
    }

    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        Ok(self.cycle.smoothed(analyses_ago))
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
