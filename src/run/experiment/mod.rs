//! From a scenario to everything that runs: model, truth, observing system, methods.

mod balance;
mod builder;
mod check;
mod cost;
mod error;
mod ground;
mod inputs;
mod known_biases;
mod notices;
mod span;

pub use builder::ExperimentBuilder;
pub use check::{Checked, check, check_sensors, estimated_bytes};
pub use cost::Cost;
pub use error::ExperimentError;
pub use ground::{Ground, ground};
pub use inputs::{Inputs, inputs_of};

use crate::event::{MethodInfo, NetworkInfo, RunInfo, StationInfo};
use crate::kinds::instruments;
use crate::kinds::methods::{FirstGuess, Method, Sizes, Work};
use crate::memory;
use crate::options::RunOptions;
use crate::run::agreement::agreed;
use crate::run::ahead::{Ahead, require_room};
use crate::run::comparisons::{Comparisons, Misplaced};
use crate::run::cycle::{Judging, Runner};
use crate::run::earlier::Earlier;
use crate::run::reference::Reference;
use crate::run::truth::Truth;
use crate::run::units::UnitCheck;
use crate::scenario::{Scenario, ScenarioError, TruthSettings};
use crate::scores::Failure;
use crate::sensors::knowledge::WarmStart;
use crate::threshold_warning::{PlacedWarning, ThresholdWarning};
use builder::AddedMethod;
use ground::ground_after;
use isobar_assim::high_pass::HighPassSettings;
use isobar_assim::{Assimilator, BiasTreatment, Calibrated, Initialised, Problem, Recalibration, Whitened};
use isobar_model::communicator::{Alone, Communicator};
use isobar_model::{State, Time};
use isobar_obs::ObservingSystem;
use span::Span;
use std::borrow::Cow;
use std::sync::Arc;

impl ExperimentError {
    /// The same fault with its place in the scenario's file.
    pub fn locate(&self, scenario: &Scenario) -> ScenarioError {
        let place;
        let (path, label): (Vec<&str>, &str) = match self {
            ExperimentError::TrueModel(_) => (vec!["truth"], "with this"),
            ExperimentError::TrueTimeStep(_) if scenario.truth_has_other_model() => {
                (vec!["truth", "model", "time_step_s"], "too long for this")
            }
            ExperimentError::TimeStep(_) | ExperimentError::TrueTimeStep(_) => {
                (vec!["model", "time_step_s"], "too long")
            }
            ExperimentError::Model(_) => (vec!["initial"], "with this and [model]"),
            ExperimentError::Balance(_) => (vec!["model", "coriolis_per_s"], "next to no rotation"),
            ExperimentError::Covariance(_) => (vec!["background_error"], "here or in [model_error]"),
            ExperimentError::Method { name, .. } => (vec!["methods", name], "this method"),
            ExperimentError::UnknownBias { name, .. } => (vec!["methods", name, "bias"], "not known to anyone"),
            ExperimentError::Warning { name, .. } => {
                let number = scenario.warnings.iter().position(|it| it.name == *name).unwrap_or(0);
                place = vec!["warnings".into(), number.to_string(), "at".into()];
                (place.iter().map(String::as_str).collect(), "not there")
            }
            ExperimentError::Comparison(Misplaced { number, key, .. }) => {
                place = vec!["comparisons".into(), number.to_string(), key.to_string()];
                (place.iter().map(String::as_str).collect(), "not there")
            }
            ExperimentError::Forcing { of_truth, number, .. } => {
                let within = if *of_truth { vec!["truth"] } else { Vec::new() };
                place = vec![number.to_string()];
                ([within, vec!["forcing", &place[0], "time", "file"]].concat(), "this file")
            }
            ExperimentError::Truth(_) => (vec!["truth", "file"], "this file"),
            ExperimentError::Sensors(_) => (vec!["sensors", "database"], "this database"),
            ExperimentError::Rank(_) => (Vec::new(), "on another process"),
            ExperimentError::Observations(error) => {
                place = instruments::place(error, &scenario.text);
                (place.iter().map(String::as_str).collect(), "here")
            }
        };
        scenario.fault(&path, self.to_string(), label)
    }
}

/// All that a run needs.
pub struct Experiment {
    /// What is known before the first cycle.
    pub info: RunInfo,
    /// Number of cycles between two in which the influence of each type of observations is computed; `None`: never.
    pub influence_every_cycles: Option<usize>,
    /// The true world; `None` where all observations are recorded.
    pub truth: Option<Truth>,
    /// The first background, from which the anomalies of forecasts ahead are counted.
    pub climate: State,
    /// What the values of observations are compared with, if they are checked.
    pub reference: Option<Reference>,
    /// Whether observations can be in their unit.
    pub units: UnitCheck,
    /// What observes it.
    pub observing: ObservingSystem,
    /// Everything on which results depend beside the scenario's text and the options.
    pub inputs: Inputs,
    /// The comparisons of sensors.
    pub comparisons: Comparisons,
    /// The recalibrations of sensors that are known.
    pub recalibrations: Vec<Recalibration>,
    /// What the user should know of it before it runs.
    pub warnings: Vec<String>,
    /// The methods, in the order of [`RunInfo::methods`].
    pub methods: Vec<Competitor>,
}

