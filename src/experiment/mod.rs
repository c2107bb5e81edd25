//! From a scenario to everything that runs: model, truth, observing system, methods.

mod covariances;
mod forecast_model;
mod initial_state;
mod methods;
mod observing;
mod time_volume;

use crate::cli::RunOptions;
use crate::cycle::Runner;
use crate::event::{MethodInfo, RunInfo, StationInfo};
use crate::reference::Reference;
use crate::scenario::{Algorithm, Scenario, ScenarioError};
use crate::summary::Failure;
use crate::truth::Truth;
use isobar_assim::{Assimilator, BiasTreatment, Problem, covariance};
use isobar_model::random::stream;
use isobar_model::{ModelError, check_time_step};
use isobar_obs::{ObservationError, ObservingSystem};
use std::path::PathBuf;

/// Why a scenario cannot become an experiment.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// The model, or a state of it.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The time step of the methods' or the truth's model.
    #[error("{0}")]
    TimeStep(ModelError),
    /// An observing system.
    #[error(transparent)]
    Observations(#[from] ObservationError),
    /// A covariance.
    #[error("{0}")]
    Covariance(isobar_assim::Error),
    /// A method.
    #[error("method {name}: {error}")]
    Method {
        /// The method's name.
        name: String,
        /// Why it cannot be set up.
        error: isobar_assim::Error,
    },
    /// A station file.
    #[error("cannot read {}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
}

impl ExperimentError {
    /// The same fault with its place in the scenario's file.
    pub fn locate(&self, scenario: &Scenario) -> ScenarioError {
        let (path, label): (Vec<&str>, &str) = match self {
            ExperimentError::TimeStep(_) => (vec!["model", "time_step_s"], "too long"),
            ExperimentError::Model(_) => (vec!["initial"], "with this and [model]"),
            ExperimentError::Covariance(_) => (vec!["background_error"], "here or in [model_error]"),
            ExperimentError::Method { name, .. } => (vec!["methods", name], "this method"),
            ExperimentError::File { .. } => (vec!["networks"], "in one of these"),
            ExperimentError::Observations(error) => (observing::place(error), "here"),
        };
        scenario.fault(&path, self.to_string(), label)
    }
}

/// All that a run needs.
pub struct Experiment {
    /// What is known before the first cycle.
    pub info: RunInfo,
    /// The first cycle that counts for the scores.
    pub score_from_cycle: usize,
    /// In every so-many-th of these cycles it is found out what each type of observations did; `None`: never.
    pub influence_every_cycles: Option<usize>,
    /// The true world.
    pub truth: Truth,
    /// What the values of observations are compared with, if they are checked.
    pub reference: Option<Reference>,
    /// What observes it.
    pub observing: ObservingSystem,
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
}

/// Everything of an experiment but its methods, which cost memory and time to set up.
pub struct Ground {
    /// What the methods are given.
    pub problem: Problem,
    /// The true world.
    pub truth: Truth,
    /// What observes it.
    pub observing: ObservingSystem,
}

/// Whether a scenario's model, initial state, covariances and observing systems fit together.
///
/// # Errors
/// The first thing that does not.
pub fn check(scenario: &Scenario) -> Result<(), ExperimentError> {
    let ground = ground(scenario, scenario.seed)?;
    for (name, method) in &scenario.methods {
        if let Algorithm::TimeVolume { options, .. } = &method.algorithm {
            time_volume::factors(options, &ground.problem.calibration)
                .map_err(|error| ExperimentError::Method { name: name.clone(), error })?;
        }
    }
    Ok(())
}

