//! The runs of a batch: as many at a time as threads and memory allow.

use super::side_by_side::side_by_side;
use super::temporary;
use crate::memory;
use crate::options::RunOptions;
use crate::output::directory::SUMMARY_FILE;
use crate::output::recorded::SavedRun;
use crate::output::working::{self, checkpoints};
use crate::progress::{RunListener, RunsProgress};
use crate::run::RunError;
use crate::scenario::Scenario;
use crate::scores::Summary;
use crate::scores::kinds::MEMORY;
use miette::Report;
use serde::Serialize;
use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::thread;

/// Cycles of the run that shows how much memory one takes.
const TRIAL_CYCLES: usize = 2;

/// The share of the available memory that all runs together may take.
const MEMORY_SHARE: f64 = 0.7;

/// What a run takes beyond its methods: truth, observations, files \[bytes\].
pub const OTHER_BYTES: u64 = 50_000_000;

/// What runs an experiment: a listener hears its events.
pub type Run<'a> = dyn Fn(&Scenario, &RunOptions, &mut RunListener<'_>) -> Result<Summary, JobError> + Sync + 'a;

/// What runs the experiments of a batch, and where.
pub struct Runner<'a> {
    /// Runs one.
    pub run: Box<Run<'a>>,
    /// The processes that compute them; `None`: this one.
    pub elsewhere: Option<Elsewhere>,
}

/// Other processes that compute one run each at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Elsewhere {
    /// Their number.
    pub processes: usize,
    /// The threads that each of them has.
    pub threads_each: usize,
}

impl<'a> Runner<'a> {
    /// One that computes in this process.
    pub fn here(
        run: impl Fn(&Scenario, &RunOptions, &mut RunListener<'_>) -> Result<Summary, JobError> + Sync + 'a,
    ) -> Self {
        Self { run: Box::new(run), elsewhere: None }
    }
}

/// Why a run ended early.
#[derive(Debug)]
pub struct JobError {
    /// What is said of it.
    pub report: Report,
    /// Whether the same run could be completed another time: it failed for want of space or the like, and not for what it
    /// computes.
    pub may_pass: bool,
    /// Whether the checkpoint from which it was to go on cannot be used.
    pub cannot_resume: bool,
}

impl JobError {
    /// Of a run's error, with what `report` says of it.
    pub fn new(error: RunError, report: impl FnOnce(RunError) -> Report) -> Self {
        let (may_pass, cannot_resume) = (error.may_pass(), error.cannot_resume());
        Self { report: report(error), may_pass, cannot_resume }
    }
}

impl From<JobError> for Report {
    fn from(error: JobError) -> Self {
        error.report
    }
}

/// How the runs are distributed over threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Schedule {
    /// Number of runs at the same time.
    pub at_once: usize,
    /// Threads of each.
    pub threads_each: usize,
}

/// One run of a batch.
pub struct Job<'a> {
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The seed.
    pub seed: u64,
    /// The methods; `None`: all of the scenario.
    pub methods: Option<Vec<String>>,
    /// The directory of its files.
    pub out: PathBuf,
}

/// The number of a job, and what came of it.
pub type JobOutcome = (usize, Result<Summary, JobError>);

