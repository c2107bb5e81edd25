//! What a window holds beside the observations that methods see.

use crate::operator::{LinearOperator, ObservationOperator};
use crate::rejection::Rejection;
use crate::report::Report;
use crate::value_check::ValueCheck;
use isobar_model::{State, Time};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What no method sees: passive and rejected observations, and how quality control judged the values.
///
/// As in the window, the operator is not serialised.
#[derive(Clone, Serialize, Deserialize)]
pub struct Aside {
    /// The value checks of the observations that are used, in their order; nothing of those that were not checked.
    pub checks: Vec<Option<ValueCheck>>,
    /// The observations that are not used.
    pub unused: Vec<UnusedObservation>,
    /// h(x, c) of [`Aside::unused`].
    #[serde(skip, default = "no_operator")]
    pub operator: Arc<dyn ObservationOperator>,
}

/// An observation that no method sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnusedObservation {
    /// Where, what and by whom.
    pub report: Report,
    /// When it is valid.
    pub time: Time,
    /// The reported value; it may not be finite.
    pub value: f64,
    /// Standard deviation of its random error, as it claims.
    pub sigma: f64,
    /// Why it is not used.
    pub why: Unused,
    /// How its value compares with its neighbours, if that was checked.
    pub check: Option<ValueCheck>,
}

/// Why an observation is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Unused {
    /// It fails quality control.
    Rejected(Rejection),
    /// Its network is compared with the methods and not assimilated.
    Passive,
}

impl Unused {
    /// All reasons, in the order of their codes from 1.
    pub fn all() -> impl Iterator<Item = Unused> {
        Rejection::ALL.into_iter().map(Unused::Rejected).chain([Unused::Passive])
    }

    /// Its code: that of the rejection, or the next one.
    pub fn code(self) -> u8 {
        match self {
            Unused::Rejected(rejection) => rejection.code(),
            Unused::Passive => Rejection::ALL.len() as u8 + 1,
        }
    }

    /// Its name, in one word: `gross_error`, `passive`.
    pub fn name(self) -> &'static str {
        match self {
            Unused::Rejected(rejection) => rejection.name(),
            Unused::Passive => "passive",
        }
    }

    /// Why it was rejected, if it was.
    pub fn rejection(self) -> Option<Rejection> {
        match self {
            Unused::Rejected(rejection) => Some(rejection),
            Unused::Passive => None,
        }
    }
}

fn no_operator() -> Arc<dyn ObservationOperator> {
    Arc::new(LinearOperator::default())
}

impl Default for Aside {
    fn default() -> Self {
        Self { checks: Vec::new(), unused: Vec::new(), operator: no_operator() }
    }
}

impl Aside {
    /// The rejected observations, each with the reason.
    pub fn rejected(&self) -> impl Iterator<Item = (&UnusedObservation, Rejection)> {
        self.unused.iter().filter_map(|it| Some((it, it.why.rejection()?)))
    }

    /// The passive observations that pass quality control, with their places in [`Aside::unused`].
    pub fn passive(&self) -> impl Iterator<Item = (usize, &UnusedObservation)> {
        self.unused.iter().enumerate().filter(|(_, it)| it.why == Unused::Passive)
    }

    /// y − h(x, c) of [`Aside::unused`]; `None` for a value that is not finite, and where h is not known: for a place outside
    /// of the domain, and for a bias whose predictor is missing.
    ///
    /// # Panics
    /// If `x` and `calibration` are of another experiment.
    pub fn departures(&self, x: &State, calibration: &[f64]) -> Vec<Option<f64>> {
        let simulated = self.operator.simulate(x, calibration);
        let departure = |(it, simulated): (&UnusedObservation, f64)| {
            let is_known = !matches!(it.why.rejection(), Some(Rejection::Outside | Rejection::NoPredictor));
            Some(it.value - simulated).filter(|departure| is_known && departure.is_finite())
        };
        self.unused.iter().zip(simulated).map(departure).collect()
    }
}
