//! What the ensemble methods share but for their analyses.

use super::fixed_lag::FixedLag;
use super::members::Ensemble;
use super::moments::{Moments, spread};
use super::observed::ObservedEnsemble;
use super::transform::{Transform, WhitenedObservations};
use super::{EnsembleSettings, InitialMembers, ModelErrorTreatment};
use crate::error::Error;
use crate::estimate::{Analysis, Estimate};
use crate::linalg::product;
use crate::memory::require;
use crate::problem::Problem;
use isobar_model::{Bands, Model, random};
use isobar_obs::ObservationWindow;
use rand_chacha::ChaCha8Rng;

/// Members with all that they need to go from cycle to cycle.
#[derive(Clone)]
pub(super) struct EnsembleCycle {
    pub problem: Problem<dyn Model>,
    /// Which rank has which rows of the members.
    pub bands: Bands,
    pub settings: EnsembleSettings,
    pub memory: Memory,
    /// Whether members see observations within a window from their own trajectories.
    pub asynchronous: bool,
    /// Where the members' trajectories through the present window began.
    pub starts: Option<Ensemble>,
}

/// What changes from cycle to cycle.
#[derive(Clone)]
pub(super) struct Memory {
    pub ensemble: Ensemble,
    /// Inflation of the background's covariance in the last analysis, of each place that is analysed.
    pub variance_factors: Vec<f64>,
    pub random: ChaCha8Rng,
    pub smoother: Option<FixedLag>,
}

impl EnsembleCycle {
    /// Members about the background, for a method that makes `analyses` of them in a cycle.
    ///
    /// # Errors
    /// As [`Ensemble::draw`].
    pub fn new(problem: Problem<dyn Model>, settings: EnsembleSettings, analyses: usize) -> Result<Self, Error> {
        // Methods with the same seed and number of members start from the same ones.
        let purpose = match settings.initial_members {
            InitialMembers::Random => "ensemble",
            InitialMembers::SecondOrderExact => "ensemble/second-order exact",
        };
        let mut random = random::stream(settings.seed, purpose);
        let ensemble = Ensemble::draw(&problem, &settings, &mut random)?;
        let variance_factors = vec![settings.inflation.initial_variance_factor(); analyses];
        let memory = Memory { ensemble, variance_factors, random, smoother: None };
        let bands = problem.bands();
        Ok(Self { problem, bands, settings, memory, asynchronous: false, starts: None })
    }

    /// The same with a smoother of the last `lag` analyses before the newest.
    ///
    /// # Errors
    /// [`Error::Setting`] with [`ModelErrorTreatment::SquareRoot`], unless nothing is added in a cycle: the square root
    /// recombines the members, which then do not go on from the earlier ones that are to be regressed on them.
    pub fn smoothing(mut self, lag: usize) -> Result<Self, Error> {
        self.problem.require_one_rank("an ensemble smoother")?;
        if self.recombines() {
            let message = "an ensemble smoother needs members that go on from the earlier ones: random draws of the model \
                           error, not its square root";
            return Err(Error::Setting(message.into()));
        }
        self.memory.smoother = Some(FixedLag::new(lag));
        Ok(self)
    }

    /// Whether a forecast ends with a recombination of the members, which then are not the ends of their trajectories.
    pub fn recombines(&self) -> bool {
        let Self { problem, settings, .. } = self;
        let drifts = problem.estimated_calibration().parameters.iter().any(|it| it.drift.changes());
        settings.model_error == ModelErrorTreatment::SquareRoot && (problem.model_error.is_some() || drifts)
    }

    /// Mean and spread of the members at the analysis `analyses_ago` before the newest.
    pub fn smoothed(&self, analyses_ago: usize) -> Option<Estimate> {
        let (mean, spread) = self.memory.smoother.as_ref()?.estimate(analyses_ago)?;
        let estimate = self.memory.ensemble.estimate_of(&self.problem, &self.bands, mean, spread);
        // The members' time is that of the newest analysis.
        Some(Estimate { state: estimate.state.valid_at(None), ..estimate })
    }

    /// m, the number of values of a state that this rank has.
    pub fn state_values(&self) -> usize {
        self.memory.ensemble.state_values()
    }

    /// Mean and spread of the members.
    pub fn estimate(&self) -> Estimate {
        self.memory.ensemble.estimate(&self.problem, &self.bands)
    }

    /// The factor on the background's covariance in the one analysis of all observations.
    pub fn inflation(&mut self, observed: &WhitenedObservations) -> f64 {
        let factor = &mut self.memory.variance_factors[0];
        *factor = self.settings.inflation.variance_factor(*factor, &observed.sizes());
        *factor
    }

    /// Takes an analysis of all observations in the space of the ensemble, also into the smoother; returns χ².
    pub fn transform(&mut self, analysis: Transform) -> f64 {
        if let Some(smoother) = &mut self.memory.smoother {
            let weights = analysis.earlier_weights();
            for earlier in smoother.earlier() {
                let deviations = product(earlier.perturbations.as_ref(), weights.as_ref());
                *earlier = Moments::of_transformed(std::mem::take(&mut earlier.mean), &deviations);
            }
        }
        let chi2 = analysis.chi2;
        let weights = analysis.weights(self.settings.inflation.relaxation_to_prior_perturbations);
        let background = self.memory.ensemble.moments();
        let deviations = product(background.perturbations.as_ref(), weights.as_ref());
        let analysed = Moments::of_transformed(background.mean.clone(), &deviations);
        self.set(&background, analysed);
        chi2
    }

    /// Takes the analysed members, from those of the background, and relaxes their spread.
    pub fn set(&mut self, background: &Moments, mut analysed: Moments) {
        let mut background_spread = spread(&background.perturbations);
        background_spread.truncate(self.state_values());
        self.settings.inflation.relax_spread(&background_spread, &mut analysed.perturbations);
        self.memory.ensemble.set(&analysed);
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

    /// Fails if a memory is of another ensemble.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require(&self, memory: &Memory) -> Result<(), Error> {
        let own = &self.memory;
        require(memory.variance_factors.len() == own.variance_factors.len(), "the inflation")?;
        match (&own.smoother, &memory.smoother) {
            (None, None) => Ok(()),
            (Some(own), Some(smoother)) => smoother.require(own.lag(), &memory.ensemble),
            _ => require(false, "the smoother"),
        }
    }
}
