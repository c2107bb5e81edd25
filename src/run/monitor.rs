//! Numerical safety: whether a method's results in a cycle can be used at all.
//!
//! A method fails, and the run continues with the others, when
//!
//! - it reports an error: a forecast that blows up, a matrix that is not positive definite, a negative variance;
//! - a value of its estimates, of their claimed spread or of its departures is not finite;
//! - a state that it estimates is impossible for the model, such as a layer without thickness;
//! - it has diverged: its normalised innovation χ²/n has been above [`DIVERGED_CHI2`] in [`DIVERGED_ANALYSES`] analyses
//!   in succession, so that it misses the observations by more than ten times what it claims, and does not come back.

use crate::outcome::Outcome;
use isobar_assim::Estimate;
use isobar_model::{Model, ModelError};
use serde::{Deserialize, Serialize};

/// The normalised innovation squared per observation, expected to be 1, beyond which a filter may have diverged: more than
/// seven times the highest mean of any shipped scenario.
pub const DIVERGED_CHI2: f64 = 100.0;

/// The number of analyses with observations in succession after which the filter has diverged.
pub const DIVERGED_ANALYSES: usize = 5;

/// Why a method fails.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// An error of the method.
    #[error(transparent)]
    Method(#[from] isobar_assim::Error),
    /// A value is not finite.
    #[error("{what} is not finite: {place} is {value}")]
    NotFinite {
        /// The values, in words.
        what: String,
        /// Which of them.
        place: String,
        /// The value.
        value: f64,
    },
    /// A state that the model cannot have.
    #[error("{what} is impossible: {error}")]
    Impossible {
        /// The estimate, in words.
        what: &'static str,
        /// Why, and where.
        error: ModelError,
    },
    /// Filter divergence.
    #[error(
        "the filter has diverged: its normalised innovation χ²/n has been above {DIVERGED_CHI2} in {DIVERGED_ANALYSES} \
         analyses in succession, {chi2:.3e} in the last"
    )]
    Diverged {
        /// χ²/n of the last analysis.
        chi2: f64,
    },
    /// It panicked.
    #[error("a fault of this program within the method: {0}")]
    Panic(String),
}

/// What is remembered of a method from cycle to cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Monitor {
    /// Analyses in succession with an innovation far beyond what the method claims.
    astray: usize,
}

impl Monitor {
    /// Looks at a cycle.
    ///
    /// # Errors
    /// The first fault.
    pub fn check(&mut self, outcome: &Outcome) -> Result<(), Fault> {
        let Outcome { background, analysis, .. } = outcome;
        check_estimate(background, "the background")?;
        check_estimate(&analysis.estimate, "the analysis")?;
        for smoothed in &outcome.smoothed {
            check_estimate(&smoothed.estimate, "a smoothed estimate")?;
        }
        let observation = |number: usize| format!("that of observation {}", number + 1);
        finite(&analysis.background_departures, "a background departure", observation)?;
        finite(&analysis.analysis_departures, "an analysis departure", observation)?;
        let n = analysis.background_departures.len();
        let Some(chi2) = analysis.innovation_chi2.filter(|_| n > 0).map(|chi2| chi2 / n as f64) else { return Ok(()) };
        finite(&[chi2], "the normalised innovation", |_| "χ²/n".into())?;
        self.astray = if chi2 > DIVERGED_CHI2 { self.astray + 1 } else { 0 };
        match self.astray {
            DIVERGED_ANALYSES.. => Err(Fault::Diverged { chi2 }),
            _ => Ok(()),
        }
    }
}

/// Whether the model could start from background and analysis.
///
/// # Errors
/// [`Fault::Impossible`].
pub fn check_possible(model: &dyn Model, outcome: &Outcome) -> Result<(), Fault> {
    let states = [("the background", &outcome.background), ("the analysis", &outcome.analysis.estimate)];
    states.into_iter().try_for_each(|(what, estimate)| {
        model.check_state(&estimate.state).map_err(|error| Fault::Impossible { what, error })
    })
}

/// Whether a forecast ahead is finite, and the model could go on from it.
///
/// # Errors
/// [`Fault::NotFinite`], [`Fault::Impossible`].
pub fn check_forecast(model: Option<&dyn Model>, forecast: &Estimate) -> Result<(), Fault> {
    let what = "the forecast ahead";
    check_estimate(forecast, what)?;
    let possible = model.map_or(Ok(()), |model| model.check_state(&forecast.state));
    possible.map_err(|error| Fault::Impossible { what, error })
}

