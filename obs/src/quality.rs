//! Quality control of observations before any method sees them: the same decisions for all methods, and no truth in them.
//!
//! First what a report says of itself: not finite, outside of the domain, late, without a predictor of its bias, a duplicate. Then its value, against a
//! *reference* x_f that no method makes (a forecast without observations) and against its neighbours: with
//! `d = y − h(x_f)` and the covariance that departures should have,
//!
//! ```text
//! S_ij = s² exp(−r_ij² / 2L²) + Σ_p G_ip G_jp σ_p² + δ_ij σ_i²
//! ```
//!
//! (G with the bias predictors of x_f; s² from the departures' own median, L given, σ_p the prior of bias parameter p),
//! every observation is predicted from its nearest neighbours N of the same variable:
//!
//! ```text
//! r_i = d_i − S_iN S_NN⁻¹ d_N       v_i = S_ii − S_iN S_NN⁻¹ S_Ni       z_i = r_i / √v_i
//! ```
//!
//! (Lorenc 1981, Mon. Wea. Rev. 109, 701–721). Of the observations with |z| above the limit the worst among its
//! neighbours is rejected, then its neighbours are looked at again without it: a gross error makes its neighbours look wrong,
//! too. The limit grows with the median of |z|, so that a wrong s or L costs power and not good observations.
//!
//! A median is no scale where half of the departures or more are gross, as those of a single observation may be: |z| would be
//! 0.67 whatever it says. So s is bounded by what is expected of a forecast without observations,
//!
//! ```text
//! s ≤ (3 − 2/n) e,    e² = σ_x² + (mean square of x_f about its mean over the domain),
//! ```
//!
//! with σ_x what the experiment assumes of the forecast's errors: such a forecast is in the end as wrong as a state drawn from
//! the climate. A single observation says nothing of the scale, so that s is at most e itself; many good ones may say that the
//! errors are up to three times as large. The limit grows by at most as much.
//!
//! Passive observations are judged by those that are used, and judge none: neither s nor the limit nor any prediction is from
//! them.

use crate::calibration::Calibration;
use crate::observation::{Arrival, Observation, Reading};
use crate::rejection::Rejection;
use crate::value_check::ValueCheck;
use crate::window_states::WindowStates;
use isobar_model::{Boundary, Duration, Grid, State, Time};
use std::collections::HashSet;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// How the values of observations are checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QualityControl {
    /// L: how far the errors of a forecast without observations resemble each other \[m\].
    pub length_m: f64,
    /// The least limit of |z|.
    pub limit: f64,
}

/// A forecast that no method makes, with which the values of observations are compared.
#[derive(Clone, Copy, Debug)]
pub struct Reference<'a> {
    /// x_f.
    pub states: WindowStates<'a>,
    /// σ_x of each variable, in its unit; nothing where it is not known, and departures are their own scale.
    pub sigma: &'a [f64],
}

/// The default limit of |z|: one good observation in 16 000 is beyond it.
pub const LIMIT: f64 = 4.0;

/// Neighbours that predict an observation.
const NEIGHBOURS: usize = 16;

/// How many ranges of the reference, or usual departures from it, a value may be beyond it.
const ABSURD: f64 = 20.0;

/// The median of |z| for a standard normal z.
const NORMAL_MEDIAN: f64 = 0.674_489_750_196_081_7;

/// What a report says of itself: the rejection of each, where there is one.
pub(crate) fn check_reports(arrivals: &[Arrival], time: Time, grid: &Grid) -> Vec<Option<Rejection>> {
    let mut seen: HashSet<(Arc<str>, Arc<str>, usize, Duration)> = HashSet::new();
    let check = |arrival: &Arrival| {
        let Arrival { observation, value, time: valid, .. } = arrival;
        let report = &observation.report;
        let is_late = match observation.reading {
            Reading::Error(_) => *valid + observation.lag != time,
            Reading::Recorded { time, is_late, .. } => is_late || *valid != time,
        };
        if !value.is_finite() || !observation.sigma.is_finite() {
            Some(Rejection::NotFinite)
        } else if !grid.contains(report.x_m, report.y_m) {
            Some(Rejection::Outside)
        } else if is_late {
            Some(Rejection::Late)
        } else if observation.reading.lacks_predictor() {
            Some(Rejection::NoPredictor)
        } else if !seen.insert((
            Arc::clone(&report.network),
            Arc::clone(&report.platform),
            report.variable,
            observation.lag,
        )) {
            Some(Rejection::Duplicate)
        } else {
            None
        }
    };
    arrivals.iter().map(check).collect()
}

