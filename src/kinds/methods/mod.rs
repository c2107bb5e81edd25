//! `[methods.NAME]`: the data-assimilation methods that run side by side.

mod adapt;
mod banded_kalman;
mod climatology;
mod common_factors;
mod enkf;
mod ensemble;
mod etkf;
mod fast_kalman;
mod federated;
mod federated_fast;
mod four_d_var;
mod free;
mod hybrid;
mod kalman;
mod letkf;
mod local_factors;
mod optimal_interpolation;
mod serial_kalman;
mod settings;
mod three_d_var;
mod time_volume;
mod variational;
mod work;

pub use adapt::Adapt;
pub use settings::{FirstGuess, MethodSettings, Setup};
pub use work::{Sizes, Work};

use super::{Domain, Kinds, choose};
use crate::reader::{Field, Read, Section};
use isobar_assim::{Assimilator, BiasTreatment, Error, Problem, Whitened};
use isobar_model::{Duration, Time};
pub(crate) use settings::Surroundings;
use settings::{
    BIAS, COMPARISONS, COVARIANCE_SCALE, ERROR_CORRELATION, FIRST_GUESS, MEMORY_LIMIT_GB, SMOOTHER_LAG_CYCLES,
};
use std::sync::Arc;

/// All kinds of methods.
pub(crate) const METHODS: &Kinds<dyn MethodSettings, Surroundings> = &[
    &free::KIND,
    &climatology::KIND,
    &optimal_interpolation::KIND,
    &three_d_var::KIND,
    &four_d_var::KIND,
    &hybrid::KIND,
    &kalman::KIND,
    &serial_kalman::KIND,
    &banded_kalman::KIND,
    &federated::KIND,
    &federated_fast::KIND,
    &fast_kalman::KIND,
    &time_volume::KIND,
    &etkf::KIND,
    &letkf::KIND,
    &enkf::KIND,
];

/// A method with its settings.
#[derive(Clone, Debug)]
pub struct Method {
    /// What the scenario calls its kind.
    pub kind: &'static str,
    /// How it treats the observations' biases.
    pub bias: BiasTreatment,
    /// Whether it takes correlated errors of observations as such.
    pub uses_error_correlation: bool,
    /// When it takes observations within a window to be valid.
    pub first_guess: FirstGuess,
    /// Whether it takes comparisons of sensors.
    pub uses_comparisons: bool,
    /// Which errors it estimates from its innovations, if any.
    pub adapt: Option<Adapt>,
    /// The number of later cycles that revise its estimates, if it has a smoother.
    pub smoother_lag_cycles: Option<usize>,
    /// Memory that it may use.
    pub memory_limit_bytes: u64,
    /// What it does.
    pub settings: Arc<dyn MethodSettings>,
}

/// Reads a method.
pub(crate) fn read(field: &Field<'_>, surroundings: &Surroundings) -> Read<Method> {
    let (kind, section) = choose(field, METHODS, surroundings)?;
    let settings: Arc<dyn MethodSettings> = (kind.read)(&section, surroundings)?.into();
    let bias = if settings.uses_observations() { section.get(&BIAS)? } else { BiasTreatment::Ignore };
    if let (Err(reason), Some(key), BiasTreatment::Estimate) =
        (settings.can_freeze_biases(), surroundings.freezing_key, bias)
    {
        let help = format!("choose another kind of method, or leave out `{key}`");
        return Err(section.required("kind")?.misplaced(reason.into(), &help));
    }
    let uses_comparisons = settings.uses_observations() && section.get(&COMPARISONS)?;
    if let (true, Err(reason), BiasTreatment::Estimate) =
        (uses_comparisons && surroundings.compares, settings.takes_comparisons(), bias)
    {
        let help = "choose another kind of method, or give `comparisons = \"ignore\"`";
        return Err(section.required("kind")?.misplaced(format!("it cannot take [[comparisons]]: {reason}"), help));
    }
    let uses_error_correlation = settings.uses_observations() && section.get(&ERROR_CORRELATION)?;
    if let (true, Some(network), Err(reason)) =
        (uses_error_correlation, &surroundings.correlated, settings.takes_correlated_errors())
    {
        let message =
            format!("the errors of network {network} are correlated, which this method cannot take: {reason}");
        let help = "choose another kind of method, or give `error_correlation = \"ignore\"`";
        return Err(section.required("kind")?.misplaced(message, help));
    }
    let first_guess = if settings.uses_observations() {
        section.get(&FIRST_GUESS)?
    } else if settings.forecasts() {
        FirstGuess::AppropriateTime
    } else {
        // What never changes is the same at all times.
        FirstGuess::AnalysisTime
    };
    Ok(Method {
        kind: kind.name,
        bias,
        uses_error_correlation,
        first_guess,
        uses_comparisons,
        adapt: adapt::read(&section, settings.static_covariance_scale().is_some(), surroundings.has_model_error)?,
        smoother_lag_cycles: smoother_lag_cycles(&section, surroundings.freezing_key)?,
        memory_limit_bytes: (section.get(&MEMORY_LIMIT_GB)? * 1e9) as u64,
        settings,
    })
}

