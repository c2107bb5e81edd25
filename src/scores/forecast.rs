//! Scores of forecasts ahead, by lead time.
//!
//! A forecast is verified once its valid time has come: against the truth; without one against the passive observations of
//! that time, not those within the window before it; and without these against all that are used, on which no forecast
//! depends but the one of lead time 0, the analysis.
//!
//! With errors e, claimed standard deviations σ and N grid points, of each variable
//!
//! ```text
//! rmse, spread            √(Σ e²/N),  √(Σ σ²/N), squares averaged over the cases
//! anomaly_correlation     Σ f' t' / √(Σ f'² Σ t'²), averaged over the cases
//! departure               √ of the mean of (y − h)² over the observations of all cases
//! standardised_departure  mean of (y − h)² / (H P Hᵀ + R): 1 if the claims are right
//! ```
//!
//! f' and t' are the anomalies of forecast and truth: their differences from the climate, less the mean of these over the
//! domain (WMO-No. 485, Manual on the Global Data-processing and Forecasting System, appendix 2.2.34). The climate is the
//! first background, since the mean of the truth is not known ahead. In H P Hᵀ errors at the grid points of one observation
//! count as the same error, (Σ |h_i| σ_i)², and those of biases as independent: only standard deviations are kept of
//! forecasts. Intervals are those of means over successive cases, see [`super::statistics`].

use super::Values;
use super::measures::{Sum, mean_squares, squares_by_variable};
use super::statistics::{Interval, mean, root_interval};
use indexmap::IndexMap;
use isobar_assim::Estimate;
use isobar_model::{Duration, Layout, State};
use isobar_obs::{Jacobian, ObservationWindow};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The root-mean-square error.
pub const RMSE: &str = "rmse";
/// The root-mean-square claimed standard deviation.
pub const SPREAD: &str = "spread";
/// Spread divided by error.
pub const SPREAD_PER_ERROR: &str = "spread_per_error";
/// The correlation of the anomalies of forecast and truth.
pub const ANOMALY_CORRELATION: &str = "anomaly_correlation";
/// The root-mean-square departure of observations.
pub const DEPARTURE: &str = "departure";
/// The mean square of standardised departures.
pub const STANDARDISED_DEPARTURE: &str = "standardised_departure";

/// All of them, in the order of files.
pub const FORECAST_SCORES: [&str; 6] =
    [RMSE, SPREAD, SPREAD_PER_ERROR, ANOMALY_CORRELATION, DEPARTURE, STANDARDISED_DEPARTURE];

/// With what forecasts are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VerifiedBy {
    /// The truth.
    Truth,
    /// Passive observations.
    PassiveObservations,
    /// The observations that are used.
    UsedObservations,
}

impl VerifiedBy {
    /// How forecasts are verified in a world with or without a truth and passive observations.
    pub fn in_world(has_truth: bool, has_passive: bool) -> Self {
        match (has_truth, has_passive) {
            (true, _) => Self::Truth,
            (false, true) => Self::PassiveObservations,
            (false, false) => Self::UsedObservations,
        }
    }
}

/// What there is at the valid time of a forecast.
pub enum Verifying<'a> {
    /// The truth.
    Truth {
        /// The true state.
        truth: &'a State,
        /// The state from which anomalies are counted.
        climate: &'a State,
    },
    /// Observations.
    Observations {
        /// As the method receives them.
        observed: &'a ObservationWindow,
        /// Whether the passive ones count, and not those that are used.
        passive: bool,
    },
}

/// What is measured of one forecast, by the names of score and variable, `rmse.h`.
pub type Measured = IndexMap<String, Sum>;

/// Measures a forecast.
pub fn measure(estimate: &Estimate, verifying: &Verifying<'_>) -> Measured {
    let layout = estimate.state.layout();
    let mut measured = Measured::new();
    let mut put = |name: &str, sums: Vec<Sum>| {
        let named = layout.variables.iter().map(|variable| format!("{name}.{}", variable.name)).zip(sums);
        measured.extend(named.filter(|(_, sum)| sum.weight > 0.0));
    };
    if let Verifying::Truth { truth, .. } = verifying {
        let errors = estimate.state.values().iter().zip(truth.values()).map(|(value, truth)| value - truth);
        put(RMSE, mean_squares(layout, errors));
    }
    if let Some(spread) = &estimate.state_spread {
        put(SPREAD, mean_squares(layout, spread.iter().copied()));
    }
    match verifying {
        Verifying::Truth { truth, climate } => put(ANOMALY_CORRELATION, correlations(&estimate.state, truth, climate)),
        Verifying::Observations { observed, passive } => {
            let all = departures(estimate, &observed.anchored(&estimate.state), *passive);
            put(DEPARTURE, squares_by_variable(layout, all.iter().map(|it| (it.variable, it.departure))));
            let standardised = all.iter().filter_map(|it| Some((it.variable, it.departure / it.claimed?)));
            put(STANDARDISED_DEPARTURE, squares_by_variable(layout, standardised));
        }
    }
    measured
}

