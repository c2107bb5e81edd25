//! The contract that every method must keep: [`check_assimilator`].

use crate::assimilator::Assimilator;
use crate::covariance_column::Unknown;
use crate::estimate::{Analysis, Background, Estimate};
use faer::Side;
use isobar_model::vector::{difference, norm};
use isobar_model::{Duration, State};
use isobar_obs::{Jacobian, ObservationOperator, ObservationWindow, SparseRows};
use std::sync::Arc;

/// A method and what it is tried with.
pub struct Trial<'a> {
    /// Builds the method as it is at the start.
    pub build: &'a dyn Fn() -> Box<dyn Assimilator>,
    /// The length of a cycle.
    pub window: Duration,
    /// The observations of each cycle, in at least two cycles.
    pub observed: &'a [ObservationWindow],
    /// Whether the method draws a random number for each observation, so that their order matters.
    pub perturbs_observations: bool,
}

/// What [`check_assimilator`] measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AssimilatorContract {
    /// The largest change that a window without observations made, relative to the estimate.
    pub change_without_observations: f64,
    /// The largest change that another order of the observations made, relative to the increment of the analysis.
    pub change_by_order: f64,
    /// The largest difference of the covariances of i with j and of j with i, in units of a correlation.
    pub asymmetry: f64,
    /// The least eigenvalue of the covariance of the calibration, relative to the largest.
    pub least_eigenvalue: f64,
}

/// What rounding may do to sums over a state; minimisers stop at about as much.
const ROUNDING: f64 = 1e-6;

/// Runs the battery on a method over all cycles of the trial.
///
/// * Estimates, their claimed standard deviations and departures are finite, and the same bits in a second run.
/// * The state of an estimate has no valid time, or one that advances by the window in each cycle.
/// * A window without observations leaves the first background as it is.
/// * The memory of each cycle, recalled by a fresh method, leads to the same bits; its bytes are those of the memory.
/// * What a copy does leaves the method as it is, and is what the method does itself.
/// * Another order of the observations changes the analysis by rounding only.
/// * Claims: covariances are symmetric, the variances in them are those of the estimate, no correlation is above 1, and the
///   covariance of the calibration has no negative eigenvalue. A smoothed estimate of now is the analysis.
///
/// # Panics
/// With the numbers, if the method breaks the contract.
pub fn check_assimilator(trial: &Trial<'_>) -> AssimilatorContract {
    assert!(trial.observed.len() > 1, "the battery needs two cycles at least");
    let mut contract = AssimilatorContract::default();
    let (mut method, mut again) = ((trial.build)(), (trial.build)());
    let mut first_time = None;
    for (number, observed) in trial.observed.iter().enumerate() {
        let cycle = number + 1;
        let from = method.forecast(trial.window).unwrap_or_else(|error| panic!("cycle {cycle}: {error}"));
        assert!(
            again.forecast(trial.window).as_ref() == Ok(&from),
            "cycle {cycle}: another background the second time"
        );
        require_finite(&from.estimate, "the background", cycle);
        let time = from.estimate.state.time();
        first_time = first_time.or(time);
        assert_eq!(time, first_time.map(|first| first + trial.window * number), "cycle {cycle}: the background's time");
        if number == 0 {
            contract.change_without_observations = check_without_observations(&*method, &from, observed);
        }
        let before = method.memory().expect("a memory");
        let asked = analyse(&mut *method.boxed_clone(), &from, observed, cycle);
        assert!(method.memory().as_ref() == Ok(&before), "cycle {cycle}: a copy's analysis changes the method");
        if !trial.perturbs_observations {
            let change = change_by_order(&*method, &from, observed, &asked, cycle);
            contract.change_by_order = contract.change_by_order.max(change);
        }
        let analysis = analyse(&mut *method, &from, observed, cycle);
        assert_eq!(analysis.estimate.state.time(), time, "cycle {cycle}: the analysis is of another time");
        assert!(analysis == asked, "cycle {cycle}: the method's analysis is not that of its copy");
        assert!(
            analysis == analyse(&mut *again, &from, observed, cycle),
            "cycle {cycle}: another analysis the second time"
        );
        check_claims(&*method, &analysis.estimate, cycle, &mut contract);
        let memory = method.memory().expect("a memory");
        again = (trial.build)();
        again.recall(&mut &memory[..]).unwrap_or_else(|error| panic!("cycle {cycle}: {error}"));
        assert!(again.memory().as_ref() == Ok(&memory), "cycle {cycle}: a recalled memory is another one");
    }
    contract
}