fn smoother_lag_cycles(section: &Section<'_>, freezing_key: Option<&str>) -> Read<Option<usize>> {
    if let (Some(field), Some(key)) = (section.optional(SMOOTHER_LAG_CYCLES.name), freezing_key) {
        let message = "a smoother would go on adjusting the biases that [stability] freezes".to_string();
        return Err(field.misplaced(message, &format!("leave out this key or `{key}`")));
    }
    section.find(&SMOOTHER_LAG_CYCLES)
}

impl Method {
    /// What the method does in a cycle of these sizes, estimated.
    pub fn work(&self, sizes: &Sizes) -> Work {
        let work = self.settings.work(sizes);
        // A smoother holds what each past analysis had, and revises it: about one filter's work in matrices again.
        let lag = self.smoother_lag_cycles.map_or(0.0, |lag| lag as f64);
        let kept = if self.settings.carries_bias_covariance() { 0.5 } else { 0.25 };
        Work { numbers: work.numbers * (1.0 + kept * lag), ..work }
    }

    /// Whether the method estimates biases from observations.
    pub fn estimates_biases(&self) -> bool {
        self.bias == BiasTreatment::Estimate && self.settings.uses_observations()
    }

    /// Whether its biases are scored: not where they are known to it, or it has none.
    pub fn scores_biases(&self) -> bool {
        self.bias != BiasTreatment::Known && self.settings.uses_observations()
    }

    /// Whether it can start from a calibration that `[initialise]` finds.
    pub fn can_be_initialised(&self) -> bool {
        self.bias == BiasTreatment::Estimate && self.settings.carries_bias_covariance()
    }

    /// Why it has no gains that follow from the covariances alone; `None` if it has.
    pub fn without_fixed_gain(&self) -> Option<&'static str> {
        let adapts = self.adapt.map(|_| "it adapts its errors to the data");
        adapts.or(self.settings.fixed_gain().err())
    }

    /// Why the ranks of a run cannot divide it among them; `None` if they can.
    pub fn why_undivided(&self) -> Option<String> {
        if !self.settings.in_bands() {
            Some(format!("kind = \"{}\"", self.kind))
        } else if self.smoother_lag_cycles.is_some() {
            Some("its smoother".into())
        } else {
            self.adapt.map(|_| "`adapt`".into())
        }
    }

    /// The method as it starts, with factors on its errors' covariances if it adapts them; `within_window`: for observations some of
    /// which are valid within a window.
    ///
    /// # Errors
    /// That of the method.
    pub fn build(
        &self,
        ground: &Problem,
        domain: &Domain,
        start: Time,
        cycle: Duration,
        within_window: bool,
    ) -> Result<Box<dyn Assimilator>, Error> {
        let problem = Problem { bias: self.bias, memory_limit_bytes: self.memory_limit_bytes, ..ground.clone() };
        if self.estimates_biases() {
            let p = problem.calibration.len();
            // Of the method, its prior, and what is asked of it and made of that at the end.
            problem.require_memory(4.0 * (p as f64).powi(2), || format!("the covariance of {p} biases"))?;
        }
        let smoother_lag_cycles = self.smoother_lag_cycles;
        let within_window = within_window && self.first_guess == FirstGuess::AppropriateTime;
        let method =
            self.settings.build(Setup { problem, smoother_lag_cycles, within_window, domain, start, cycle })?;
        let method = match &self.adapt {
            Some(adapt) => adapt.around(method, ground, self.settings.static_covariance_scale())?,
            None => method,
        };
        Ok(if self.uses_error_correlation { Box::new(Whitened::new(method)) } else { method })
    }

    /// The settings in words.
    pub fn describe(&self) -> String {
        let mut words = self.settings.describe();
        if let Some(lag) = self.smoother_lag_cycles {
            words += &format!(", with a smoother of lag {lag} cycles");
        }
        if self.settings.uses_observations() {
            words += match self.bias {
                BiasTreatment::Estimate => ", biases estimated",
                BiasTreatment::Ignore => ", biases ignored",
                BiasTreatment::Known => ", biases known",
            };
            if !self.uses_error_correlation {
                words += ", error correlations ignored";
            }
            if self.first_guess == FirstGuess::AnalysisTime {
                words += ", all observations taken as valid at the analysis";
            }
            if !self.uses_comparisons {
                words += ", comparisons ignored";
            }
        }
        if let Some(adapt) = &self.adapt {
            words += &format!(", {}", adapt.describe(self.settings.static_covariance_scale().is_some()));
        }
        words
    }
}