/// The anomaly correlation of each variable; without weight where one of them has no anomaly.
fn correlations(forecast: &State, truth: &State, climate: &State) -> Vec<Sum> {
    let cells = forecast.layout().grid.cells();
    let fields = |state: &State, number: usize| -> Vec<f64> {
        let (own, climate) = (state.field(number), climate.field(number));
        let anomalies: Vec<f64> = own.iter().zip(climate).map(|(value, climate)| value - climate).collect();
        let mean = anomalies.iter().sum::<f64>() / cells as f64;
        anomalies.into_iter().map(|anomaly| anomaly - mean).collect()
    };
    let of_variable = |number: usize| {
        let (f, t) = (fields(forecast, number), fields(truth, number));
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let total = dot(&f, &t) / (dot(&f, &f).sqrt() * dot(&t, &t).sqrt());
        if total.is_finite() { Sum { total, weight: 1.0 } } else { Sum { total: 0.0, weight: 0.0 } }
    };
    (0..forecast.layout().variables.len()).map(of_variable).collect()
}

/// How an observation departs from a forecast.
struct Departure {
    variable: usize,
    departure: f64,
    /// The standard deviation that it should have, if the forecast claims one.
    claimed: Option<f64>,
}

fn departures(estimate: &Estimate, observed: &ObservationWindow, passive: bool) -> Vec<Departure> {
    let Estimate { state, calibration, .. } = estimate;
    let operator = if passive { &observed.aside.operator } else { &observed.operator };
    // A forecast is verified by observations of its valid time only.
    let claims = (!operator.is_empty()).then(|| claims(estimate, &operator.linearize(state, calibration))).flatten();
    let claimed = |row: usize, sigma: f64| claims.as_ref().map(|claims| claims[row].hypot(sigma));
    if passive {
        let departures = observed.aside.departures(state, calibration);
        let departure = |(row, it): (usize, &isobar_obs::UnusedObservation)| {
            Some(Departure {
                variable: it.report.variable,
                departure: departures[row]?,
                claimed: claimed(row, it.sigma),
            })
        };
        return observed.aside.passive().filter(|(row, _)| operator.is_at_end(*row)).filter_map(departure).collect();
    }
    let simulated = operator.simulate(state, calibration);
    let departure = |(row, report): (usize, &isobar_obs::Report)| Departure {
        variable: report.variable,
        departure: observed.values[row] - simulated[row],
        claimed: claimed(row, observed.sigma[row]),
    };
    observed
        .reports
        .iter()
        .enumerate()
        .filter(|(row, _)| operator.is_at_end(*row))
        .map(departure)
        .filter(|it| it.departure.is_finite())
        .collect()
}

/// The claimed standard deviation of what each observation would be without its random error.
fn claims(estimate: &Estimate, jacobian: &Jacobian) -> Option<Vec<f64>> {
    let spread = estimate.state_spread.as_ref()?;
    let of_bias = |parameter: usize| {
        estimate.calibration_spread.as_ref().and_then(|all| all.get(parameter)).copied().unwrap_or(0.0)
    };
    let of_row = |row: usize| {
        let state: f64 = jacobian.state.row(row).iter().map(|&(index, weight)| weight.abs() * spread[index]).sum();
        let biases = jacobian.calibration.row(row).iter().map(|&(index, weight)| weight * of_bias(index));
        biases.fold(state, f64::hypot)
    };
    Some((0..jacobian.rows()).map(of_row).collect())
}

/// The scores of one forecast.
pub fn values(measured: &Measured) -> Values {
    let value = |(key, sum): (&String, &Sum)| (key.clone(), average(key, std::slice::from_ref(sum)).value);
    measured.iter().map(value).collect()
}