/// Runs all jobs, as many at a time as threads and memory allow, with the options of all; the outcomes come in the order of
/// the jobs. One whose files are complete is not run again, and one with a checkpoint goes on from there. After a signal no more
/// are begun, those under way end with a checkpoint, and the outcomes are those of the others.
///
/// A run that fails does not keep the others from being run. Whatever the schedule, every run has the same bits.
///
/// # Errors
/// If nothing can be written for a trial.
pub fn run_jobs(
    jobs: &[Job<'_>],
    options: &RunOptions,
    runner: &Runner<'_>,
    progress: &RunsProgress,
) -> Result<(Schedule, Vec<JobOutcome>), Report> {
    let left = jobs.iter().filter(|job| !is_complete(job)).count();
    let schedule = schedule(jobs, options, left, runner)?;
    let work = |number: usize| {
        let job = &jobs[number];
        let listener = &mut progress.listener(format!("seed {}", job.seed));
        if is_complete(job) {
            let saved = SavedRun::open(&job.out).map(|saved| saved.summary);
            return saved.map_err(|error| JobError { report: error.into(), may_pass: true, cannot_resume: false });
        }
        complete(job, &options_of(job, options, schedule, runner), &*runner.run, listener)
    };
    let mut outcomes = Vec::with_capacity(jobs.len());
    side_by_side(jobs.len(), schedule.at_once, work, |number, outcome| outcomes.push((number, outcome)));
    Ok((schedule, outcomes))
}

/// Whether a run was complete before. A run's directory has its name only when it is.
fn is_complete(job: &Job<'_>) -> bool {
    job.out.join(SUMMARY_FILE).is_file()
}

/// Runs a job, from its last checkpoint if it has one that can be used.
fn complete(
    job: &Job<'_>,
    options: &RunOptions,
    run: &Run<'_>,
    listener: &mut RunListener<'_>,
) -> Result<Summary, JobError> {
    let has_checkpoint = working::path(&job.out).is_ok_and(|working| !checkpoints(&working).is_empty());
    if has_checkpoint {
        match run(job.scenario, &RunOptions { resume: true, ..options.clone() }, listener) {
            Err(error) if error.cannot_resume => {}
            outcome => return outcome,
        }
    }
    run(job.scenario, &RunOptions { overwrite: has_checkpoint, ..options.clone() }, listener)
}

fn options_of(job: &Job<'_>, options: &RunOptions, schedule: Schedule, runner: &Runner<'_>) -> RunOptions {
    RunOptions {
        out: job.out.clone(),
        methods: job.methods.clone(),
        seed: Some(job.seed),
        threads: Some(schedule.threads_each),
        concurrent: schedule.at_once > 1 && runner.elsewhere.is_none(),
        overwrite: false,
        resume: false,
        ..options.clone()
    }
}

/// A run for each of the other processes; or as many at a time as there are threads, as far as they fit into memory, and the threads
/// divided among them.
fn schedule(jobs: &[Job<'_>], options: &RunOptions, left: usize, runner: &Runner<'_>) -> Result<Schedule, Report> {
    if let Some(Elsewhere { processes, threads_each }) = runner.elsewhere {
        let at_once = processes.min(left).max(1);
        return Ok(Schedule { at_once, threads_each: options.threads.unwrap_or(threads_each) });
    }
    Schedule::new(options.threads, left, || {
        let directory = temporary::directory()?;
        Ok(trial(&jobs[0], options, &*runner.run, directory.path()))
    })
}

impl Schedule {
    /// As many of a number of runs at a time as there are threads (`None`: one for each core), as far as they fit into memory, and
    /// the threads divided among them. `needed_bytes` is what one takes, if that is known; it is asked where several could run.
    ///
    /// # Errors
    /// Those of `needed_bytes`.
    pub fn new(
        threads: Option<usize>,
        runs: usize,
        needed_bytes: impl FnOnce() -> Result<Option<u64>, Report>,
    ) -> Result<Self, Report> {
        let threads = threads.unwrap_or_else(|| thread::available_parallelism().map_or(1, usize::from));
        let wanted = threads.min(runs);
        let at_once = match wanted {
            0 | 1 => 1,
            _ => {
                let both = needed_bytes()?.zip(memory::available_bytes());
                both.map_or(1, |(needed_bytes, available_bytes)| fitting(wanted, needed_bytes, available_bytes))
            }
        };
        Ok(Self { at_once, threads_each: (threads / at_once).max(1) })
    }
}

/// The memory that a run takes, from its first cycles; `None` if they fail, which the run itself will report, or if this
/// program does not count memory.
fn trial(job: &Job<'_>, options: &RunOptions, run: &Run<'_>, directory: &Path) -> Option<u64> {
    let cycles = options.cycles.unwrap_or(job.scenario.cycle.count).min(TRIAL_CYCLES);
    let out = directory.join("trial");
    let (cycles, seed) = (Some(cycles), Some(job.seed));
    let RunOptions { methods, threads, concurrent, .. } = options.clone();
    let options = RunOptions { methods, cycles, seed, threads, concurrent, ..RunOptions::new(out) };
    let unheard = RunsProgress::new(true, "", "runs", 1, 0);
    let summary = run(job.scenario, &options, &mut unheard.listener(String::new())).ok()?;
    let of_methods: Option<f64> = summary.methods.values().map(|scores| scores.values.get(MEMORY)).sum();
    Some(of_methods? as u64 + OTHER_BYTES)
}

/// How many of the wanted runs of a size fit; at least one.
fn fitting(wanted: usize, needed_bytes: u64, available_bytes: u64) -> usize {
    let most = MEMORY_SHARE * available_bytes as f64 / needed_bytes as f64;
    (most as usize).clamp(1, wanted.max(1))
}

impl Display for Schedule {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} at a time, each on {} threads", self.at_once, self.threads_each)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    /// A run goes on from its checkpoint, and begins anew where that cannot be used.
    #[test]
    fn a_run_with_a_checkpoint_goes_on_and_one_whose_checkpoint_is_damaged_begins_anew() {
        let parent = tempfile::tempdir().unwrap();
        let scenario = Scenario::parse(Path::new("mine.toml"), include_str!("../cli/template.toml")).unwrap();
        let jobs = ["fresh", "kept", "damaged"].map(|name| Job {
            scenario: &scenario,
            seed: 1,
            methods: None,
            out: parent.path().join(name),
        });
        for job in &jobs[1..] {
            let working = working::path(&job.out).unwrap();
            std::fs::create_dir(&working).unwrap();
            std::fs::write(working.join("checkpoint-0000000003"), "").unwrap();
        }
        let asked = Mutex::new(Vec::new());
        let run = |_: &Scenario, options: &RunOptions, _: &mut RunListener<'_>| {
            let name = options.out.file_name().unwrap().to_string_lossy().into_owned();
            let is_damaged = name == "damaged" && options.resume;
            asked.lock().unwrap().push((name, options.resume, options.overwrite));
            Err(JobError { report: miette::miette!("not run"), may_pass: false, cannot_resume: is_damaged })
        };
        let options = RunOptions { threads: Some(1), ..RunOptions::new(parent.path()) };
        let progress = RunsProgress::new(true, "mine", "seeds", 3, 1);
        let (_, outcomes) = run_jobs(&jobs, &options, &Runner::here(run), &progress).unwrap();
        assert!(outcomes.iter().all(|(_, outcome)| outcome.is_err()));
        let asked = asked.into_inner().unwrap();
        let asked: Vec<(&str, bool, bool)> = asked.iter().map(|it| (it.0.as_str(), it.1, it.2)).collect();
        let again = [("damaged", true, false), ("damaged", false, true)];
        assert_eq!(asked, [[("fresh", false, false), ("kept", true, false)], again].concat());
    }

    #[test]
    fn no_more_runs_at_a_time_than_fit_into_memory_but_always_one() {
        let gigabyte = 1_000_000_000;
        assert_eq!(fitting(8, gigabyte, 100 * gigabyte), 8);
        assert_eq!(fitting(8, gigabyte, 5 * gigabyte), 3);
        assert_eq!(fitting(8, gigabyte, gigabyte), 1);
        assert!(memory::available_bytes().is_none_or(|bytes| bytes > 1_000_000));
    }
}
