//! The observations of one cycle, as a method receives them.

use crate::aside::{Aside, UnusedObservation};
use crate::comparison::{SensorComparison, WithComparisons};
use crate::error_regression::ErrorRegression;
use crate::operator::{LinearOperator, ObservationOperator, TimedObservations};
use crate::report::{ObservationType, Report};
use crate::within_window::WithinWindow;
use isobar_model::{Duration, Grid, Layout, State, Time};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::convert::Infallible;
use std::sync::Arc;

/// All observations of one cycle, as its end sees them.
///
/// Its operator is not serialised; a window that has been read back has one of no observations.
#[derive(Clone, Serialize, Deserialize)]
pub struct ObservationWindow {
    /// The valid time of the observations and of the analysis.
    pub time: Time,
    /// Number of the cycle, from 1.
    pub cycle: usize,
    /// Where, what and by whom.
    pub reports: Vec<Report>,
    /// When each is valid: at the end of the window, but for those of a file within its tolerance and those of networks that
    /// observe within the window.
    pub times: Vec<Time>,
    /// The reported values, with their biases.
    pub values: Vec<f64>,
    /// Standard deviation of each random error.
    pub sigma: Vec<f64>,
    /// How the errors depend on each other, as methods assume.
    pub error_regression: ErrorRegression,
    /// What was reported as well, but is not used: no method sees it.
    pub aside: Aside,
    /// Comparisons of sensors and test points of this cycle, which are no observations.
    pub comparisons: Vec<SensorComparison>,
    /// h(x, c) of these observations.
    #[serde(skip, default = "no_operator")]
    pub operator: Arc<dyn ObservationOperator>,
}

fn no_operator() -> Arc<dyn ObservationOperator> {
    Arc::new(LinearOperator::default())
}

impl ObservationWindow {
    /// Number of observations.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether nothing was reported.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Whether all observations are complete and of variables of this layout; those read from a file may not be.
    pub fn fits(&self, layout: &Layout) -> bool {
        let mut reports = self.reports.iter().chain(self.aside.unused.iter().map(|unused| &unused.report));
        self.reports.len() == self.len()
            && self.sigma.len() == self.len()
            && self.times.len() == self.len()
            && self.error_regression.fits(self.len())
            && self.comparisons.iter().all(|it| it.sigma > 0.0)
            && reports.all(|report| report.variable < layout.variables.len())
    }

    /// The observations and below them, as observations of c alone with the place of the domain's middle, the comparisons.
    pub fn with_comparisons_below(&self, grid: &Grid) -> Self {
        let mut all = self.clone();
        let comparisons = std::mem::take(&mut all.comparisons);
        let report = Report {
            network: "comparisons".into(),
            platform: "".into(),
            variable: 0,
            x_m: 0.5 * grid.width_m(),
            y_m: 0.5 * grid.height_m(),
            scan: None,
        };
        all.reports.extend(comparisons.iter().map(|_| report.clone()));
        all.times.extend(comparisons.iter().map(|_| all.time));
        all.values.extend(comparisons.iter().map(|it| it.value));
        all.sigma.extend(comparisons.iter().map(|it| it.sigma));
        all.error_regression = all.error_regression.with_independent(comparisons.len());
        let observed = all.operator;
        let below = |observed: &Arc<dyn ObservationOperator>| -> Arc<dyn ObservationOperator> {
            Arc::new(WithComparisons { observed: Arc::clone(observed), comparisons: comparisons.clone() })
        };
        all.operator = match observed.within_window() {
            None => below(&observed),
            Some(TimedObservations { whole, lags, shift }) => {
                let lags = lags.iter().copied().chain(comparisons.iter().map(|_| Duration::from_seconds(0)));
                let shift = shift.iter().copied().chain(comparisons.iter().map(|_| 0.0));
                Arc::new(WithinWindow::new(below(whole), lags.collect(), shift.collect()))
            }
        };
        all
    }

    /// The types of the observations, and which observation is of which type.
    pub fn types(&self) -> ObservationTypes {
        let mut types: Vec<ObservationType> = Vec::new();
        let of_report = |report: &Report| {
            let is_known =
                |known: &ObservationType| known.variable == report.variable && known.network == report.network;
            types.iter().position(is_known).unwrap_or_else(|| {
                types.push(report.observation_type());
                types.len() - 1
            })
        };
        let of_observation = self.reports.iter().map(of_report).collect();
        ObservationTypes { types, of_observation }
    }

    /// The same observations with bias predictors that are those of a background:
    /// [`anchored`](ObservationOperator::anchored).
    pub fn anchored(&self, background: &State) -> Cow<'_, Self> {
        let [of_used, of_unused] = [&self.operator, &self.aside.operator].map(|it| it.anchored(background));
        if of_used.is_none() && of_unused.is_none() {
            return Cow::Borrowed(self);
        }
        let mut anchored = self.clone();
        if let Some(operator) = of_used {
            anchored.operator = operator;
        }
        if let Some(operator) = of_unused {
            anchored.aside.operator = operator;
        }
        Cow::Owned(anchored)
    }

    /// Whether some are valid before the end of the window, and are compared with the state then.
    pub fn is_within_window(&self) -> bool {
        [&self.operator, &self.aside.operator].iter().any(|operator| operator.within_window().is_some())
    }

    /// The same observations as if all were valid at the end of the window.
    pub fn at_end(&self) -> Cow<'_, Self> {
        let whole = |within: TimedObservations<'_>| Ok::<_, Infallible>(Arc::clone(within.whole));
        self.seen_by(whole).unwrap_or_else(|never| match never {})
    }

    /// The same observations as seen from a background at their times: `shift` gives δ of those of an operator,
    /// [`WithinWindow`].
    ///
    /// # Errors
    /// Those of `shift`.
    pub fn at_appropriate_time<E>(
        &self,
        mut shift: impl FnMut(TimedObservations<'_>) -> Result<Vec<f64>, E>,
    ) -> Result<Cow<'_, Self>, E> {
        self.seen_by(|within| {
            Ok(Arc::new(WithinWindow::new(Arc::clone(within.whole), within.lags.to_vec(), shift(within)?)))
        })
    }

    /// The same observations with another operator wherever some are valid before the end of the window.
    fn seen_by<E>(
        &self,
        mut operator: impl FnMut(TimedObservations<'_>) -> Result<Arc<dyn ObservationOperator>, E>,
    ) -> Result<Cow<'_, Self>, E> {
        if !self.is_within_window() {
            return Ok(Cow::Borrowed(self));
        }
        let mut seen = self.clone();
        for own in [&mut seen.operator, &mut seen.aside.operator] {
            if let Some(within) = own.within_window() {
                *own = operator(within)?;
            }
        }
        Ok(Cow::Owned(seen))
    }

    /// The same observations with other values: those of the observations that are used, then of the others.
    ///
    /// # Panics
    /// If there are fewer values than observations.
    pub fn with_values(&self, values: &[f64]) -> Self {
        let (used, unused) = values.split_at(self.len());
        let with_value = |(it, value): (&UnusedObservation, &f64)| UnusedObservation { value: *value, ..it.clone() };
        let unused = self.aside.unused.iter().zip(unused).map(with_value).collect();
        Self { values: used.to_vec(), aside: Aside { unused, ..self.aside.clone() }, ..self.clone() }
    }
}

/// The types of a window's observations.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationTypes {
    /// The types, in the order of their first observations.
    pub types: Vec<ObservationType>,
    /// Number of the type of each observation, an index of `types`.
    pub of_observation: Vec<usize>,
}
