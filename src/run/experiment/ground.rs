//! All of an experiment but its methods: model, truth, observing system, covariances, what is known of the sensors.

use super::balance;
use super::error::ExperimentError;
use super::known_biases;
use super::span::Span;
use crate::kinds::{covariances, forcing};
use crate::run::earlier::Earlier;
use crate::run::through_window::ThroughWindow;
use crate::run::truth::{Series, Truth, Twin};
use crate::scenario::{Scenario, TruthSeries, TruthSettings, TwinSettings};
use crate::sensors::knowledge::{WarmStart, warm_start};
use crate::sensors::{Database, SensorError, database::Missing};
use isobar_assim::{BiasTreatment, Problem, SensorKnowledge, covariance};
use isobar_model::communicator::{Alone, Communicator};
use isobar_model::random::stream;
use isobar_model::{Adjoint, BandedModel, ModelError, check_time_step};
use isobar_obs::{Network, ObservationError, ObservingSystem};
use std::sync::Arc;

/// Everything of an experiment but its methods, which cost memory and time to set up.
pub struct Ground {
    /// What the methods are given.
    pub problem: Problem,
    /// What is known of the sensors.
    pub sensors: WarmStart,
    /// The true world; `None` where all observations are recorded.
    pub truth: Option<Truth>,
    /// What observes it.
    pub observing: ObservingSystem,
}

/// Sets up all of a scenario but its methods.
///
/// # Errors
/// As [`ExperimentBuilder::build`](super::ExperimentBuilder::build).
pub fn ground(scenario: &Scenario, seed: u64, cycles: usize) -> Result<Ground, ExperimentError> {
    ground_after(
        scenario,
        seed,
        Span::new(scenario, Some(cycles), None),
        None,
        &(Arc::new(Alone) as Arc<dyn Communicator>),
    )
}