fn check_estimate(estimate: &Estimate, stage: &str) -> Result<(), Fault> {
    let Estimate { state, calibration, state_spread, calibration_spread } = estimate;
    let value = |index: usize| state.layout().describe(index);
    let parameter = |number: usize| format!("bias parameter {}", number + 1);
    finite(state.values(), stage, value)?;
    finite(calibration, stage, parameter)?;
    let spread = format!("the claimed spread of {stage}");
    finite(state_spread.as_deref().unwrap_or_default(), &spread, value)?;
    finite(calibration_spread.as_deref().unwrap_or_default(), &spread, parameter)
}

/// Fails at the first value that is not finite.
fn finite(values: &[f64], what: &str, place: impl Fn(usize) -> String) -> Result<(), Fault> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(at) => Err(Fault::NotFinite { what: what.to_string(), place: place(at), value: values[at] }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::Smoothed;
    use isobar_assim::Analysis;
    use isobar_model::{Boundary, Grid, Layout, Location, State, Variable};
    use std::sync::Arc;

    fn outcome(chi2_per_observation: f64) -> Outcome {
        let grid = Grid { nx: 4, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let variable =
            Variable { name: "h", long_name: "height", standard_name: None, unit: "m", location: Location::Center };
        let estimate = Estimate {
            state: State::zeros(&Arc::new(Layout { grid, variables: vec![variable] })),
            calibration: vec![1.0],
            state_spread: Some(vec![1.0; 16]),
            calibration_spread: None,
        };
        let analysis = Analysis {
            estimate: estimate.clone(),
            background_departures: vec![0.5; 3],
            analysis_departures: vec![0.1; 3],
            innovation_chi2: Some(3.0 * chi2_per_observation),
            partition: None,
            warnings: Vec::new(),
        };
        let smoothed = vec![Smoothed { cycles_ago: 2, estimate: estimate.clone() }];
        Outcome {
            background: estimate,
            analysis,
            smoothed,
            unused: Default::default(),
            readings: None,
            influence: None,
            verdicts: Vec::new(),
            seconds: 0.0,
        }
    }

    #[test]
    fn whatever_is_not_finite_is_named_with_its_place() {
        let fault = |spoil: &dyn Fn(&mut Outcome)| {
            let mut outcome = outcome(1.0);
            Monitor::default().check(&outcome).unwrap();
            spoil(&mut outcome);
            Monitor::default().check(&outcome).unwrap_err().to_string()
        };
        let state = fault(&|it| it.analysis.estimate.state.values_mut()[6] = f64::NAN);
        assert_eq!(state, "the analysis is not finite: h at row 1, column 2 is NaN");
        let spread = fault(&|it| it.background.state_spread.as_mut().unwrap()[0] = f64::INFINITY);
        assert_eq!(spread, "the claimed spread of the background is not finite: h at row 0, column 0 is inf");
        let departure = fault(&|it| it.analysis.analysis_departures[1] = f64::NAN);
        assert_eq!(departure, "an analysis departure is not finite: that of observation 2 is NaN");
        let smoothed = fault(&|it| it.smoothed[0].estimate.state.values_mut()[3] = f64::NEG_INFINITY);
        assert_eq!(smoothed, "a smoothed estimate is not finite: h at row 0, column 3 is -inf");
        assert!(fault(&|it| it.analysis.innovation_chi2 = Some(f64::NAN)).contains("χ²/n is NaN"));
        assert!(fault(&|it| it.analysis.estimate.calibration[0] = f64::NAN).contains("bias parameter 1"));
    }

    #[test]
    fn a_filter_has_diverged_once_it_stays_astray_and_not_before() {
        let mut monitor = Monitor::default();
        for _ in 0..DIVERGED_ANALYSES - 1 {
            monitor.check(&outcome(1e4)).unwrap();
        }
        monitor.check(&outcome(2.0)).unwrap();
        for _ in 0..DIVERGED_ANALYSES - 1 {
            monitor.check(&outcome(1e4)).unwrap();
        }
        // A cycle without observations says nothing.
        let mut silent = outcome(0.0);
        (silent.analysis.background_departures, silent.analysis.analysis_departures) = (Vec::new(), Vec::new());
        monitor.check(&silent).unwrap();
        let error = monitor.check(&outcome(1e4)).unwrap_err();
        assert_eq!(error, Fault::Diverged { chi2: 1e4 });
        assert!(error.to_string().contains("1.000e4 in the last"), "{error}");
    }
}
