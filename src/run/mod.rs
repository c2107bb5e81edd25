//! A run: truth, observations, every method, verification, outputs; cycle after cycle.

mod after_cycle;
mod agreement;
mod ahead;
pub mod checkpoint;
pub mod comparisons;
mod cost;
pub mod cycle;
mod cycles;
mod divided;
pub mod earlier;
mod error;
mod events;
pub mod experiment;
mod influence;
pub mod monitor;
pub mod reference;
mod summary;
mod through_window;
pub mod truth;
pub mod units;

pub(crate) use agreement::agreed;
pub use divided::{Undivided, check_divided};
pub use error::RunError;

use crate::event::{Event, RunInfo};
use crate::memory;
use crate::options::RunOptions;
use crate::output::{Existing, OutputDirectory, STATE, Sink, SinkError, open_all, working};
use crate::scenario::Scenario;
use crate::scores::{RunScores, Scorecard, Summary};
use crate::sensors::table;
use crate::sensors::write_back::{self, SENSORS_FILE};
use crate::tables::warnings::without_skill;
use crate::text::shown_path;
use agreement::{of_first, same};
use checkpoint::saved::take_part;
use checkpoint::{Keeper, Newest, Plan, file, journal, newest};
use cycles::{Cycles, Shown};
use earlier::{Earlier, EarlierRun};
use events::Events;
use experiment::{Competitor, Experiment, ExperimentBuilder};
use isobar_assim::CalibrationAccuracy;
use isobar_model::communicator::Communicator;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::borrow::Cow;
use std::path::Path;

