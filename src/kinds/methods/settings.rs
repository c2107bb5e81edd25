//! What the settings of every method can do, and the keys that methods share.

use super::work::{Sizes, Work};
use crate::kinds::Domain;
use crate::kinds::covariances::Components;
use crate::kinds::initial::InitialState;
use crate::kinds::models::Model;
use crate::reader::{Absent, Choice, Key, Limits, Whole};
use isobar_assim::{Assimilator, BiasTreatment, Error, Problem};
use isobar_model::{Duration, Time};
use std::fmt::Debug;
use std::sync::Arc;

/// The settings of a method, and what such a method can do.
pub trait MethodSettings: Debug + Send + Sync {
    /// The method as it starts.
    ///
    /// # Errors
    /// That of the method: settings that do not fit the problem, or more memory than is allowed.
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error>;

    /// What it does in a cycle, estimated from sizes alone; only the estimate of its cost depends on it.
    fn work(&self, sizes: &Sizes) -> Work;

    /// The settings in words, as they stand in tables and on pages; how biases are treated is added to them.
    fn describe(&self) -> String;

    /// Whether its gains follow from the covariances alone, so that its exact performance can be computed.
    ///
    /// # Errors
    /// Why they do not, as it stands after a colon.
    fn fixed_gain(&self) -> Result<(), &'static str>;

    /// What corrections of the model that it may estimate would be right, by their names, as far as the truth's model has a right
    /// value for them.
    fn true_corrections(&self, _truth: &Model, _methods: &Domain) -> Vec<(String, f64)> {
        Vec::new()
    }

    /// Whether its background is a forecast of the model.
    fn forecasts(&self) -> bool {
        true
    }

    /// Whether observations change its estimates.
    fn uses_observations(&self) -> bool {
        true
    }

    /// The factor on the static covariance B in which it believes; `None` for a method that forecasts its errors.
    fn static_covariance_scale(&self) -> Option<f64> {
        None
    }

    /// Whether it carries the covariance of biases with the state, and so can start from a calibration that `[initialise]`
    /// finds.
    fn carries_bias_covariance(&self) -> bool {
        false
    }

    /// Whether it can be given observations whose errors are correlated.
    ///
    /// # Errors
    /// Why it cannot, as it stands after a colon.
    fn takes_correlated_errors(&self) -> Result<(), &'static str> {
        Ok(())
    }

    /// Whether it can be given comparisons of sensors, which are observations of biases alone.
    ///
    /// # Errors
    /// Why it cannot, in a sentence.
    fn takes_comparisons(&self) -> Result<(), &'static str> {
        Ok(())
    }

    /// Whether single biases can be left as they are, or taken back to their prior, and adjusted no more.
    ///
    /// # Errors
    /// Why they cannot, in a sentence.
    fn can_freeze_biases(&self) -> Result<(), &'static str> {
        Ok(())
    }

    /// Whether the ranks of a run divide its work and its memory among them.
    fn in_bands(&self) -> bool {
        false
    }

    /// What the user should know of such a method with this model before it runs.
    fn warning(&self, _: &Model) -> Option<&'static str> {
        None
    }
}

/// What a method is built from.
pub struct Setup<'a> {
    /// Model, background, covariances and biases.
    pub problem: Problem,
    /// The number of later cycles that revise its estimates, if it has a smoother.
    pub smoother_lag_cycles: Option<usize>,
    /// Whether some observations are valid within a window, and are to be seen at their times.
    pub within_window: bool,
    /// The plane, and the model from which others can be made.
    pub domain: &'a Domain,
    /// Valid time of the background.
    pub start: Time,
    /// Length of a cycle.
    pub cycle: Duration,
}