fn analyse(method: &mut dyn Assimilator, from: &Background, observed: &ObservationWindow, cycle: usize) -> Analysis {
    let analysis = method.analyse(from, observed).unwrap_or_else(|error| panic!("cycle {cycle}: {error}"));
    require_finite(&analysis.estimate, "the analysis", cycle);
    let Analysis { background_departures, analysis_departures, innovation_chi2, .. } = &analysis;
    for departures in [background_departures, analysis_departures] {
        assert_eq!(departures.len(), observed.len(), "cycle {cycle}: departures");
        assert!(departures.iter().chain(innovation_chi2).all(|it| it.is_finite()), "cycle {cycle}: departures or χ²");
    }
    analysis
}

fn require_finite(estimate: &Estimate, what: &str, cycle: usize) {
    let Estimate { state, calibration, state_spread, calibration_spread } = estimate;
    let claims = [state_spread, calibration_spread].into_iter().flatten().flatten();
    assert!(claims.clone().all(|sigma| *sigma >= 0.0), "cycle {cycle}: {what} claims a negative standard deviation");
    let mut all = state.values().iter().chain(calibration).chain(claims);
    assert!(all.all(|value| value.is_finite()), "cycle {cycle}: {what} is not finite");
}

/// State and calibration of an estimate in one vector.
fn all(estimate: &Estimate) -> Vec<f64> {
    [estimate.state.values(), &estimate.calibration].concat()
}

fn relative(a: &[f64], b: &[f64], size: f64) -> f64 {
    let distance = norm(&difference(a, b));
    if size > 0.0 { distance / size } else { distance }
}

/// The change that a window without observations makes, beside the background.
fn check_without_observations(method: &dyn Assimilator, from: &Background, observed: &ObservationWindow) -> f64 {
    let nothing = chosen(observed, Vec::new());
    let after = analyse(&mut *method.boxed_clone(), from, &nothing, 1).estimate;
    let (before, after) = (all(&from.estimate), all(&after));
    let change = relative(&after, &before, norm(&before));
    assert!(change < ROUNDING, "a window without observations changes the estimate by {change:e} of it");
    change
}

/// The change of the analysis when the observations come in the opposite order, beside its increment.
fn change_by_order(
    method: &dyn Assimilator,
    from: &Background,
    observed: &ObservationWindow,
    expected: &Analysis,
    cycle: usize,
) -> f64 {
    let reversed = chosen(observed, (0..observed.len()).rev().collect());
    let found = analyse(&mut *method.boxed_clone(), from, &reversed, cycle);
    let (found, expected) = (all(&found.estimate), all(&expected.estimate));
    let change = relative(&found, &expected, norm(&difference(&expected, &all(&from.estimate))));
    assert!(change < ROUNDING, "cycle {cycle}: the order of observations changes the analysis by {change:e} of it");
    change
}

/// Unknowns to look at: values all over the state, and all parameters.
fn unknowns(estimate: &Estimate) -> Vec<Unknown> {
    let m = estimate.state.values().len();
    let values = (0..m).step_by((m / 7).max(1)).map(Unknown::Value);
    values.chain((0..estimate.calibration.len()).map(Unknown::Parameter)).collect()
}