/// Runs a scenario, or continues it from its last checkpoint; `listener` hears all events beside the outputs. A method that
/// fails is marked in the summary, and the run continues with the others.
///
/// # Errors
/// Nothing is left in the output directory's place if there is one, and the last checkpoint stays.
pub fn run(scenario: &Scenario, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, RunError> {
    Experiment::builder(scenario).run(options, listener)
}

/// What is to be done once a run's outputs have their final name, with their directory, but before the run counts as done:
/// whether it was. What was not done can be done later, see [`finish()`].
pub type Afterwards<'a> = &'a mut dyn FnMut(&Path) -> bool;

/// As [`run()`], with something to be done afterwards.
///
/// # Errors
/// As [`run()`].
pub fn run_then(
    scenario: &Scenario,
    options: &RunOptions,
    listener: &mut dyn Sink,
    afterwards: Afterwards<'_>,
) -> Result<Summary, RunError> {
    Experiment::builder(scenario).run_all(options, listener, Some(afterwards))
}

/// Gives the outputs of a run or batch that are complete their final name, if they have it not yet, and does what was to be
/// done afterwards.
///
/// # Errors
/// If the outputs cannot have their name, or something remains that cannot be removed.
pub fn finish(out: &Path, afterwards: Afterwards<'_>) -> Result<(), SinkError> {
    let directory = OutputDirectory::finish(out)?;
    directory.publish()?;
    if afterwards(out) { directory.clear_away() } else { Ok(()) }
}

/// The experiment of a scenario with one of its methods, in the state in which a run of it ended, to ask what comes next.
///
/// # Errors
/// If the run has no state that can be used, or the scenario is another one.
pub fn reopen(scenario: &Scenario, from: &Path, method: &str) -> Result<Experiment, RunError> {
    let refuse = |reason: String| RunError::Earlier { directory: from.to_path_buf(), reason };
    let run = EarlierRun::read(from).map_err(refuse)?;
    let options = RunOptions {
        methods: Some(vec![method.to_string()]),
        cycles: Some(1),
        seed: Some(run.seed()),
        ..RunOptions::new(from)
    };
    let earlier = run.check_end(scenario, &options).map_err(refuse)?;
    let mut experiment = Experiment::builder(scenario).build_at_end(&options, Some(&earlier))?;
    run.restore(&mut experiment).map_err(refuse)?;
    Ok(experiment)
}

impl ExperimentBuilder<'_> {
    /// Runs the scenario's methods and the added ones, or continues such a run from its last checkpoint.
    ///
    /// # Errors
    /// As [`run()`].
    pub fn run(&self, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, RunError> {
        self.run_all(options, listener, None)
    }

    /// The directory of the outputs, which rank 0 has, the experiment as it is before the first cycle of the run, and the runs from
    /// which it goes on.
    fn set_up(&self, options: &RunOptions, workers: &ThreadPool) -> Result<SetUp, RunError> {
        let communicator = &*self.communicator;
        let existing = if options.overwrite { Existing::Overwrite } else { Existing::Refuse };
        let open = if options.resume { OutputDirectory::resume } else { OutputDirectory::create };
        let open = || {
            let is_first = communicator.rank() == 0;
            let own = is_first.then(|| open(options.out.clone(), existing)).transpose();
            agreed(communicator, own.map_err(RunError::Place))
        };
        let build = |earlier: Option<&Earlier>| workers.install(|| self.build_after(options, earlier));
        let Some(from) = options.from.as_deref().filter(|_| !options.resume) else {
            let directory = open()?;
            let earlier = if options.resume { agreed(communicator, earlier_of(&options.out))? } else { None };
            let experiment = build(earlier.as_ref())?;
            return Ok((directory, experiment, earlier));
        };
        let refuse = |reason: String| RunError::Earlier { directory: from.to_path_buf(), reason };
        let read = || {
            if options.out.canonicalize().is_ok_and(|out| from.canonicalize().is_ok_and(|from| from == out)) {
                return Err(refuse("that is where this run's files are to go: choose another --out".into()));
            }
            let run = EarlierRun::read(from).map_err(refuse)?;
            let earlier = run.check(&self.scenario, options).map_err(refuse)?;
            Ok((run, earlier))
        };
        let (run, earlier) = agreed(communicator, read())?;
        let mut experiment = build(Some(&earlier))?;
        agreed(communicator, run.restore(&mut experiment).map_err(refuse))?;
        // An interrupted run that is to be replaced is discarded only once it is sure that this one can begin.
        Ok((open()?, experiment, Some(earlier)))
    }

    /// As [`run_then()`], if there is something to be done afterwards. Every rank does the same, but files are those of rank 0.
    pub(crate) fn run_all(
        &self,
        options: &RunOptions,
        listener: &mut dyn Sink,
        afterwards: Option<Afterwards<'_>>,
    ) -> Result<Summary, RunError> {
        let (scenario, communicator) = (&*self.scenario, &*self.communicator);
        if communicator.ranks() > 1 {
            check_divided(scenario, options, self.added())?;
        }
        let workers = ThreadPoolBuilder::new().num_threads(options.threads.unwrap_or(0)).build();
        let workers = agreed(communicator, workers.map_err(RunError::from))?;
        let (directory, mut experiment, earlier) = self.set_up(options, &workers)?;
        let plan = Plan::new(scenario, options, &experiment, earlier);
        same(communicator, f64::from(plan.checksum()), "it reads other files than rank 0, or another scenario")?;
        let own = directory.as_ref().map(|directory| open_all(&experiment.info, directory, &options.outputs));
        let sinks = agreed(communicator, own.transpose().map_err(RunError::from))?.unwrap_or_default();
        let structure = of_first(communicator, sinks.shows_structure());
        let shown = Shown { memory: !options.concurrent && memory::is_counted(), structure };
        let mut events = Events { keeper: None, sinks, listener };
        let (scores, done) = if options.resume {
            resume(&options.out, &plan, &mut experiment, &mut events, communicator)?
        } else {
            let begun = begin(directory.as_ref(), plan, &experiment, &mut events, afterwards.is_some());
            agreed(communicator, begun)?;
            let totals = vec![Scorecard::default(); experiment.methods.len()];
            (RunScores { totals, ..RunScores::default() }, experiment.info.done)
        };
        experiment.warnings.iter().try_for_each(|warning| events.announce(&Event::Warning(warning)))?;
        let goes_on = options.outputs.contains(STATE);
        let (experiment, workers) = (&mut experiment, &workers);
        let mut cycles =
            Cycles { experiment: &mut *experiment, scores, events: &mut events, workers, communicator, shown, goes_on };
        let summary = cycles.run(done)?;
        for text in without_skill(&summary) {
            events.announce(&Event::Warning(&text))?;
        }
        let sensors = last_calibration(scenario, experiment);
        let Some(directory) = directory else {
            if goes_on {
                take_part(experiment).map_err(RunError::Unsaved)?;
            }
            events.announce(&Event::Finished(&summary))?;
            return Ok(summary);
        };
        if goes_on {
            earlier::write(directory.path(), scenario, experiment)?;
        }
        if let Some((writer, estimate, accuracy)) = sensors {
            write_sensors(&experiment.info, writer, &estimate, &accuracy, directory.path())?;
        }
        events.announce(&Event::Finished(&summary))?;
        let Events { keeper, sinks, listener } = events;
        // Their files are closed.
        drop((keeper, sinks));
        directory.publish()?;
        if afterwards.is_none_or(|afterwards| afterwards(directory.destination()))
            && let Err(error) = directory.clear_away()
        {
            listener.record(&Event::Warning(&error.to_string()))?;
        }
        Ok(summary)
    }
}

/// What a run has before its first cycle: see [`ExperimentBuilder::set_up`].
type SetUp = (Option<OutputDirectory>, Experiment, Option<Earlier>);

/// Begins a run, with its journal if rank 0 does it.
fn begin(
    directory: Option<&OutputDirectory>,
    plan: Plan,
    experiment: &Experiment,
    events: &mut Events<'_>,
    has_afterwards: bool,
) -> Result<(), RunError> {
    match (directory, plan.policy()) {
        (Some(directory), Some(policy)) => {
            events.keeper = Some(Keeper::start(directory.working(), plan, policy, experiment.info.done)?);
        }
        // Whoever has to do it later finds the plan there.
        (Some(directory), None) if has_afterwards => drop(journal::Journal::create(directory.working(), &plan)?),
        _ => {}
    }
    events.announce(&Event::Started(&experiment.info))?;
    for (method, competitor) in experiment.methods.iter().enumerate() {
        if let Some(failure) = &competitor.failure {
            events.send(&Event::Failed { method, failure: Cow::Borrowed(failure) })?;
        }
    }
    Ok(())
}

/// What a run that was interrupted must know of those from which it goes on, if there are any.
fn earlier_of(out: &Path) -> Result<Option<Earlier>, RunError> {
    let working = working::path(out)?;
    let refuse = |reason| RunError::Resume { directory: working.clone(), reason: format!("journal: {reason}") };
    journal::plan(&working).map(|plan| plan.earlier).map_err(refuse)
}

/// Brings the experiment to the state of the newest readable checkpoint, and sends again all events until then; the scores
/// and the number of cycles so far. Only rank 0 has a journal to go on with.
fn resume(
    out: &Path,
    plan: &Plan,
    experiment: &mut Experiment,
    events: &mut Events<'_>,
    communicator: &dyn Communicator,
) -> Result<(RunScores, usize), RunError> {
    let (working, is_first) = (&*working::path(out)?, communicator.rank() == 0);
    let refuse = |reason: String| RunError::Resume { directory: working.to_path_buf(), reason };
    let Newest { checkpoint, mut memories, damaged } = agreed(communicator, newest(working, plan).map_err(refuse))?;
    let (cycle, bytes) = (checkpoint.saved.cycle, checkpoint.journal_bytes);
    let reason = format!("the newest checkpoint that it can read is that of cycle {cycle}, unlike on rank 0");
    same(communicator, cycle as f64, &reason)?;
    let mut replay = || {
        for (path, reason) in &damaged {
            let text = format!("{}: {reason}; the checkpoint before it is used", shown_path(path));
            events.announce(&Event::Warning(&text))?;
        }
        events.announce(&Event::Started(&experiment.info))?;
        let send = &mut |event: Event<'_>| events.announce(&event);
        let replayed = if is_first { journal::replay(working, bytes, &experiment.info, send) } else { Ok(()) };
        replayed.map_err(|reason| refuse(format!("journal: {reason}")))
    };
    agreed(communicator, replay())?;
    let scores =
        checkpoint.restore(&mut memories, experiment).map_err(|reason| refuse(format!("checkpoint: {reason}")));
    let scores = agreed(communicator, scores)?;
    let policy = plan.policy().filter(|_| is_first);
    let keeper = policy.map(|policy| Keeper::resume(working, plan.clone(), policy, cycle, bytes)).transpose();
    events.keeper = agreed(communicator, keeper.map_err(RunError::from))?;
    if is_first {
        // Under their names they would be taken for checkpoints of what is about to be computed.
        damaged.iter().for_each(|(path, _)| file::put_aside(path));
    }
    events.announce(&Event::Resumed(cycle))?;
    Ok((scores, cycle))
}

/// The last calibration of the method that the scenario names for the database of sensors, with the method's name.
fn last_calibration<'a>(
    scenario: &'a Scenario,
    experiment: &Experiment,
) -> Option<(&'a str, Vec<f64>, CalibrationAccuracy)> {
    let writer = scenario.sensors.as_ref()?.writes.as_ref()?;
    let Experiment { info, methods, .. } = experiment;
    let number = info.methods.iter().position(|method| method.name == *writer)?;
    let Competitor { runner, failure, .. } = &methods[number];
    let (estimate, accuracy) = runner.calibration().filter(|_| failure.is_none())?;
    Some((writer, estimate, accuracy))
}

/// Writes the last calibration of a method, for the database of sensors.
fn write_sensors(
    info: &RunInfo,
    writer: &str,
    estimate: &[f64],
    accuracy: &CalibrationAccuracy,
    directory: &Path,
) -> Result<(), SinkError> {
    let path = directory.join(SENSORS_FILE);
    let written = write_back::records(info, writer, estimate, accuracy.covariance())
        .and_then(|records| std::fs::write(&path, table::write(&records)).map_err(|error| error.to_string()));
    written.map_err(|reason| SinkError { path, reason })
}