/// A method of the experiment.
pub struct Competitor {
    /// The method.
    pub runner: Runner,
    /// When and why it failed.
    pub failure: Option<Failure>,
    /// Whether its biases are scored: not where they are known to it or it has none.
    pub scores_bias: bool,
    /// The truth of the corrections of the model that it may estimate, by their names, as far as it is known.
    pub true_corrections: Vec<(String, f64)>,
    /// Whether it has warned of an analysis.
    pub has_warned: bool,
    /// Whether it is given observations without their true biases.
    pub bias_known: bool,
    /// The most memory that it may use \[bytes\].
    pub memory_limit_bytes: u64,
    /// Its forecasts ahead whose valid time has not come.
    pub ahead: Ahead,
    /// Whether it has warned of a forecast ahead.
    pub has_warned_ahead: bool,
}

impl Competitor {
    /// A method that has not begun, to which the true biases are not known.
    fn new(runner: Runner, memory_limit_bytes: u64) -> Self {
        Self {
            runner,
            failure: None,
            scores_bias: true,
            true_corrections: Vec::new(),
            has_warned: false,
            bias_known: false,
            memory_limit_bytes,
            ahead: Ahead::default(),
            has_warned_ahead: false,
        }
    }
}

impl Experiment {
    /// A scenario, to which methods and networks from code can be added.
    pub fn builder(scenario: &Scenario) -> ExperimentBuilder<'_> {
        ExperimentBuilder { scenario: Cow::Borrowed(scenario), added: Vec::new(), communicator: Arc::new(Alone) }
    }
}