/// What is gathered of the forecasts of one method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForecastSums {
    /// By lead time in cycles.
    leads: BTreeMap<usize, LeadSums>,
    /// Forecasts that could not be made to their end.
    failed: usize,
}

/// What is gathered at one lead time: what was measured of each case, in the order of their starts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct LeadSums {
    cases: usize,
    measured: IndexMap<String, Vec<Sum>>,
}

impl ForecastSums {
    /// Takes a forecast.
    pub fn add(&mut self, lead_cycles: usize, measured: &Measured) {
        let lead = self.leads.entry(lead_cycles).or_default();
        lead.cases += 1;
        measured.iter().for_each(|(key, sum)| lead.measured.entry(key.clone()).or_default().push(*sum));
    }

    /// Takes note of a forecast that could not be made to its end.
    pub fn add_failed(&mut self) {
        self.failed += 1;
    }

    /// The scores; `None` without any forecast.
    pub fn scores(&self, layout: &Layout, window: Duration, by: VerifiedBy) -> Option<ForecastScores> {
        let lead = |(&cycles, sums): (&usize, &LeadSums)| LeadScores {
            lead_hours: (window * cycles).hours(),
            cases: sums.cases,
            scores: sums.scores(layout),
        };
        let leads: Vec<LeadScores> = self.leads.iter().map(lead).collect();
        (!leads.is_empty() || self.failed > 0).then_some(ForecastScores { verified_by: by, failed: self.failed, leads })
    }
}

impl LeadSums {
    fn scores(&self, layout: &Layout) -> IndexMap<String, IndexMap<String, Known>> {
        let mut all: IndexMap<String, IndexMap<String, Known>> = IndexMap::new();
        for name in FORECAST_SCORES {
            for variable in &layout.variables {
                let found = |name: &str| {
                    let key = format!("{name}.{}", variable.name);
                    self.measured.get(&key).map(|sums| average(&key, sums))
                };
                let known = if name == SPREAD_PER_ERROR {
                    let ratio = found(SPREAD).zip(found(RMSE)).map(|(spread, error)| spread.value / error.value);
                    ratio.filter(|ratio| ratio.is_finite()).map(|value| Known { value, interval: None })
                } else {
                    found(name)
                };
                if let Some(known) = known {
                    all.entry(name.into()).or_default().insert(variable.name.into(), known);
                }
            }
        }
        all
    }
}

/// The average of what was measured, which has cases with some weight.
fn average(key: &str, sums: &[Sum]) -> Known {
    let [total, weight] =
        [|sum: &Sum| sum.total, |sum: &Sum| sum.weight].map(|part| sums.iter().map(part).sum::<f64>());
    let of_cases: Vec<f64> = sums.iter().map(|sum| sum.total / sum.weight).collect();
    let is_root = [RMSE, SPREAD, DEPARTURE].iter().any(|name| key.split('.').next() == Some(*name));
    if is_root {
        Known { value: (total / weight).sqrt(), interval: root_interval(&of_cases) }
    } else {
        Known { value: total / weight, interval: mean(&of_cases).and_then(|mean| mean.interval()) }
    }
}

/// The scores of the forecasts ahead of one method over a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ForecastScores {
    /// With what they are compared.
    pub verified_by: VerifiedBy,
    /// Forecasts that could not be made to their end; their scores are those up to there.
    pub failed: usize,
    /// The lead times that have cases, from 0, the analysis.
    pub leads: Vec<LeadScores>,
}

/// The scores at one lead time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeadScores {
    /// The lead time \[h\].
    pub lead_hours: f64,
    /// Number of forecasts.
    pub cases: usize,
    /// By the names of [`FORECAST_SCORES`] and of the variables.
    #[serde(flatten)]
    pub scores: IndexMap<String, IndexMap<String, Known>>,
}

/// A figure, and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Known {
    /// The figure.
    pub value: f64,
    /// Its 95 % interval; none of too few independent cases.
    pub interval: Option<Interval>,
}

impl LeadScores {
    /// A score of a variable.
    pub fn score(&self, name: &str, variable: &str) -> Option<&Known> {
        self.scores.get(name)?.get(variable)
    }
}

impl ForecastScores {
    /// The scores at a lead time \[h\], if there are cases.
    pub fn at(&self, lead_hours: f64) -> Option<&LeadScores> {
        self.leads.iter().find(|lead| (lead.lead_hours - lead_hours).abs() < 1e-9)
    }
}