impl Experiment {
    /// Sets up a scenario.
    ///
    /// # Errors
    /// What the scenario's file alone could not tell: files, stations, time steps, memory.
    pub fn new(scenario: &Scenario, options: &RunOptions) -> Result<Self, ExperimentError> {
        let seed = options.seed.unwrap_or(scenario.seed);
        let Ground { problem, truth, observing } = ground(scenario, seed)?;
        let chosen = |name: &String| options.methods.as_ref().is_none_or(|chosen| chosen.contains(name));
        let (mut methods, mut infos) = (Vec::new(), Vec::new());
        for (name, method) in scenario.methods.iter().filter(|(name, _)| chosen(name)) {
            let runner = Runner::new(|| self::method(&problem, name, scenario))?;
            let scores_bias = methods::sees_observations(method) && method.bias != BiasTreatment::Known;
            methods.push(Competitor { runner, failure: None, scores_bias });
            infos.push(MethodInfo { name: name.clone(), description: methods::describe(method, name, scenario) });
        }
        let stations = observing.stations().iter().map(|station| StationInfo {
            network: station.network.clone(),
            name: station.long_name.clone(),
            group: station.group.clone(),
            x_m: station.x_m,
            y_m: station.y_m,
        });
        let info = RunInfo {
            scenario: scenario.name.clone(),
            title: scenario.title.clone(),
            scenario_text: scenario.text.clone(),
            seed,
            layout: problem.background.layout().clone(),
            projection: scenario.grid.projection.clone(),
            start: scenario.start,
            window: scenario.cycle.window,
            cycles: options.cycles.unwrap_or(scenario.cycle.count),
            calibration: observing.calibration().clone(),
            methods: infos,
            stations: stations.collect(),
        };
        let steps = problem_steps(scenario, &problem);
        Ok(Self {
            info,
            score_from_cycle: scenario.cycle.score_from_cycle,
            influence_every_cycles: scenario.influence_every_cycles,
            truth,
            reference: scenario
                .quality_control
                .map(|control| Reference::new(control, problem.model, steps, problem.background)),
            observing,
            methods,
        })
    }
}

/// The time steps of the methods' model in a cycle.
fn problem_steps(scenario: &Scenario, problem: &Problem) -> usize {
    let step = problem.model.time_step();
    scenario.cycle.window.steps_of(step).expect("the scenario's window fits its steps")
}

/// Sets up one of the scenario's methods.
///
/// # Errors
/// Those of the method.
pub fn method(problem: &Problem, name: &str, scenario: &Scenario) -> Result<Box<dyn Assimilator>, ExperimentError> {
    methods::build(problem, &scenario.methods[name], scenario)
        .and_then(|method| methods::initialised(method, name, problem, scenario))
        .map_err(|error| ExperimentError::Method { name: name.to_string(), error })
}

/// Sets up all of a scenario but its methods.
///
/// # Errors
/// As [`Experiment::new`].
pub fn ground(scenario: &Scenario, seed: u64) -> Result<Ground, ExperimentError> {
    let grid = &scenario.grid.grid;
    let model = forecast_model::build(&scenario.model, grid)?;
    let background = initial_state::build(&scenario.initial, &scenario.model, grid, seed)?;
    check_time_step(&*model, &background).map_err(ExperimentError::TimeStep)?;
    let build = |components| covariances::build(components, &scenario.model, background.layout());
    let background_error = build(&scenario.background_error)?.unwrap_or_else(|| covariances::none(background.layout()));
    let model_error = build(&scenario.model_error)?;

    let mut true_state = background.clone();
    let deviation = covariance::randomize(&*background_error, &mut stream(seed, "truth/initial"));
    let factor = scenario.truth.background_error_scale.sqrt();
    true_state.values_mut().iter_mut().zip(deviation).for_each(|(value, change)| *value += factor * change);
    let true_model = forecast_model::build(&scenario.truth.model, grid)?;
    check_time_step(&*true_model, &true_state).map_err(ExperimentError::TimeStep)?;
    let steps = scenario.cycle.window.steps_of(true_model.time_step()).expect("the scenario's window fits its steps");
    let true_error = model_error.clone().map(|covariance| (covariance, scenario.truth.model_error_scale.sqrt()));
    let truth = Truth::new(true_model, steps, true_error, stream(seed, "truth/model error"), true_state);

    let configs = observing::configs(&scenario.networks, grid)?;
    let projection = scenario.grid.projection.as_ref();
    let observing =
        ObservingSystem::new(background.layout(), projection, &configs, seed, scenario.cycle.window, scenario.start)?;
    let problem = Problem {
        model,
        background,
        background_error,
        model_error,
        calibration: observing.calibration().clone(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: u64::MAX,
    };
    Ok(Ground { problem, truth, observing })
}