/// The same of a run that goes on from earlier ones, and is computed by ranks together. Nothing is exchanged between them here.
pub(super) fn ground_after(
    scenario: &Scenario,
    seed: u64,
    span: Span,
    earlier: Option<&Earlier>,
    communicator: &Arc<dyn Communicator>,
) -> Result<Ground, ExperimentError> {
    let grid = &scenario.grid.grid;
    check_forcings(scenario, span)?;
    let model = scenario.model.build(grid, scenario.cycle.window)?;
    let background = scenario.initial.build(&scenario.domain(), seed)?.valid_at(span.start);
    balance::check(scenario, &background)?;
    check_time_step(&*model, &background).map_err(ExperimentError::TimeStep)?;
    let model = divided(model, communicator)?;
    let build = |components| covariances::build(components, background.layout()).map_err(ExperimentError::Covariance);
    let background_error = build(&scenario.background_error)?;
    let has_model_error = !scenario.model_error.is_empty();
    let model_error = has_model_error.then(|| build(&scenario.model_error)).transpose()?;

    let twin = |settings: &TwinSettings| -> Result<Twin, ExperimentError> {
        let state = match &settings.initial {
            Some(initial) => {
                let state = initial.build(&scenario.domain_of(&settings.model), seed);
                state.map_err(ExperimentError::TrueModel)?.valid_at(span.start)
            }
            None => {
                let mut state = background.clone();
                let deviation = covariance::randomize(&*background_error, &mut stream(seed, "truth/initial"));
                let factor = settings.background_error_scale.sqrt();
                state.values_mut().iter_mut().zip(deviation).for_each(|(value, change)| *value += factor * change);
                state
            }
        };
        let model = settings.model.build(grid, scenario.cycle.window).map_err(ExperimentError::TrueModel)?;
        check_time_step(&*model, &state).map_err(ExperimentError::TrueTimeStep)?;
        let model = divided(model, communicator).map_err(ExperimentError::TrueModel)?;
        let steps = scenario.cycle.window.steps_of(model.time_step()).expect("the scenario's window fits its steps");
        let error = model_error.clone().map(|covariance| (covariance, settings.model_error_scale.sqrt()));
        check_times(scenario, steps)?;
        let keeps_window = scenario.networks.iter().any(|network| network.times_per_window > 1);
        let run = ThroughWindow::new(model, steps, state, keeps_window);
        Ok(Twin::new(run, span.last, error, stream(seed, "truth/model error")))
    };
    let begin = span.start + scenario.cycle.window * span.done;
    let series = |series: &TruthSeries| {
        Series::new(series.clone(), begin, scenario.cycle.window).map_err(ExperimentError::Truth)
    };
    let truth = match &scenario.truth {
        None => None,
        Some(TruthSettings::Twin(settings)) => Some(Truth::Twin(Box::new(twin(settings)?))),
        Some(TruthSettings::Series(settings)) => {
            // Of its states only those at the ends of the cycles are known.
            check_times(scenario, 1)?;
            Some(Truth::Series(series(settings)?))
        }
    };

    let projection = scenario.grid.projection.as_ref();
    let (networks, window) = (&scenario.networks, scenario.cycle.window);
    let observing = ObservingSystem::new(background.layout(), projection, networks, seed, window, span.start)?;
    known_biases::check(scenario, &observing)?;
    let mut sensors = sensors(scenario, &observing, span)?;
    if let Some((calibration, known)) = earlier.and_then(|earlier| earlier.sensors.as_ref()) {
        sensors.go_on(calibration, known, begin);
    }
    let problem = Problem {
        model,
        background,
        background_error,
        model_error,
        calibration: sensors.calibration.clone(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: u64::MAX,
        most_observations: observing.most_observations(span.cycles()),
    };
    Ok(Ground { problem, sensors, truth, observing })
}

/// A model whose work ranks divide, if there are several.
fn divided(model: Arc<dyn Adjoint>, communicator: &Arc<dyn Communicator>) -> Result<Arc<dyn Adjoint>, ModelError> {
    if communicator.ranks() == 1 {
        return Ok(model);
    }
    Ok(Arc::new(BandedModel::new(model, Arc::clone(communicator))?))
}

/// Refuses a source that is not known at all times of a run: of the model until the end of the longest forecast ahead.
fn check_forcings(scenario: &Scenario, span: Span) -> Result<(), ExperimentError> {
    let Scenario { model, truth, cycle, .. } = scenario;
    let ahead = scenario.forecast.map_or(0, |times| times.longest_cycles);
    let of_truth = match truth {
        Some(TruthSettings::Twin(twin)) => Some((true, &twin.model.forcing, 0)),
        _ => None,
    };
    for (of_truth, forcing, beyond) in [(false, &model.forcing, ahead)].into_iter().chain(of_truth) {
        let [begin, end] = [span.done, span.last + beyond].map(|cycle_number| span.start + cycle.window * cycle_number);
        if let Some((number, known)) = forcing::unknown_between(forcing, begin, end) {
            return Err(ExperimentError::Forcing { of_truth, number, needed: (begin, end), known });
        }
    }
    Ok(())
}

/// Refuses networks that observe at other times than those of the `states` true states of a cycle, at equal intervals.
fn check_times(scenario: &Scenario, states: usize) -> Result<(), ExperimentError> {
    let misses = |network: &&Network| !states.is_multiple_of(network.times_per_window.max(1));
    let Some(network) = scenario.networks.iter().find(misses) else { return Ok(()) };
    let problem = match states {
        1 => "times_per_window is above 1, but the true states are known at the ends of the cycles only; leave it out"
            .into(),
        _ => format!(
            "times_per_window is {}, but a cycle has {states} time steps of the truth, whose states are observed; it must be \
             one of {}",
            network.times_per_window,
            divisors(states)
        ),
    };
    Err(ObservationError::in_setting(&network.name, "times_per_window", problem).into())
}

/// The divisors of a number, in words; the larger ones are left out where there are many.
fn divisors(number: usize) -> String {
    const MOST: usize = 12;
    let all: Vec<String> = (1..=number).filter(|it| number.is_multiple_of(*it)).map(|it| it.to_string()).collect();
    let more = if all.len() > MOST { ", …" } else { "" };
    all[..all.len().min(MOST)].join(", ") + more
}

/// What the database of sensors knows at the start of a run, or of the first of those from which it goes on; nothing without one.
fn sensors(scenario: &Scenario, observing: &ObservingSystem, span: Span) -> Result<WarmStart, SensorError> {
    let calibration = observing.calibration();
    let Some(settings) = &scenario.sensors else {
        let knowledge = SensorKnowledge { mean: vec![0.0; calibration.len()], recalibrations: Vec::new() };
        return Ok(WarmStart { calibration: calibration.clone(), knowledge, known: 0, warnings: Vec::new() });
    };
    let missing = if settings.writes.is_some() { Missing::Create } else { Missing::Refuse };
    let records = Database::records_at(&settings.database, missing)?;
    let end = span.start + scenario.cycle.window * span.last;
    warm_start(&records, calibration, span.start, end).map_err(|reason| SensorError::new(&settings.database, reason))
}