fn check_claims(method: &dyn Assimilator, estimate: &Estimate, cycle: usize, contract: &mut AssimilatorContract) {
    let claimed = |unknown: &Unknown| match *unknown {
        Unknown::Value(number) => estimate.state_spread.as_ref().map(|spread| spread[number]),
        Unknown::Parameter(number) => estimate.calibration_spread.as_ref().map(|spread| spread[number]),
    };
    let close = |a: f64, b: f64| (a - b).abs() <= ROUNDING * a.abs().max(b.abs());
    let views = method.can();
    if let Some(errors) = views.joint_errors {
        let columns = unknowns(estimate).into_iter().filter_map(|it| Some((it, errors.covariance_column(it)?)));
        let columns: Vec<_> = columns.collect();
        for (a, of_a) in &columns {
            let variance = of_a.with(*a);
            // The calibration's variances are those of its own view.
            if let (Unknown::Value(_), Some(sigma)) = (a, claimed(a)) {
                let squared = sigma * sigma;
                assert!(close(variance, squared), "cycle {cycle}, {a:?}: the variance {variance:e} is not {squared:e}");
            }
            for (b, of_b) in &columns {
                let size = (variance * of_b.with(*b)).max(0.0).sqrt();
                let asymmetry = (of_a.with(*b) - of_b.with(*a)).abs() / size.max(f64::MIN_POSITIVE);
                assert!(size == 0.0 || asymmetry < ROUNDING, "cycle {cycle}, {a:?} and {b:?}: off by {asymmetry:e}");
                assert!(of_a.with(*b).abs() <= size * (1.0 + ROUNDING), "cycle {cycle}, {a:?} and {b:?}: above 1");
                contract.asymmetry = contract.asymmetry.max(if size > 0.0 { asymmetry } else { 0.0 });
            }
        }
    }
    if let Some(calibration) = views.calibration {
        let accuracy = calibration.calibration_accuracy();
        let covariance = accuracy.covariance();
        let p = estimate.calibration.len();
        assert_eq!((covariance.nrows(), covariance.ncols()), (p, p), "cycle {cycle}: the calibration's covariance");
        for number in 0..p {
            let (variance, sigma) = (covariance[(number, number)], claimed(&Unknown::Parameter(number)));
            let squared = sigma.map_or(variance, |sigma| sigma * sigma);
            assert!(close(variance, squared), "cycle {cycle}, parameter {number}: {variance:e} is not {squared:e}");
        }
        let eigenvalues = covariance.self_adjoint_eigenvalues(Side::Lower).expect("finite values have eigenvalues");
        let (least, largest) = (eigenvalues[0], eigenvalues[p - 1]);
        let least = if largest > 0.0 { least / largest } else { least };
        assert!(least > -ROUNDING, "cycle {cycle}: the calibration's covariance has an eigenvalue of {least:e}");
        contract.least_eigenvalue = contract.least_eigenvalue.min(least);
    }
    if let Some(smoother) = views.smoother {
        let now = smoother.smoothed(0).expect("a smoothed estimate").expect("that of now");
        let (now, expected) = (all(&now), all(estimate));
        let change = relative(&now, &expected, norm(&expected));
        assert!(change < ROUNDING, "cycle {cycle}: what is smoothed of now is not the analysis: {change:e}");
    }
}

/// Some rows of an operator.
struct Rows {
    whole: Arc<dyn ObservationOperator>,
    rows: Vec<usize>,
}

impl ObservationOperator for Rows {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        let simulated = self.whole.simulate(x, calibration);
        self.rows.iter().map(|&row| simulated[row]).collect()
    }

    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian {
        let whole = self.whole.linearize(x, calibration);
        let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
        for &row in &self.rows {
            state.push_row(whole.state.row(row).iter().copied());
            calibration.push_row(whole.calibration.row(row).iter().copied());
        }
        Jacobian { state, calibration }
    }
}

/// Some observations of a window, in this order.
fn chosen(observed: &ObservationWindow, rows: Vec<usize>) -> ObservationWindow {
    let of = |values: &[f64]| rows.iter().map(|&row| values[row]).collect();
    ObservationWindow {
        reports: rows.iter().map(|&row| observed.reports[row].clone()).collect(),
        values: of(&observed.values),
        sigma: of(&observed.sigma),
        operator: Arc::new(Rows { whole: Arc::clone(&observed.operator), rows }),
        ..observed.clone()
    }
}
