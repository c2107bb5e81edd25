//! The exact performance of linear methods in a linear world: no random numbers, no seeds, no sampling error.
//!
//! Where model and observations are linear, the gains of a method do not depend on the data. They are found by asking
//! ([`isobar_assim::response`]), cycle by cycle, and the covariance of the actual errors is propagated with them and with the
//! actual Q and R ([`isobar_assim::actual_errors`]): what the mean squares of infinitely many seeds would be. The places of
//! random observations (missing ones, random stations) are those of the scenario's seed.

use crate::kinds::methods::Method;
use crate::run::experiment::{self, ExperimentError, Ground};
use crate::scenario::{Scenario, ScenarioError, TruthSettings, TwinSettings};
use crate::scores::Values;
use indexmap::IndexMap;
use isobar_assim::actual_errors::ActualErrors;
use isobar_assim::response::Responder;
use isobar_assim::{BiasTreatment, Error, covariance};
use isobar_model::{Duration, Layout, Time};
use isobar_obs::{BiasProcess, Faults, ObservationWindow, ObservingSystem};
use rayon::prelude::*;

/// The most unknowns, of state and biases together: six matrices of that size squared, and its cube in every cycle.
pub const MOST_UNKNOWNS: usize = 4000;

/// The most observations of a cycle: a gain of each, found by an analysis of its own, and matrices of that size squared.
pub const MOST_OBSERVATIONS: usize = 4000;

/// The most observations of all cycles together, and the most weights of their rows: they are held for all methods.
const MOST_HELD: [usize; 2] = [5_000_000, 50_000_000];

/// What is computed of a scenario.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExactOptions {
    /// The methods, each one of the scenario's; `None`: all that have fixed gains.
    pub methods: Option<Vec<String>>,
    /// Number of cycles instead of the scenario's.
    pub cycles: Option<usize>,
}

/// A method that is left out, and why.
pub type LeftOut = (String, &'static str);

/// The exact performance of a scenario's methods.
#[derive(Clone, Debug, PartialEq)]
pub struct ExactSummary {
    /// The first cycle that counts.
    pub scored_from_cycle: usize,
    /// The last cycle.
    pub cycles: usize,
    /// By method, roots of the expected mean squares over grid points and cycles; without a bias score where there are no
    /// parameters, or the method is given them, and without a spread where it claims none.
    pub methods: IndexMap<String, Values>,
    /// Methods without fixed gains, and why they have none.
    pub left_out: Vec<LeftOut>,
}

/// Computes the performance of a scenario's methods.
///
/// # Errors
/// With its place in the file, whatever makes the world nonlinear, or a method's gains depend on the data; a state that is
/// too large; and what keeps the scenario from being run.
pub fn exact(scenario: &Scenario, options: &ExactOptions) -> Result<ExactSummary, ScenarioError> {
    exact_heard(scenario, options, &|_| {})
}

/// Progress of a computation: a method has done a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CycleDone<'a> {
    /// The method.
    pub method: &'a str,
    /// The cycle.
    pub cycle: usize,
    /// Cycles of all methods together.
    pub all: usize,
}

