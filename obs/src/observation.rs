//! One observation as an instrument makes it: what it sees of the state, its biases, and what it reads.

use crate::predictor::Predictor;
use crate::report::Report;
use crate::state_operator::StateOperator;
use isobar_model::{Duration, State, Time};

/// One observation as an instrument makes it, before it arrives.
#[derive(Clone, Debug)]
pub struct Observation {
    /// Where, what and by whom.
    pub report: Report,
    /// Standard deviation of the random error, in the variable's unit.
    pub sigma: f64,
    /// The random error, or the value of an observation made elsewhere.
    pub reading: Reading,
    /// What it sees of the state.
    pub state: StateOperator,
    /// Its row of G, the biases that do not depend on the state: (number of the parameter, factor).
    pub calibration_row: Vec<(usize, f64)>,
    /// The biases that depend on the state.
    pub predictors: Vec<Predictor>,
    /// Its place in a scan line, for scanning instruments.
    pub scan_line: Option<ScanLine>,
    /// The number of its report within its network and cycle; errors of a report may be correlated by distance. 0 if the
    /// network's observations are not divided into reports.
    pub report_number: usize,
    /// How long before the end of the window it is made, and compared with the state.
    pub lag: Duration,
}

/// A place in a scan line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanLine {
    /// The number of the scan line among those of a pass.
    pub number: usize,
    /// Distance from the middle of the line, along the line \[m\].
    pub across_m: f64,
}

/// What an observation reads.
#[derive(Clone, Copy, Debug)]
pub enum Reading {
    /// The truth, its bias and this random error, drawn from N(0, sigma²).
    Error(f64),
    /// What was read elsewhere.
    Recorded {
        /// The value.
        value: f64,
        /// When it is valid.
        time: Time,
        /// Whether that is not near enough to the end of the window.
        is_late: bool,
        /// Whether the value of a predictor of its bias is missing.
        lacks_predictor: bool,
    },
}

impl Reading {
    /// The recorded value, or the random error.
    pub(crate) fn value(&self) -> f64 {
        match *self {
            Reading::Error(value) | Reading::Recorded { value, .. } => value,
        }
    }

    /// Replaces that.
    pub(crate) fn set_value(&mut self, new: f64) {
        match self {
            Reading::Error(value) | Reading::Recorded { value, .. } => *value = new,
        }
    }

    /// Whether it was recorded without the value of a predictor of its bias.
    pub(crate) fn lacks_predictor(&self) -> bool {
        matches!(self, Reading::Recorded { lacks_predictor: true, .. })
    }
}

impl Observation {
    /// An observation without biases, whose random error is yet to be drawn.
    pub fn new(report: Report, sigma: f64, state: StateOperator) -> Self {
        Self {
            report,
            sigma,
            reading: Reading::Error(0.0),
            state,
            calibration_row: Vec::new(),
            predictors: Vec::new(),
            scan_line: None,
            report_number: 0,
            lag: Duration::from_seconds(0),
        }
    }

    /// The same with biases that do not depend on the state: (number of the parameter, factor).
    pub fn with_bias(self, calibration_row: impl IntoIterator<Item = (usize, f64)>) -> Self {
        Self { calibration_row: calibration_row.into_iter().collect(), ..self }
    }

    /// Its row of G + P(x).
    pub fn calibration_row_at<'a>(&'a self, x: &'a State) -> impl Iterator<Item = (usize, f64)> + 'a {
        self.calibration_row.iter().copied().chain(self.predictors.iter().map(|predictor| predictor.entry(x)))
    }

    /// (G + P(x)) c, the bias of an observation that is made here.
    ///
    /// # Panics
    /// If nothing is known of the true value of one of its parameters.
    pub(crate) fn true_bias(&self, x: &State, calibration: &[Option<f64>]) -> f64 {
        let of =
            |(column, value): (usize, f64)| value * calibration[column].expect("a bias that is made here is known");
        let fixed: f64 = self.calibration_row.iter().copied().map(of).sum();
        fixed + self.predictors.iter().map(|predictor| of(predictor.entry(x))).sum::<f64>()
    }
}

/// An observation as it arrives.
#[derive(Clone, Debug)]
pub(crate) struct Arrival {
    pub observation: Observation,
    /// The reported value.
    pub value: f64,
    /// The same without the bias that methods estimate.
    pub value_bias_removed: f64,
    /// When it is valid.
    pub time: Time,
    /// Whether methods do not see it, whatever quality control says.
    pub is_passive: bool,
    /// The number of its network in the observing system.
    pub network: usize,
}