impl QualityControl {
    /// Checks the values of the observations that are not rejected yet; what is found of each.
    pub(crate) fn check_values(
        &self,
        arrivals: &[Arrival],
        reference: Reference<'_>,
        calibration: &Calibration,
        rejections: &mut [Option<Rejection>],
    ) -> Vec<Option<ValueCheck>> {
        let Reference { states, sigma } = reference;
        let reference = states.end();
        let mut checks = vec![None; arrivals.len()];
        for variable in 0..reference.layout().variables.len() {
            let of_variable = |&number: &usize| {
                rejections[number].is_none() && arrivals[number].observation.report.variable == variable
            };
            let numbers: Vec<usize> = (0..arrivals.len()).filter(of_variable).collect();
            let expected = sigma.get(variable).map(|sigma| sigma.hypot(reference.variability(variable)));
            let expected = expected.filter(|expected| *expected > 0.0).unwrap_or(f64::INFINITY);
            let judges = numbers.iter().filter(|&&number| !arrivals[number].is_passive).copied().collect::<Vec<_>>();
            if judges.is_empty() && expected.is_infinite() {
                continue;
            }
            let limits = sane_values(arrivals, &judges, states, variable, expected, calibration);
            let (sane, absurd): (Vec<usize>, Vec<usize>) =
                numbers.into_iter().partition(|&number| limits.contains(&arrivals[number].value));
            for number in absurd {
                rejections[number] = Some(Rejection::Absurd);
                let departure = departure(&arrivals[number], states);
                let predicted = arrivals[number].value - departure;
                let z = departure / expected.hypot(arrivals[number].observation.sigma);
                checks[number] = expected.is_finite().then_some(ValueCheck { predicted, z, neighbours: 0 });
            }
            if sane.is_empty() {
                continue;
            }
            let of_variable: Vec<&Arrival> = sane.iter().map(|&number| &arrivals[number]).collect();
            let departures = Departures::new(self, &of_variable, states, calibration, expected);
            for (&number, (check, is_good)) in sane.iter().zip(departures.judge(self.limit)) {
                checks[number] = Some(check);
                rejections[number] = (!is_good).then_some(Rejection::GrossError);
            }
        }
        checks
    }
}

/// By how much the departures of a number of observations may exceed what is expected.
fn largest_factor(observations: usize) -> f64 {
    3.0 - 2.0 / observations.max(1) as f64
}

/// The values that a variable could have, as the observations of these numbers tell.
fn sane_values(
    arrivals: &[Arrival],
    numbers: &[usize],
    states: WindowStates<'_>,
    variable: usize,
    expected: f64,
    calibration: &Calibration,
) -> RangeInclusive<f64> {
    let reference = states.end();
    let field = reference.field(variable);
    let (low, high) =
        field.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)));
    let departures: Vec<f64> = numbers.iter().map(|&number| departure(&arrivals[number], states).abs()).collect();
    // Without the state's part: random errors and biases.
    let known = |&number: &usize| {
        let Observation { sigma, .. } = arrivals[number].observation;
        let row = arrivals[number].observation.calibration_row_at(reference);
        let of_biases = row.map(|(p, g)| (g * calibration.parameters[p].sigma_prior).powi(2));
        (sigma * sigma + of_biases.sum::<f64>()).sqrt()
    };
    let largest = expected.hypot(numbers.iter().map(known).fold(0.0, f64::max)) * largest_factor(numbers.len());
    let usual = if departures.is_empty() { largest } else { (median(departures) / NORMAL_MEDIAN).min(largest) };
    let margin = ABSURD * (high - low).max(high.abs()).max(low.abs()).max(usual);
    low - margin..=high + margin
}

/// d of an observation, at its time.
fn departure(arrival: &Arrival, reference: WindowStates<'_>) -> f64 {
    let Observation { state, lag, .. } = &arrival.observation;
    arrival.value - reference.value(*lag, |x| state.value(x))
}

