//! What the ensemble methods share but for their analyses.

use super::fixed_lag::{self, FixedLag};
use super::members::{Ensemble, Moments, ObservedEnsemble, spread};
use super::{EnsembleSettings, InitialMembers, ModelErrorTreatment};
use crate::assimilator::{Analysis, Estimate};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::problem::Problem;
use crate::saved::{from_bytes, to_bytes, unfit};
use faer::MatRef;
use isobar_model::{Duration, random};
use isobar_obs::ObservationWindow;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Members with all that they need to go from cycle to cycle.
pub(super) struct EnsembleCycle {
    pub problem: Problem,
    pub settings: EnsembleSettings,
    pub ensemble: Ensemble,
    /// Inflation of the background's covariance in the last analysis, of each place that is analysed.
    pub variance_factors: Vec<f64>,
    pub random: ChaCha8Rng,
    pub smoother: Option<FixedLag>,
}

/// What a checkpoint holds of it.
#[derive(Serialize, Deserialize)]
struct Saved {
    members: Vec<f64>,
    variance_factors: Vec<f64>,
    /// The place in the random stream.
    random: u128,
    smoother: Option<fixed_lag::Saved>,
}

impl EnsembleCycle {
    /// Members about the background, for a method that makes so many analyses in a cycle.
    ///
    /// # Errors
    /// As [`Ensemble::draw`].
    pub fn new(problem: Problem, settings: EnsembleSettings, analyses: usize) -> Result<Self, Error> {
        // Methods with the same seed and number of members start from the same ones.
        let purpose = match settings.initial_members {
            InitialMembers::Random => "ensemble",
            InitialMembers::SecondOrderExact => "ensemble/second-order exact",
        };
        let mut random = random::stream(settings.seed, purpose);
        let ensemble = Ensemble::draw(&problem, &settings, &mut random)?;
        let variance_factors = vec![settings.inflation.initial_variance_factor(); analyses];
        Ok(Self { problem, settings, ensemble, variance_factors, random, smoother: None })
    }

    /// The same with a smoother of the last `lag` analyses before the newest.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if their members do not fit into the memory limit; [`Error::Setting`] with
    /// [`ModelErrorTreatment::SquareRoot`], unless nothing is added in a cycle: the square root recombines the members, which
    /// then do not go on from the earlier ones that are to be regressed on them.
    pub fn smoothing(mut self, lag: usize) -> Result<Self, Error> {
        let Self { problem, settings, ensemble, .. } = &self;
        let drifts = problem.estimated_calibration().parameters.iter().any(|it| it.sigma_drift_per_sqrt_day > 0.0);
        if settings.model_error == ModelErrorTreatment::SquareRoot && (problem.model_error.is_some() || drifts) {
            let message = "an ensemble smoother needs members that go on from the earlier ones: random draws of the model \
                           error, not its square root";
            return Err(Error::Setting(message.into()));
        }
        let (members, rows) = (ensemble.members(), ensemble.values().nrows());
        // Beside the four of them that the filter needs.
        let needed_bytes = 8 * (lag as u64 + 5) * (members * rows) as u64;
        if needed_bytes > problem.memory_limit_bytes {
            let what = format!("an ensemble smoother of {lag} analyses with {members} members of {rows} unknowns");
            return Err(Error::TooLarge { what, needed_bytes, limit_bytes: problem.memory_limit_bytes });
        }
        self.smoother = Some(FixedLag::new(lag));
        Ok(self)
    }

    /// Mean and spread of the members at the analysis so many before the newest.
    pub fn smoothed(&self, analyses_ago: usize) -> Option<Estimate> {
        let (mean, spread) = self.smoother.as_ref()?.estimate(analyses_ago)?;
        Some(self.ensemble.estimate_of(&self.problem, mean, spread))
    }

    /// m, the number of values of a state.
    pub fn state_values(&self) -> usize {
        self.problem.background.values().len()
    }

    /// Mean and spread of the members.
    pub fn estimate(&self) -> Estimate {
        self.ensemble.estimate(&self.problem)
    }

    /// Forecasts the members.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.ensemble.forecast(&self.problem, &self.settings, window, &mut self.random)?;
        Ok(self.estimate())
    }

    /// Takes the analysed members, from those of the background, and relaxes their spread.
    pub fn set(&mut self, background: &Moments, mut analysed: Moments) {
        let mut background_spread = spread(&background.perturbations);
        background_spread.truncate(self.state_values());
        self.settings.inflation.relax_spread(&background_spread, &mut analysed.perturbations);
        self.ensemble.set(&analysed);
    }

    /// What the analysis did.
    pub fn analysis(
        &self,
        observed: &ObservationWindow,
        members: ObservedEnsemble,
        innovation_chi2: Option<f64>,
    ) -> Analysis {
        self.problem.analysis(observed, members.innovations, self.estimate(), innovation_chi2)
    }

    /// A column of the members' covariance X Xᵀ/(N − 1), without localisation.
    pub fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        let Moments { perturbations, .. } = self.ensemble.moments();
        let number = match unknown {
            Unknown::Value(number) => number,
            Unknown::Parameter(number) => self.state_values() + number,
        };
        let mut column = vec![0.0; perturbations.nrows()];
        let degrees = (perturbations.ncols() - 1) as f64;
        for j in 0..perturbations.ncols() {
            let member = perturbations.col_as_slice(j);
            let weight = member.get(number)? / degrees;
            column.iter_mut().zip(member).for_each(|(sum, value)| *sum += weight * value);
        }
        Some(CovarianceColumn::of_augmented(column, self.state_values(), &self.problem.calibration))
    }

    /// What the members know of the parameters.
    pub fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        self.ensemble.calibration_accuracy(&self.problem)
    }

    /// Adds draws with a covariance to the members' parameters.
    pub fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) {
        self.ensemble.widen_calibration(covariance, &mut self.random);
    }

    /// What a checkpoint holds of it.
    pub fn save(&self) -> Result<Vec<u8>, Error> {
        let members = 0..self.ensemble.members();
        to_bytes(&Saved {
            members: members.flat_map(|member| self.ensemble.member(member)).copied().collect(),
            variance_factors: self.variance_factors.clone(),
            random: self.random.get_word_pos(),
            smoother: self.smoother.as_ref().map(FixedLag::save),
        })
    }

    /// Takes back what [`EnsembleCycle::save`] gave.
    ///
    /// # Errors
    /// [`Error::Saved`] if it is of another ensemble.
    pub fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let Saved { members, variance_factors, random, smoother } = from_bytes(saved)?;
        if variance_factors.len() != self.variance_factors.len() {
            return Err(unfit("the inflation"));
        }
        self.ensemble.restore(members)?;
        self.variance_factors = variance_factors;
        self.random.set_word_pos(random);
        match (&mut self.smoother, smoother) {
            (None, None) => Ok(()),
            (Some(own), Some(saved)) => own.restore(saved, self.ensemble.values().nrows(), self.ensemble.members()),
            _ => Err(unfit("the smoother")),
        }
    }
}