impl ExperimentBuilder<'_> {
    /// Sets up the experiment of a run that goes on from no other.
    ///
    /// # Errors
    /// Faults that the scenario's file alone does not show: files, stations, time steps, memory; the name of an added method
    /// or network.
    pub fn build(&self, options: &RunOptions) -> Result<Experiment, ExperimentError> {
        self.build_after(options, None)
    }

    /// Sets up the experiment of a run that goes on from earlier ones, as it was before the first of them.
    ///
    /// # Errors
    /// As [`ExperimentBuilder::build`].
    pub(super) fn build_after(
        &self,
        options: &RunOptions,
        earlier: Option<&Earlier>,
    ) -> Result<Experiment, ExperimentError> {
        let experiment = self.build_at_end(options, earlier)?;
        let truth = experiment.truth.as_ref().map(|truth| truth.check_cycles(experiment.info.count()));
        agreed(&*self.communicator, truth.transpose().map_err(ExperimentError::Truth))?;
        Ok(experiment)
    }

    /// The same, where none of its cycles is run: a truth of a file need not go on.
    ///
    /// # Errors
    /// As [`ExperimentBuilder::build`].
    pub(super) fn build_at_end(
        &self,
        options: &RunOptions,
        earlier: Option<&Earlier>,
    ) -> Result<Experiment, ExperimentError> {
        self.check_names()?;
        let Self { added, communicator, .. } = self;
        let communicator = &**communicator;
        let scenario = &*self.scenario;
        let seed = options.seed.unwrap_or(scenario.seed);
        let span = Span::new(scenario, options.cycles, earlier);
        let ground = agreed(communicator, ground_after(scenario, seed, span, earlier, &self.communicator))?;
        let placed = placed_warnings(scenario, &ground)?;
        let comparisons = Comparisons::new(scenario, &ground.observing, seed).map_err(ExperimentError::Comparison)?;
        let Ground { problem, sensors, truth, observing } = ground;
        let inputs = Inputs::new(scenario, &sensors, added);
        let chosen = |name: &String| options.methods.as_ref().is_none_or(|chosen| chosen.contains(name));
        let judging = Judging {
            calibration: problem.calibration.clone(),
            variance_ratio: scenario.stability.variance_ratio,
            freezing: scenario.stability.freezing,
            first_analysis: 1,
        };
        let watched = |runner: Runner, first_analysis: usize| {
            let judging = Judging { first_analysis, ..judging.clone() };
            runner.watched(scenario.cycle.score_from_cycle, judging).of_model(problem.model.clone())
        };
        let within_window = scenario.observes_within_window();
        let at_its_times = |runner: Runner, first_guess: FirstGuess| match first_guess {
            FirstGuess::AppropriateTime if within_window => runner.at_appropriate_time(problem.background.clone()),
            _ => runner,
        };
        let calibrated = |method: Box<dyn Assimilator>, estimates_biases: bool| {
            if estimates_biases {
                Calibrated::new(method, &problem.calibration, span.start, sensors.knowledge.clone())
            } else {
                method.into()
            }
        };
        let (mut methods, mut infos) = (Vec::new(), Vec::new());
        for (name, method) in scenario.methods.iter().filter(|(name, _)| chosen(name)) {
            let build = || {
                let built = method_on(communicator, &problem, name, scenario, span.start)?;
                let built = calibrated(built, method.estimates_biases());
                Ok(if method.uses_comparisons { built } else { built.ignoring_comparisons() })
            };
            let initialised = initialisation(name, scenario);
            let first_analysis = initialised.map_or(1, |settings| settings.cycles);
            let runner = watched(Runner::new::<_, ExperimentError>(build)?, first_analysis);
            let runner = at_its_times(runner, method.first_guess);
            let (smoother_lag_cycles, estimates_biases) = (runner.smoother_lag(), runner.estimates_biases());
            let bias_known = method.bias == BiasTreatment::Known;
            let scores_bias = method.scores_biases();
            let memory_limit_bytes = method.memory_limit_bytes;
            let true_corrections = match &scenario.truth {
                Some(TruthSettings::Twin(twin)) => method.settings.true_corrections(&twin.model, &scenario.domain()),
                _ => Vec::new(),
            };
            let competitor = Competitor::new(runner, memory_limit_bytes);
            methods.push(Competitor { scores_bias, true_corrections, bias_known, ..competitor });
            let initialised = initialised.map(|settings| {
                format!("calibration initialised from {} cycles by a high-pass filter", settings.cycles)
            });
            let known = sensors_in_words(&sensors).filter(|_| method.estimates_biases());
            let parts = [Some(method.describe()), initialised, known];
            let description = parts.into_iter().flatten().collect::<Vec<_>>().join(", ");
            infos.push(MethodInfo { name: name.clone(), description, smoother_lag_cycles, estimates_biases });
        }
        for AddedMethod { name, description, set_up } in added.iter().filter(|method| chosen(&method.name)) {
            let build = || {
                let method = Box::new(Whitened::new(set_up(problem.clone())?));
                let estimates_biases = method.can().calibration.is_some();
                Ok(calibrated(method, estimates_biases))
            };
            let runner = Runner::new(build).map_err(|error| ExperimentError::Method { name: name.clone(), error })?;
            let runner = at_its_times(watched(runner, 1), FirstGuess::AppropriateTime);
            let (smoother_lag_cycles, estimates_biases) = (runner.smoother_lag(), runner.estimates_biases());
            let (name, description) = (name.clone(), description.clone());
            methods.push(Competitor::new(runner, u64::MAX));
            infos.push(MethodInfo { name, description, smoother_lag_cycles, estimates_biases });
        }
        let stations = observing.stations().iter().map(|station| StationInfo {
            network: station.network.clone(),
            name: station.long_name.clone(),
            group: station.group.clone(),
            x_m: station.x_m,
            y_m: station.y_m,
        });
        let networks = scenario.networks.iter().map(|network| NetworkInfo {
            name: network.name.as_str().into(),
            is_recorded: network.instrument.is_recorded(),
            has_passive: network.has_passive(),
        });
        let recorded: Vec<_> = observing.recorded_use(span.cycles()).collect();
        let info = RunInfo {
            scenario: scenario.name.clone(),
            title: scenario.title.clone(),
            scenario_text: scenario.text.clone(),
            // It is set up by the threads that run it.
            threads: rayon::current_num_threads(),
            seed,
            layout: problem.background.layout().clone(),
            projection: scenario.grid.projection.clone(),
            start: span.start,
            window: scenario.cycle.window,
            done: span.done,
            cycles: span.last,
            score_from_cycle: scenario.cycle.score_from_cycle,
            lead_times: scenario.forecast,
            warnings: placed,
            calibration: problem.calibration.clone(),
            methods: infos,
            has_truth: truth.is_some(),
            truth_file: match &scenario.truth {
                Some(TruthSettings::Series(series)) => Some(series.name().to_string()),
                _ => None,
            },
            keeps_sensors: scenario.sensors.is_some(),
            networks: networks.collect(),
            notes: notices::information(scenario, &observing, &recorded),
            stations: stations.collect(),
        };
        let steps = problem_steps(scenario, &problem);
        let mut warnings = sensors.warnings;
        warnings.extend(notices::warnings(scenario, &observing, &recorded, span.last));
        warnings.extend(notices::of_methods(scenario, chosen));
        warnings.extend(notices::of_thresholds(&info.warnings, &problem));
        Ok(Experiment {
            info,
            influence_every_cycles: scenario.influence_every_cycles,
            truth,
            climate: problem.background.clone(),
            units: UnitCheck::new(&*problem.background_error, &problem.background),
            reference: scenario.quality_control.map(|control| {
                let (background_error, model_error) = (&*problem.background_error, problem.model_error.as_deref());
                Reference::new(
                    control,
                    problem.model,
                    steps,
                    problem.background,
                    within_window,
                    background_error,
                    model_error,
                )
            }),
            observing,
            inputs,
            comparisons,
            recalibrations: sensors.knowledge.recalibrations,
            warnings,
            methods,
        })
    }
}