/// The departures of one variable's observations from the reference, and how they should vary together.
struct Departures<'a> {
    arrivals: &'a [&'a Arrival],
    grid: &'a Grid,
    calibration: &'a Calibration,
    length_m: f64,
    /// G of each, predictors being those of the reference.
    calibration_rows: Vec<Vec<(usize, f64)>>,
    /// d.
    departures: Vec<f64>,
    /// Whether each judges others: whether it is not passive.
    is_judge: Vec<bool>,
    /// s².
    variance: f64,
    /// Whether something else than the departures says how large they may be.
    is_bounded: bool,
    /// The nearest neighbours of each, the nearest first.
    neighbours: Vec<Vec<usize>>,
}

impl<'a> Departures<'a> {
    fn new(
        control: &QualityControl,
        arrivals: &'a [&'a Arrival],
        states: WindowStates<'a>,
        calibration: &'a Calibration,
        expected: f64,
    ) -> Self {
        let departures: Vec<f64> = arrivals.iter().map(|arrival| departure(arrival, states)).collect();
        let reference: &'a State = states.end();
        let (grid, length_m) = (&reference.layout().grid, control.length_m);
        let calibration_rows =
            arrivals.iter().map(|arrival| arrival.observation.calibration_row_at(reference).collect()).collect();
        let is_judge: Vec<bool> = arrivals.iter().map(|arrival| !arrival.is_passive).collect();
        let (variance, is_bounded, neighbours) = (0.0, expected.is_finite(), Vec::new());
        let mut all = Self {
            arrivals,
            grid,
            calibration,
            length_m,
            calibration_rows,
            departures,
            is_judge,
            variance,
            is_bounded,
            neighbours,
        };
        let judges: Vec<usize> = (0..arrivals.len()).filter(|&i| all.is_judge[i]).collect();
        let total = (median(judges.iter().map(|&i| all.departures[i].abs()).collect()) / NORMAL_MEDIAN).powi(2);
        let known = median(judges.iter().map(|&i| all.covariance(i, i)).collect());
        let found = if judges.is_empty() { f64::INFINITY } else { (total - known).max(0.25 * total) };
        all.variance = found.min((largest_factor(judges.len()) * expected).powi(2));
        all.neighbours = all.nearest();
        all
    }

    /// What is found of each, and whether it is good.
    fn judge(&self, limit: f64) -> Vec<(ValueCheck, bool)> {
        let n = self.arrivals.len();
        let judges = self.is_judge.iter().filter(|&&is_judge| is_judge).count();
        let largest_factor = if self.is_bounded { largest_factor(judges) } else { f64::INFINITY };
        let mut is_good = self.is_judge.clone();
        let mut checks: Vec<ValueCheck> = (0..n).map(|i| self.check(i, &is_good)).collect();
        loop {
            let scores: Vec<f64> = checks.iter().map(|check| check.z.abs()).collect();
            let good = (0..n).filter(|&i| is_good[i]).map(|i| scores[i]).collect();
            let limit = limit * (median(good) / NORMAL_MEDIAN).min(largest_factor).max(1.0);
            // Ties go to the first one.
            let is_worse = |i: usize, j: usize| scores[i] > scores[j] || (scores[i] == scores[j] && i < j);
            let is_worst = |&i: &usize| {
                is_good[i] && scores[i] > limit && self.neighbours[i].iter().all(|&j| !is_good[j] || is_worse(i, j))
            };
            let worst: Vec<usize> = (0..n).filter(is_worst).collect();
            if worst.is_empty() {
                let passes = |i: usize| is_good[i] || (!self.is_judge[i] && scores[i] <= limit);
                return checks.iter().enumerate().map(|(i, check)| (*check, passes(i))).collect();
            }
            worst.iter().for_each(|&i| is_good[i] = false);
            for i in 0..n {
                // What is rejected keeps what it was rejected for.
                let is_open = is_good[i] || !self.is_judge[i];
                if is_open && self.neighbours[i].iter().any(|j| worst.contains(j)) {
                    checks[i] = self.check(i, &is_good);
                }
            }
        }
    }

    /// An observation beside those of its neighbours that are good.
    fn check(&self, i: usize, is_good: &[bool]) -> ValueCheck {
        let from: Vec<usize> = self.neighbours[i].iter().copied().filter(|&j| is_good[j]).collect();
        let n = from.len();
        // The Cholesky factor L of S_NN, row by row, then w = L⁻¹ S_Ni and e = L⁻¹ d_N.
        let mut factor = vec![0.0; n * n];
        let (mut weights, mut whitened) = (vec![0.0; n], vec![0.0; n]);
        for row in 0..n {
            for column in 0..=row {
                let sum: f64 = (0..column).map(|k| factor[row * n + k] * factor[column * n + k]).sum();
                let rest = self.covariance(from[row], from[column]) - sum;
                factor[row * n + column] =
                    if row == column { rest.max(f64::MIN_POSITIVE).sqrt() } else { rest / factor[column * n + column] };
            }
            let known: f64 = (0..row).map(|k| factor[row * n + k] * weights[k]).sum();
            weights[row] = (self.covariance(from[row], i) - known) / factor[row * n + row];
            let known: f64 = (0..row).map(|k| factor[row * n + k] * whitened[k]).sum();
            whitened[row] = (self.departures[from[row]] - known) / factor[row * n + row];
        }
        let departure: f64 = weights.iter().zip(&whitened).map(|(w, e)| w * e).sum();
        let explained: f64 = weights.iter().map(|w| w * w).sum();
        // Its own random error cannot be predicted.
        let variance = (self.covariance(i, i) - explained).max(self.arrivals[i].observation.sigma.powi(2));
        let difference = self.departures[i] - departure;
        let predicted = self.arrivals[i].value - difference;
        ValueCheck { predicted, z: difference / variance.sqrt(), neighbours: n }
    }

    /// S_ij.
    fn covariance(&self, i: usize, j: usize) -> f64 {
        let r2 = self.squared_distance(i, j) / self.length_m.powi(2);
        let mut covariance = self.variance * (-0.5 * r2).exp();
        for &(p, g) in &self.calibration_rows[i] {
            for &(_, other) in self.calibration_rows[j].iter().filter(|entry| entry.0 == p) {
                covariance += g * other * self.calibration.parameters[p].sigma_prior.powi(2);
            }
        }
        if i == j { covariance + self.arrivals[i].observation.sigma.powi(2) } else { covariance }
    }

    /// r_ij², the shortest way round where the domain is periodic \[m²\].
    fn squared_distance(&self, i: usize, j: usize) -> f64 {
        let (a, b) = (&self.arrivals[i].observation.report, &self.arrivals[j].observation.report);
        let around = |distance: f64, extent: f64| distance.abs().min(extent - distance.abs());
        let dx = around(a.x_m - b.x_m, self.grid.width_m());
        let dy = match self.grid.boundary {
            Boundary::Periodic => around(a.y_m - b.y_m, self.grid.height_m()),
            Boundary::Channel => a.y_m - b.y_m,
        };
        dx * dx + dy * dy
    }

    /// The nearest neighbours of each observation among those that judge: from a mesh of bins with about four of them in
    /// each, those in its own bin and the bins around it.
    fn nearest(&self) -> Vec<Vec<usize>> {
        let n = self.arrivals.len();
        let judges: Vec<usize> = (0..n).filter(|&i| self.is_judge[i]).collect();
        let side = ((judges.len() as f64 / 4.0).sqrt().floor() as usize).clamp(1, 1000);
        let bin_of = |i: usize| {
            let report = &self.arrivals[i].observation.report;
            let place = |x: f64, extent: f64| ((x / extent * side as f64) as usize).min(side - 1);
            (place(report.x_m, self.grid.width_m()), place(report.y_m, self.grid.height_m()))
        };
        let mut bins = vec![Vec::new(); side * side];
        for i in judges {
            let (column, row) = bin_of(i);
            bins[row * side + column].push(i);
        }
        let reach = 2.min(side / 2) as isize;
        let around = |i: usize| {
            let (column, row) = bin_of(i);
            let near = |at: usize| {
                let mut all: Vec<usize> =
                    (-reach..=reach).map(|k| (at as isize + k).rem_euclid(side as isize) as usize).collect();
                all.sort_unstable();
                all.dedup();
                all
            };
            let mut found: Vec<(f64, usize)> = Vec::new();
            for row in near(row) {
                for column in near(column) {
                    let others = bins[row * side + column].iter().filter(|&&j| j != i);
                    found.extend(others.map(|&j| (self.squared_distance(i, j), j)));
                }
            }
            found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            found.into_iter().take(NEIGHBOURS).map(|(_, j)| j).collect()
        };
        (0..n).map(around).collect()
    }
}

/// The median; 0 of nothing.
fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