/// The same, with a call of `heard` after every cycle of every method, in no particular order.
///
/// # Errors
/// As [`exact`].
pub fn exact_heard(
    scenario: &Scenario,
    options: &ExactOptions,
    heard: &(dyn Fn(CycleDone<'_>) + Sync),
) -> Result<ExactSummary, ScenarioError> {
    let truth = check_linear(scenario)?;
    if !scenario.comparisons.is_empty() {
        let message = "exact errors are those of analyses of observations alone: leave out the comparisons of sensors";
        return Err(scenario.fault(&["comparisons"], message.into(), "these"));
    }
    let (names, left_out) = chosen(scenario, options)?;
    let (background_error_scale, model_error_scale) = (truth.background_error_scale, truth.model_error_scale);
    // A smoother leaves the filter's gains as they are, and would only take part in the analyses that find them.
    let mut scenario = scenario.clone();
    scenario.methods.values_mut().for_each(|method| method.smoother_lag_cycles = None);
    let scenario = &scenario;
    let locate = |error: ExperimentError| error.locate(scenario);
    let Ground { problem, mut observing, .. } =
        experiment::ground(scenario, scenario.seed, scenario.cycle.count).map_err(locate)?;
    check_biases(scenario, &observing)?;
    check_decay(scenario, &observing)?;
    let layout = problem.background.layout().clone();
    let cycles = options.cycles.unwrap_or(scenario.cycle.count);
    check_size(scenario, layout.len() + observing.calibration().len())?;
    check_observations(scenario, &observing, cycles)?;
    let windows: Vec<ObservationWindow> = (0..cycles).map(|_| observing.observe(&problem.background)).collect();
    let steps =
        scenario.cycle.window.steps_of(problem.model.time_step()).expect("the scenario's window fits its steps");
    let of_method = |name: &String, error| locate(ExperimentError::Method { name: name.clone(), error });
    let propagator = ActualErrors::propagator(&*problem.model, &problem.background, steps)
        .map_err(|error| of_method(&names[0], error))?;
    let world = World {
        background_error: covariance::dense(&*problem.background_error) * faer::Scale(background_error_scale),
        model_error: problem
            .model_error
            .as_deref()
            .map(|operator| covariance::dense(operator) * faer::Scale(model_error_scale)),
        propagator,
        biases: observing.bias_processes().cloned().collect(),
        windows,
        start: scenario.start,
        window: scenario.cycle.window,
        scored_from: scenario.cycle.score_from_cycle,
    };
    let of_one = |name: &String| {
        let mut method = experiment::method(&problem, name, scenario, scenario.start).map_err(locate)?;
        let all = names.len() * cycles;
        let heard = |cycle: usize| heard(CycleDone { method: name, cycle, all });
        let scores = world.scores(&mut *method, &scenario.methods[name], &layout, &heard);
        Ok((name.clone(), scores.map_err(|error| of_method(name, error))?))
    };
    let methods = names.par_iter().map(of_one).collect::<Result<Vec<_>, ScenarioError>>()?;
    let scored_from_cycle = scenario.cycle.score_from_cycle;
    Ok(ExactSummary { scored_from_cycle, cycles, methods: methods.into_iter().collect(), left_out })
}

/// The true world, as far as covariances go.
struct World {
    background_error: faer::Mat<f64>,
    model_error: Option<faer::Mat<f64>>,
    propagator: faer::Mat<f64>,
    biases: Vec<BiasProcess>,
    windows: Vec<ObservationWindow>,
    start: Time,
    window: Duration,
    scored_from: usize,
}

impl World {
    fn scores(
        &self,
        method: &mut dyn isobar_assim::Assimilator,
        settings: &Method,
        layout: &Layout,
        heard: &dyn Fn(usize),
    ) -> Result<Values, Error> {
        let elapsed = |cycle: usize| self.window * cycle;
        let mean = |own: &BiasProcess, cycle: usize| own.mean(elapsed(cycle), self.start + elapsed(cycle));
        let means = |cycle: usize| -> Vec<f64> { self.biases.iter().map(|own| mean(own, cycle)).collect() };
        let errors_of_zero: Vec<f64> = means(0).iter().map(|mean| -mean).collect();
        let variances: Vec<f64> = self.biases.iter().map(BiasProcess::initial_variance).collect();
        let kept: Vec<f64> = self.biases.iter().map(|own| own.true_drift().kept(self.window)).collect();
        let added: Vec<f64> = self.biases.iter().map(|own| own.true_drift().added_variance(self.window)).collect();
        let mut errors = ActualErrors::new(self.background_error.as_ref(), &errors_of_zero, &variances);
        let (m, p) = (layout.len(), self.biases.len());
        let (mut background, mut analysis, mut spread) = (vec![0.0; m + p], vec![0.0; m + p], vec![0.0; m + p]);
        let (mut claims_state, mut claims_biases) = (true, true);
        for (observed, cycle) in self.windows.iter().zip(1..) {
            let from = method.forecast(self.window)?;
            let then = means(cycle - 1);
            let change = |(i, now): (usize, &f64)| now - kept[i] * then[i];
            let changes: Vec<f64> = means(cycle).iter().enumerate().map(change).collect();
            let model_error = self.model_error.as_ref().map(|matrix| matrix.as_ref());
            errors.forecast(self.propagator.as_ref(), model_error, &kept, &added, &changes);
            let scored = cycle >= self.scored_from;
            if scored {
                add(&mut background, errors.mean_squares().into_iter());
            }
            let gain = Responder::new(method, &from, observed).gain()?;
            let estimate = method.analyse(&from, observed)?.estimate;
            let jacobian = observed.operator.linearize(&from.estimate.state, &from.estimate.calibration);
            let error_covariance = observed.error_regression.covariance(&observed.sigma);
            errors.analyse(&gain, &jacobian, &error_covariance, settings.bias != BiasTreatment::Known);
            if scored {
                add(&mut analysis, errors.mean_squares().into_iter());
                let squares = |values: &Option<Vec<f64>>, count: usize| -> Vec<f64> {
                    values.as_ref().map_or(vec![0.0; count], |it| it.iter().map(|sigma| sigma * sigma).collect())
                };
                let claimed = [squares(&estimate.state_spread, m), squares(&estimate.calibration_spread, p)].concat();
                add(&mut spread, claimed.into_iter());
                claims_state &= estimate.state_spread.is_some();
                claims_biases &= estimate.calibration_spread.is_some();
            }
            heard(cycle);
        }
        let scored = (self.windows.len() + 1 - self.scored_from) as f64;
        let root = |values: &[f64]| (values.iter().sum::<f64>() / (values.len() as f64 * scored)).sqrt();
        let mut scores = Values::new();
        let mut insert = |kind: &str, sums: &[f64]| {
            let fields = sums[..m].chunks_exact(layout.grid.cells());
            let named = layout.variables.iter().zip(fields);
            scores.extend(named.map(|(variable, field)| (format!("{kind}.{}", variable.name), root(field))));
        };
        insert("rmse_background", &background);
        insert("rmse_analysis", &analysis);
        if claims_state {
            insert("spread_analysis", &spread);
        }
        if p > 0 && settings.scores_biases() {
            scores.insert("bias_rmse".into(), root(&analysis[m..]));
            scores.extend(claims_biases.then(|| ("bias_spread".into(), root(&spread[m..]))));
        }
        Ok(scores)
    }
}

fn add(sums: &mut [f64], values: impl Iterator<Item = f64>) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}

/// The methods that are asked for, and those that are left out because nobody has asked for them by name.
fn chosen(scenario: &Scenario, options: &ExactOptions) -> Result<(Vec<String>, Vec<LeftOut>), ScenarioError> {
    let (mut names, mut left_out) = (Vec::new(), Vec::new());
    for (name, method) in &scenario.methods {
        let is_named = options.methods.as_ref().map(|chosen| chosen.contains(name));
        match (method.without_fixed_gain(), is_named) {
            (_, Some(false)) => {}
            (None, _) => names.push(name.clone()),
            (Some(reason), None) => left_out.push((name.clone(), reason)),
            (Some(reason), Some(true)) => {
                let message = format!("the exact performance of method {name} cannot be computed: {reason}");
                return Err(scenario.fault(&["methods", name, "kind"], message, "no fixed gain"));
            }
        }
    }
    if names.is_empty() {
        let message = "no method of this scenario has gains that do not depend on the data".to_string();
        return Err(scenario.fault(&["methods"], message, "none of these"));
    }
    Ok((names, left_out))
}

/// Refuses a world that is not linear, or without a truth; how the truth differs from what methods assume.
fn check_linear(scenario: &Scenario) -> Result<&TwinSettings, ScenarioError> {
    let truth = match &scenario.truth {
        Some(TruthSettings::Twin(twin)) => twin,
        Some(TruthSettings::Series(series)) => {
            let message = format!(
                "exact performance is that of a truth which departs from the model by known covariances, and not of the states \
                 of {}",
                series.name()
            );
            return Err(scenario.fault(&["truth", "kind"], message, "no known errors"));
        }
        None => {
            let message =
                "exact performance is that of errors against a truth, and all observations are recorded".to_string();
            return Err(scenario.fault(&["networks"], message, "no truth"));
        }
    };
    if !scenario.model.equations.is_linear() {
        let message = format!("exact performance needs a linear model, and {} is not linear", scenario.model.kind);
        return Err(scenario.fault(&["model", "kind"], message, "not linear"));
    }
    if scenario.truth_has_other_model() {
        let message =
            "exact performance needs the same model for the truth: else errors depend on the state".to_string();
        return Err(scenario.fault(&["truth", "model"], message, "another model"));
    }
    if truth.model.forcing != scenario.model.forcing {
        let message = "exact performance needs the same forcing for the truth: else errors have a mean".to_string();
        return Err(scenario.fault(&["truth", "forcing"], message, "another forcing"));
    }
    if truth.initial.is_some() {
        let message = "exact performance is that of a truth which starts at a draw of the background error".to_string();
        return Err(scenario.fault(&["truth", "initial"], message, "a given start"));
    }
    for (key, given) in [("sensors", scenario.sensors.is_some()), ("initialise", scenario.initialise.is_some())] {
        if given {
            let message = format!("exact performance is that of a start from the biases' priors, without [{key}]");
            return Err(scenario.fault(&[key], message, "this"));
        }
    }
    for network in &scenario.networks {
        let name = &network.name;
        if network.faults != Faults::NONE {
            let message = format!("exact performance needs normal errors, and network {name} has faults");
            return Err(scenario.fault(&["networks", name, "faults"], message, "these"));
        }
        if network.error_correlation.is_some_and(|it| it.length_m != it.assumed_length_m) {
            let message = format!(
                "exact performance needs methods that assume the error correlation of network {name} as it is; a method may \
                 ignore it"
            );
            return Err(scenario.fault(&["networks", name, "error_correlation"], message, "another assumed length"));
        }
        if network.is_within_window() {
            let key = if network.instrument.is_recorded() { "observation_times" } else { "times_per_window" };
            let message = format!(
                "exact performance needs errors at the analysis alone, and network {name} observes them within the window"
            );
            return Err(scenario.fault(&["networks", name, key], message, "before the analysis"));
        }
        if network.instrument.has_air_mass_bias() {
            let message = format!(
                "exact performance needs biases that do not depend on the state, and network {name} has air_mass terms"
            );
            return Err(scenario.fault(&["networks", name, "bias"], message, "in one of these"));
        }
    }
    Ok(truth)
}

/// Refuses biases of recorded observations.
fn check_biases(scenario: &Scenario, observing: &ObservingSystem) -> Result<(), ScenarioError> {
    let parameters = observing.calibration().parameters.iter().zip(observing.true_calibration());
    let mut unknown = parameters.filter(|(_, truth)| truth.is_none()).map(|(parameter, _)| &parameter.name);
    let Some(name) = unknown.next() else { return Ok(()) };
    let network = name.split('/').next().unwrap_or_default();
    let message = format!(
        "exact performance is that of errors against a truth, and nothing is known of the true biases of network {network}, \
         whose observations were made elsewhere"
    );
    Err(scenario.fault(&["networks", network, "bias"], message, "biases without a truth"))
}

fn check_observations(scenario: &Scenario, observing: &ObservingSystem, cycles: usize) -> Result<(), ScenarioError> {
    let observations = observing.most_observations(1..=cycles);
    let held = [observations, observing.weights()].map(|size| size.saturating_mul(cycles));
    let message = if observations > MOST_OBSERVATIONS {
        format!(
            "exact performance needs the gain of each observation: {observations} in a cycle are more than the \
             {MOST_OBSERVATIONS} that it takes"
        )
    } else if held.iter().zip(MOST_HELD).any(|(held, most)| *held > most) {
        format!(
            "exact performance holds the observations of all {cycles} cycles; {} observations with {} weights do not fit in \
             memory: give fewer `--cycles`",
            held[0], held[1]
        )
    } else {
        return Ok(());
    };
    Err(scenario.fault(&["networks"], message, "fewer of these"))
}

/// The error of an estimate whose method lets a bias decay as the bias does not would depend on the bias itself.
fn check_decay(scenario: &Scenario, observing: &ObservingSystem) -> Result<(), ScenarioError> {
    let window = scenario.cycle.window;
    let decays_otherwise = |process: &BiasProcess| process.drift().kept(window) != process.true_drift().kept(window);
    let parameters = &observing.calibration().parameters;
    let Some((_, parameter)) = observing.bias_processes().zip(parameters).find(|it| decays_otherwise(it.0)) else {
        return Ok(());
    };
    let message = format!(
        "exact performance needs methods that let biases decay as they do: {} is an AR(1) process to one of truth and \
         methods only, or with another correlation time",
        parameter.name
    );
    let network = parameter.name.split('/').next().unwrap_or_default();
    Err(scenario.fault(&["networks", network, "bias"], message, "biases that methods let decay otherwise"))
}

fn check_size(scenario: &Scenario, unknowns: usize) -> Result<(), ScenarioError> {
    if unknowns <= MOST_UNKNOWNS {
        return Ok(());
    }
    let message = format!(
        "exact performance propagates the whole covariance: {unknowns} unknowns are more than the {MOST_UNKNOWNS} that it takes"
    );
    Err(scenario.fault(&["grid"], message, "a smaller grid"))
}