/// The scenario's warnings with their grid points.
fn placed_warnings(scenario: &Scenario, ground: &Ground) -> Result<Vec<PlacedWarning>, ExperimentError> {
    let layout = ground.problem.background.layout();
    let place = |warning: &ThresholdWarning| {
        let placed = warning.place(layout, ground.observing.stations());
        placed.map_err(|reason| ExperimentError::Warning { name: warning.name.clone(), reason })
    };
    scenario.warnings.iter().map(place).collect()
}

/// The work of a method in a cycle, estimated.
fn work(scenario: &Scenario, method: &Method, problem: &Problem) -> Work {
    let steps = problem_steps(scenario, problem) * problem.model.substeps();
    method.work(&Sizes::new(problem, method.bias, &scenario.grid.grid, steps))
}

/// The time steps of the methods' model in a cycle.
fn problem_steps(scenario: &Scenario, problem: &Problem) -> usize {
    let step = problem.model.time_step();
    scenario.cycle.window.steps_of(step).expect("the scenario's window fits its steps")
}

/// The factor by which an estimate of memory may be too high.
const DOUBT: f64 = 1.5;

/// Sets up one of the scenario's methods, whose first cycle begins at `start`.
///
/// # Errors
/// Those of the method.
pub fn method(
    problem: &Problem,
    name: &str,
    scenario: &Scenario,
    start: Time,
) -> Result<Box<dyn Assimilator>, ExperimentError> {
    method_on(&Alone, problem, name, scenario, start)
}

/// The same on ranks that compute it together.
fn method_on(
    communicator: &dyn Communicator,
    problem: &Problem,
    name: &str,
    scenario: &Scenario,
    start: Time,
) -> Result<Box<dyn Assimilator>, ExperimentError> {
    let fault = |error| ExperimentError::Method { name: name.to_string(), error };
    // The limit of a scenario may be more than the machine has: what is far beyond that is not even tried.
    let settings = &scenario.methods[name];
    let needed_bytes = cost::bytes(&work(scenario, settings, problem)) / communicator.ranks() as f64;
    let is_beyond = |total: &u64| settings.memory_limit_bytes > *total && needed_bytes > DOUBT * *total as f64;
    let beyond = memory::total_bytes().filter(is_beyond).map_or(Ok(()), |total_bytes| {
        let (needed, total) = (memory::in_words(needed_bytes), memory::in_words(total_bytes as f64));
        let message = format!("it would need about {needed}, and this machine has {total}");
        Err(fault(isobar_assim::Error::Setting(message)))
    });
    agreed(communicator, beyond)?;
    let (window, within_window) = (scenario.cycle.window, scenario.observes_within_window());
    let method = settings.build(problem, &scenario.domain(), start, window, within_window).map_err(fault)?;
    if scenario.forecast.is_some() {
        require_room(&*method, settings.memory_limit_bytes, communicator).map_err(fault)?;
    }
    match initialisation(name, scenario) {
        Some(high_pass) => {
            let problem = Problem { memory_limit_bytes: settings.memory_limit_bytes, ..problem.clone() };
            Ok(Box::new(Initialised::new(method, problem, high_pass).map_err(fault)?))
        }
        None => Ok(method),
    }
}

/// How the method of this name is initialised from its first observations, if it is.
fn initialisation(name: &str, scenario: &Scenario) -> Option<HighPassSettings> {
    let initialise = scenario.initialise.as_ref()?;
    initialise.methods.iter().any(|method| method == name).then_some(initialise.high_pass)
}

/// How much was known of the sensors, in words.
fn sensors_in_words(sensors: &WarmStart) -> Option<String> {
    let WarmStart { calibration, knowledge, known, .. } = sensors;
    let (parameters, recalibrations) = (calibration.len(), knowledge.recalibrations.len());
    let words = || format!("{known} of {parameters} sensors known before, {recalibrations} recalibrations announced");
    (*known > 0).then(words)
}