impl Setup<'_> {
    /// A method of this problem, with a smoother if one is asked for.
    pub(super) fn smoothed<M>(
        self,
        method: impl FnOnce(Problem) -> Result<M, Error>,
        smoothing: impl FnOnce(M, usize) -> Result<M, Error>,
    ) -> Result<M, Error> {
        let method = method(self.problem)?;
        match self.smoother_lag_cycles {
            Some(lag) => smoothing(method, lag),
            None => Ok(method),
        }
    }

    /// The same, with members that see observations within a window on their own trajectories if there are such observations.
    pub(super) fn ensemble<M>(
        self,
        method: impl FnOnce(Problem) -> Result<M, Error>,
        smoothing: impl FnOnce(M, usize) -> Result<M, Error>,
        asynchronous: impl FnOnce(M) -> Result<M, Error>,
    ) -> Result<M, Error> {
        let within_window = self.within_window;
        let method = self.smoothed(method, smoothing)?;
        if within_window { asynchronous(method) } else { Ok(method) }
    }
}

/// What the rest of the scenario says that a method must fit to.
pub(crate) struct Surroundings {
    /// The plane and the model.
    pub domain: Domain,
    /// The state from which methods start.
    pub initial: Arc<dyn InitialState>,
    /// Cycles of the run.
    pub cycles: usize,
    /// Length of a cycle.
    pub cycle: Duration,
    /// Whether sensors are compared in the run.
    pub compares: bool,
    /// The key by which biases may be frozen in a run, if they may be.
    pub freezing_key: Option<&'static str>,
    /// The names of the observing systems.
    pub networks: Vec<String>,
    /// The name of one of them whose errors methods should take as correlated, if there is one.
    pub correlated: Option<String>,
    /// The components of B.
    pub background_error: Components,
    /// Those of Q, if the model makes errors.
    pub model_error: Components,
    /// Whether the model makes errors.
    pub has_model_error: bool,
    /// The shortest correlation length of the model error, or of B if there is none \[m\].
    pub error_length_m: Option<f64>,
}

pub(super) const BIAS: Key<Choice<BiasTreatment>> = Key::absent(
    "bias",
    "",
    Choice(&[
        ("estimate", BiasTreatment::Estimate),
        ("ignore", BiasTreatment::Ignore),
        ("known", BiasTreatment::Known),
    ]),
    Absent::Means(BiasTreatment::Estimate),
    "how biases are treated: estimated with the state, ignored, or taken out of the data as they truly are",
);

pub(super) const ERROR_CORRELATION: Key<Choice<bool>> = Key::absent(
    "error_correlation",
    "",
    Choice(&[("use", true), ("ignore", false)]),
    Absent::Means(true),
    "how correlated errors of observations are treated: as the networks say, or as independent",
);

/// When a method takes observations within a window to be valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FirstGuess {
    /// At their times: they are compared with the method's background then.
    AppropriateTime,
    /// At the time of the analysis.
    AnalysisTime,
}

pub(super) const FIRST_GUESS: Key<Choice<FirstGuess>> = Key::absent(
    "first_guess",
    "",
    Choice(&[("appropriate_time", FirstGuess::AppropriateTime), ("analysis_time", FirstGuess::AnalysisTime)]),
    Absent::Means(FirstGuess::AppropriateTime),
    "with which background observations within the window are compared: that of their times, or that of the analysis, as if they \
     were valid then",
);

pub(super) const COMPARISONS: Key<Choice<bool>> = Key::absent(
    "comparisons",
    "",
    Choice(&[("use", true), ("ignore", false)]),
    Absent::Means(true),
    "how [[comparisons]] of sensors are treated: as the rows on biases that they are, or as if there were none",
);

pub(super) const MEMORY_LIMIT_GB: Key<Limits> = Key::absent(
    "memory_limit_gb",
    "GB",
    Limits::Between(0.001, 10_000.0),
    Absent::Means(2.0),
    "memory that the method may use",
);

pub(super) const SMOOTHER_LAG_CYCLES: Key<Whole> = Key::absent(
    "smoother_lag_cycles",
    "cycles",
    Whole(1, 1000),
    Absent::Explained("no smoother"),
    "number of later cycles whose observations revise an estimate",
);

pub(super) const COVARIANCE_SCALE: Key<Limits> =
    Key::absent("covariance_scale", "", Limits::Positive, Absent::Means(1.0), "factor on the covariance B");
