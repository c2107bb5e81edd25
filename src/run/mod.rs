//! A run: truth, observations, every method, verification, sinks; cycle after cycle.

pub mod cycle;
mod influence;
pub mod monitor;
pub mod reference;
pub mod truth;

use crate::checkpoint::{self, Keeper, Newest, Plan, journal, newest};
use crate::correlations::Correlations;
use crate::event::{Analysed, Estimated, Event, Smoothed};
use crate::experiment::{Competitor, Experiment, ExperimentError};
use crate::interrupt;
use crate::memory;
use crate::options::RunOptions;
use crate::scenario::Scenario;
use crate::sensors::table;
use crate::sensors::write_back::{self, SENSORS_FILE};
use crate::sink::{Existing, OutputDirectory, Sink, SinkError, open_all};
use crate::smoothed::SmoothedScorecard;
use crate::summary::{Failure, MethodScores, Summary};
use crate::text::clean;
use crate::verify::{Scorecard, Scores, TrueValues};
use isobar_model::ForecastError;
use rayon::{ThreadPool, ThreadPoolBuilder};
use reference::Reference;
use std::path::{Path, PathBuf};

/// Why a run ended early.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The scenario cannot become an experiment.
    #[error(transparent)]
    Experiment(#[from] ExperimentError),
    /// The truth left the finite numbers.
    #[error("cycle {cycle}, truth: {error}")]
    Truth {
        /// The cycle.
        cycle: usize,
        /// Why.
        error: ForecastError,
    },
    /// A signal ended the run after a cycle.
    #[error("ended by a signal after cycle {cycle} of {cycles}")]
    Interrupted {
        /// The last complete cycle.
        cycle: usize,
        /// The run's number of cycles.
        cycles: usize,
    },
    /// The run cannot be resumed.
    #[error("{} cannot be resumed: {reason}", directory.display())]
    Resume {
        /// The working directory.
        directory: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The output directory cannot be created or is in use.
    #[error(transparent)]
    Place(SinkError),
    /// An output could not be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// No threads could be started.
    #[error("cannot start the threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// Runs a scenario, or goes on with it from its last checkpoint; `listener` hears all events beside the files. A method that
/// fails is marked in the summary, and the run goes on with the others.
///
/// # Errors
/// Nothing is left in the output directory's place if there is one, and the last checkpoint stays.
pub fn run(scenario: &Scenario, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, RunError> {
    let workers = ThreadPoolBuilder::new().num_threads(options.threads.unwrap_or(0)).build()?;
    let existing = if options.overwrite { Existing::Overwrite } else { Existing::Refuse };
    let open = if options.resume { OutputDirectory::resume } else { OutputDirectory::create };
    let directory = open(options.out.clone(), existing).map_err(RunError::Place)?;
    let mut experiment = workers.install(|| Experiment::new(scenario, options))?;
    let plan = Plan::new(scenario, options, &experiment);
    let mut sinks = open_all(&experiment.info, &directory, &options.outputs)?;
    let shown = Shown { memory: !options.concurrent && memory::is_counted(), structure: sinks.shows_structure() };
    let mut tell = |event: Event<'_>| {
        sinks.record(&event)?;
        for warning in sinks.warnings() {
            listener.record(&Event::Warning(&warning))?;
        }
        listener.record(&event)
    };
    let totals = vec![Scorecard::default(); experiment.methods.len()];
    let scores = Scores { totals, ..Scores::default() };
    let mut progress = Progress { keeper: None, scores, cycle: 0 };
    if options.resume {
        progress = resume(&directory, &plan, &mut experiment, &mut tell)?;
    } else {
        if let Some(policy) = options.checkpoints {
            progress.keeper = Some(Keeper::start(directory.working(), plan, policy)?);
        }
        tell(Event::Started(&experiment.info))?;
    }
    experiment.warnings.iter().try_for_each(|warning| tell(Event::Warning(warning)))?;
    let summary = cycles(&mut experiment, progress, &workers, shown, &mut tell)?;
    write_sensors(scenario, &experiment, directory.path())?;
    tell(Event::Finished(&summary))?;
    drop(sinks);
    directory.complete()?;
    Ok(summary)
}

/// Writes the last calibration of the method that the scenario names, for the database of sensors.
fn write_sensors(scenario: &Scenario, experiment: &Experiment, directory: &Path) -> Result<(), SinkError> {
    let Some(writer) = scenario.sensors.as_ref().and_then(|sensors| sensors.writes.as_ref()) else { return Ok(()) };
    let Experiment { info, methods, .. } = experiment;
    let Some(number) = info.methods.iter().position(|method| method.name == *writer) else { return Ok(()) };
    let Competitor { runner, failure, .. } = &methods[number];
    let Some((estimate, accuracy)) = runner.calibration().filter(|_| failure.is_none()) else { return Ok(()) };
    let path = directory.join(SENSORS_FILE);
    let written = write_back::records(info, writer, &estimate, accuracy.covariance())
        .and_then(|records| std::fs::write(&path, table::write(&records)).map_err(|error| error.to_string()));
    written.map_err(|reason| SinkError { path, reason })
}

/// What is found out beside the scores.
#[derive(Clone, Copy)]
struct Shown {
    /// The memory of each method, which cannot be told apart where several experiments run at once.
    memory: bool,
    /// Blocks and common factors.
    structure: bool,
}

/// What a run is in the middle of.
struct Progress {
    /// Journal and checkpoints, if there are to be any.
    keeper: Option<Keeper>,
    /// What it has come to so far.
    scores: Scores,
    /// The last complete cycle.
    cycle: usize,
}

type Tell<'a> = dyn FnMut(Event<'_>) -> Result<(), SinkError> + 'a;

/// Brings the experiment to where the newest readable checkpoint has it, and tells again all that happened until then.
fn resume(
    directory: &OutputDirectory,
    plan: &Plan,
    experiment: &mut Experiment,
    tell: &mut Tell<'_>,
) -> Result<Progress, RunError> {
    let working = directory.working();
    let refuse = |reason: String| RunError::Resume { directory: working.to_path_buf(), reason };
    let Newest { checkpoint, memories, damaged } = newest(working, plan).map_err(refuse)?;
    for (path, reason) in &damaged {
        let text = format!("{}: {reason}; the checkpoint before it is used", clean(&path.display().to_string()));
        tell(Event::Warning(&text))?;
    }
    let (cycle, bytes) = (checkpoint.cycle, checkpoint.journal_bytes);
    tell(Event::Started(&experiment.info))?;
    journal::replay(working, bytes, &experiment.info, tell).map_err(|reason| refuse(format!("journal: {reason}")))?;
    let scores = checkpoint.restore(&memories, experiment).map_err(|reason| refuse(format!("checkpoint: {reason}")))?;
    let keeper = plan.policy().map(|policy| Keeper::resume(working, plan.clone(), policy, cycle, bytes)).transpose()?;
    // Put aside, so that nobody takes them for checkpoints of what is about to be computed.
    damaged.iter().for_each(|(path, _)| checkpoint::file::put_aside(path));
    tell(Event::Resumed(cycle))?;
    Ok(Progress { keeper, scores, cycle })
}

fn cycles(
    experiment: &mut Experiment,
    mut progress: Progress,
    workers: &ThreadPool,
    shown: Shown,
    tell: &mut Tell<'_>,
) -> Result<Summary, RunError> {
    let info = experiment.info.clone();
    let Progress { keeper, scores, cycle: done } = &mut progress;
    if *done == 0 {
        let (state, calibration) = (experiment.truth.state(), experiment.observing.true_calibration());
        note(keeper, tell, Event::Truth { cycle: 0, time: info.start, state, calibration })?;
    }
    for cycle in *done + 1..=info.cycles {
        one_cycle(experiment, cycle, scores, workers, shown, &mut |event| note(keeper, tell, event))?;
        if let Some(keeper) = keeper
            && (keeper.is_due(cycle) || interrupt::requested())
        {
            keeper.write(cycle, experiment, scores)?;
        }
        if interrupt::requested() && cycle < info.cycles {
            return Err(RunError::Interrupted { cycle, cycles: info.cycles });
        }
    }
    Ok(summary(experiment, scores, shown))
}

/// Writes an event to the journal, then tells it.
fn note(keeper: &mut Option<Keeper>, tell: &mut Tell<'_>, event: Event<'_>) -> Result<(), SinkError> {
    if let Some(keeper) = keeper {
        keeper.record(&event)?;
    }
    tell(event)
}

fn one_cycle(
    experiment: &mut Experiment,
    cycle: usize,
    scores: &mut Scores,
    workers: &ThreadPool,
    shown: Shown,
    send: &mut Tell<'_>,
) -> Result<(), RunError> {
    let Experiment { info, score_from_cycle, influence_every_cycles, truth, reference, observing, methods, .. } =
        experiment;
    let with_influence =
        cycle >= *score_from_cycle && influence_every_cycles.is_some_and(|every| cycle.is_multiple_of(every));
    workers.install(|| truth.advance()).map_err(|error| RunError::Truth { cycle, error })?;
    if let Some(reference) = reference {
        workers.install(|| reference.advance());
    }
    let observed = observing.observe_checked(truth.state(), reference.as_ref().map(Reference::now));
    scores.observations.add(&observed, &info.layout);
    let time = observed.time;
    let truth = TrueValues { state: truth.state(), calibration: observing.true_calibration() };
    send(Event::Truth { cycle, time, state: truth.state, calibration: truth.calibration })?;
    send(Event::Observed(&observed))?;
    scores.earlier_truths.add(truth, methods.iter().filter_map(|method| method.runner.smoother_lag()).max());
    let last = cycle == info.cycles;
    for (number, method) in methods.iter_mut().enumerate().filter(|(_, method)| method.failure.is_none()) {
        let outcome = match workers.install(|| method.runner.cycle(info.window, &observed, with_influence, last)) {
            Ok(outcome) => outcome,
            Err(fault) => {
                let failure = method.failure.insert(Failure { cycle, reason: clean(&fault.to_string()) });
                send(Event::Failed { method: number, failure })?;
                continue;
            }
        };
        let own = Scorecard::of_cycle(truth, &outcome, &observed, &info.calibration, method.scores_bias);
        if cycle >= *score_from_cycle {
            scores.totals[number].add(&own);
        }
        let factors = shown_factors(cycle, info.cycles);
        let structure = || method.runner.structure(&observed, &outcome.background.state, factors);
        let middle = Correlations::middle(&info.layout);
        let correlations = || method.runner.correlations(middle, &outcome.analysis.estimate);
        send(Event::Analysed(Analysed {
            method: number,
            cycle,
            time,
            background: &outcome.background,
            analysis: &outcome.analysis,
            scores: &MethodScores {
                seconds_per_cycle: outcome.seconds,
                peak_memory_bytes: shown.memory.then_some(method.runner.peak_bytes),
                ..own.scores(&info.layout)
            },
            structure: shown.structure.then(structure).flatten().as_ref(),
            correlations: (shown.structure && cycle == info.cycles).then(correlations).flatten().as_ref(),
        }))?;
        for smoothed in &outcome.smoothed {
            let (ago, lag) = (smoothed.cycles_ago, method.runner.smoother_lag().unwrap_or_default());
            let earlier = cycle - ago;
            let truths = &scores.earlier_truths;
            let own = SmoothedScorecard::of_cycle(truths, ago, &smoothed.estimate, lag, method.scores_bias);
            if let Some(own) = own.as_ref().filter(|_| earlier >= *score_from_cycle) {
                scores.totals[number].add_smoothed(own);
            }
            send(Event::Smoothed(Smoothed {
                method: number,
                cycle: earlier,
                later_cycles: ago,
                estimate: &smoothed.estimate,
                scores: &own.map(|own| own.scores(&info.layout)).unwrap_or_default(),
            }))?;
        }
        let parameters = method.runner.parameters();
        if !parameters.is_empty() {
            send(Event::Estimated(Estimated { method: number, cycle, time, parameters: &parameters }))?;
        }
    }
    send(Event::CycleEnded(cycle))?;
    Ok(())
}

/// How many common factors are shown: a few, and in the first, the last and some cycles between, since each is as large
/// as a state.
fn shown_factors(cycle: usize, cycles: usize) -> usize {
    const FACTORS: usize = 5;
    let every = cycles.div_ceil(8);
    if cycle == 1 || cycle == cycles || cycle.is_multiple_of(every) { FACTORS } else { 0 }
}

/// The scores of a run.
fn summary(experiment: &Experiment, scores: &Scores, shown: Shown) -> Summary {
    let Experiment { info, score_from_cycle, methods, variance_ratio, .. } = experiment;
    let methods = info.methods.iter().zip(&scores.totals).zip(methods).map(|((own, total), method)| {
        let cycles = method.failure.as_ref().map_or(info.cycles, |failure| failure.cycle);
        let scores = MethodScores {
            seconds_per_cycle: method.runner.seconds / cycles as f64,
            peak_memory_bytes: shown.memory.then_some(method.runner.peak_bytes),
            stability: match method.failure {
                None => method.runner.stability(&info.calibration, &info.layout, *variance_ratio).ok(),
                Some(_) => None,
            },
            failure: method.failure.clone(),
            // Scores of fewer cycles could not be compared with those of the other methods.
            ..match method.failure {
                None => MethodScores {
                    diagnostics: Some(total.diagnostics(&info.layout, &info.calibration)),
                    ..total.scores(&info.layout)
                },
                Some(_) => MethodScores::default(),
            }
        };
        (own.name.clone(), scores)
    });
    Summary {
        scenario: info.scenario.clone(),
        seed: info.seed,
        cycles: info.cycles,
        scored_from_cycle: *score_from_cycle,
        version: env!("CARGO_PKG_VERSION").to_string(),
        observations: scores.observations.clone(),
        methods: methods.collect(),
    }
}
