//! A run: truth, observations, every method, verification, sinks; cycle after cycle.

use crate::cli::RunOptions;
use crate::event::{Analysed, Event};
use crate::experiment::{Experiment, ExperimentError};
use crate::scenario::Scenario;
use crate::scenario::text::clean;
use crate::sink::{Existing, OutputDirectory, Outputs, Sink, SinkError, open_all};
use crate::summary::{Failure, MethodScores, Summary};
use crate::verify::{Scorecard, TrueValues};
use isobar_model::ForecastError;
use rayon::{ThreadPool, ThreadPoolBuilder};

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
    /// An output could not be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// No threads could be started.
    #[error("cannot start the threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// Runs a scenario; `listener` hears all events beside the files. A method that fails is marked in the summary, and the
/// run goes on with the others.
///
/// # Errors
/// Nothing is left in the output directory's place if there is one.
pub fn run(scenario: &Scenario, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, RunError> {
    let workers = ThreadPoolBuilder::new().num_threads(options.threads.unwrap_or(0)).build()?;
    let existing = if options.overwrite { Existing::Overwrite } else { Existing::Refuse };
    let directory = OutputDirectory::create(&options.out, existing)?;
    let mut experiment = workers.install(|| Experiment::new(scenario, options))?;
    let RunOptions { netcdf, rerun, report, live, .. } = *options;
    let outputs = Outputs { netcdf, rerun, report, live };
    let mut sinks = open_all(&experiment.info, &directory, outputs)?;
    let mut send = |event: Event<'_>| {
        sinks.record(&event)?;
        for warning in sinks.warnings() {
            listener.record(&Event::Warning(&warning))?;
        }
        listener.record(&event)
    };
    let shown = Shown { memory: !options.concurrent, structure: rerun || report || live };
    let summary = cycles(&mut experiment, &workers, shown, &mut send)?;
    send(Event::Finished(&summary))?;
    drop(sinks);
    directory.complete()?;
    Ok(summary)
}

/// What is found out beside the scores.
#[derive(Clone, Copy)]
struct Shown {
    /// The memory of each method, which cannot be told apart where several experiments run at once.
    memory: bool,
    /// Blocks and common factors.
    structure: bool,
}

fn cycles(
    experiment: &mut Experiment,
    workers: &ThreadPool,
    shown: Shown,
    send: &mut dyn FnMut(Event<'_>) -> Result<(), SinkError>,
) -> Result<Summary, RunError> {
    let Experiment { info, score_from_cycle, truth, observing, methods } = experiment;
    let mut totals = vec![Scorecard::default(); methods.len()];
    send(Event::Started(info))?;
    send(Event::Truth { cycle: 0, time: info.start, state: truth.state(), calibration: observing.true_calibration() })?;
    for cycle in 1..=info.cycles {
        workers.install(|| truth.advance()).map_err(|error| RunError::Truth { cycle, error })?;
        let observed = observing.observe(truth.state());
        let time = observed.time;
        let truth = TrueValues { state: truth.state(), calibration: observing.true_calibration() };
        send(Event::Truth { cycle, time, state: truth.state, calibration: truth.calibration })?;
        send(Event::Observed(&observed))?;
        for (number, method) in methods.iter_mut().enumerate().filter(|(_, method)| method.failure.is_none()) {
            let outcome = match workers.install(|| method.runner.cycle(info.window, &observed)) {
                Ok(outcome) => outcome,
                Err(fault) => {
                    let failure = method.failure.insert(Failure { cycle, reason: clean(&fault.to_string()) });
                    send(Event::Failed { method: number, failure })?;
                    continue;
                }
            };
            let scores = Scorecard::of_cycle(truth, &outcome, &info.calibration, method.scores_bias);
            if cycle >= *score_from_cycle {
                totals[number].add(&scores);
            }
            let factors = shown_factors(cycle, info.cycles);
            let structure = || method.runner.structure(&observed, factors);
            send(Event::Analysed(Analysed {
                method: number,
                cycle,
                time,
                background: &outcome.background,
                analysis: &outcome.analysis,
                scores: &MethodScores {
                    seconds_per_cycle: outcome.seconds,
                    peak_memory_bytes: shown.memory.then_some(method.runner.peak_bytes),
                    ..scores.scores(&info.layout)
                },
                structure: shown.structure.then(structure).flatten().as_ref(),
            }))?;
        }
        send(Event::CycleEnded(cycle))?;
    }
    let scores = info.methods.iter().zip(&totals).zip(methods).map(|((own, total), method)| {
        let cycles = method.failure.as_ref().map_or(info.cycles, |failure| failure.cycle);
        let scores = MethodScores {
            seconds_per_cycle: method.runner.seconds / cycles as f64,
            peak_memory_bytes: shown.memory.then_some(method.runner.peak_bytes),
            failure: method.failure.clone(),
            // Scores of fewer cycles could not be compared with those of the other methods.
            ..if method.failure.is_none() { total.scores(&info.layout) } else { MethodScores::default() }
        };
        (own.name.clone(), scores)
    });
    Ok(Summary {
        scenario: info.scenario.clone(),
        seed: info.seed,
        cycles: info.cycles,
        scored_from_cycle: *score_from_cycle,
        version: env!("CARGO_PKG_VERSION").to_string(),
        methods: scores.collect(),
    })
}

/// How many common factors are shown: a few, and in the first, the last and some cycles between, since each is as large
/// as a state.
fn shown_factors(cycle: usize, cycles: usize) -> usize {
    const FACTORS: usize = 5;
    let every = cycles.div_ceil(8);
    if cycle == 1 || cycle == cycles || cycle.is_multiple_of(every) { FACTORS } else { 0 }
}
