//! Rank 0, as the rest of the program sees it: runs are computed elsewhere.

use super::messages::{FromWorker, Order};
use super::post::{Errand, OneRun, SharedRun};
use super::together;
use crate::batch::{Elsewhere, JobError, Runner};
use crate::options::RunOptions;
use crate::progress::RunListener;
use crate::run::RunError;
use crate::scenario::Scenario;
use crate::scores::Summary;
use isobar_model::communicator::Communicator;
use miette::{Report, miette};
use mpi::environment::Universe;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;

/// MPI is there once in a process, and so is this.
static COORDINATOR: OnceLock<Coordinator> = OnceLock::new();

/// The workers, and the way to them.
pub struct Coordinator {
    workers: usize,
    threads_each: usize,
    /// Those with other vector instructions than rank 0.
    unlike: Vec<i32>,
    /// Whether the workers wait for what will not come.
    is_stuck: AtomicBool,
    /// `None` once the workers have been sent away.
    open: Mutex<Option<Open>>,
}

/// What is open as long as there are workers.
pub struct Open {
    /// To the thread that speaks with the workers.
    pub errands: Sender<Errand>,
    /// That thread, which says whether all workers are alive in the end.
    pub thread: JoinHandle<bool>,
    /// Ends MPI when it is dropped.
    pub universe: Universe,
}

impl Coordinator {
    /// With this number of workers, each with `threads_each` threads; those that are `unlike` have other vector instructions than
    /// this process.
    pub fn new(workers: usize, threads_each: usize, unlike: Vec<i32>, open: Open) -> Self {
        let (is_stuck, open) = (AtomicBool::new(false), Mutex::new(Some(open)));
        Self { workers, threads_each, unlike, is_stuck, open }
    }

    fn open(&self) -> MutexGuard<'_, Option<Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Takes over the workers.
pub fn begin(coordinator: Coordinator) {
    COORDINATOR.get_or_init(|| coordinator);
}

/// Number of workers.
pub fn workers() -> usize {
    COORDINATOR.get().map_or(0, |it| it.workers)
}

/// Sends runs to the workers; `None` if this process has no workers.
pub fn runner() -> Option<Runner<'static>> {
    let coordinator = COORDINATOR.get()?;
    let elsewhere = Elsewhere { processes: coordinator.workers, threads_each: coordinator.threads_each };
    let run = |scenario: &Scenario, options: &RunOptions, listener: &mut RunListener<'_>| {
        have_computed(coordinator, scenario, options, listener)
    };
    Some(Runner { run: Box::new(run), elsewhere: Some(elsewhere) })
}

/// Computes a run together with all workers.
///
/// # Errors
/// If they cannot compute it together.
pub fn share<T>(
    scenario: &Scenario,
    options: &RunOptions,
    run: impl FnOnce(Arc<dyn Communicator>) -> Result<T, RunError>,
) -> Result<Result<T, RunError>, Report> {
    let coordinator = COORDINATOR.get().ok_or_else(|| miette!("this process has no workers"))?;
    if let [first, ..] = coordinator.unlike[..] {
        let help = "run it on processors of one kind, or without the MPI launcher";
        return Err(miette!(
            help = help,
            "{}: rank {first} has other vector instructions than rank 0: they would come to different results",
            scenario.name
        ));
    }
    let ((begun, has_begun), (end, over)) = (mpsc::channel(), mpsc::channel());
    if let Some(open) = &*coordinator.open() {
        // If nobody takes it, it does not begin.
        let _ = open.errands.send(Errand::Share(SharedRun { order: Order::new(scenario, options), begun, over }));
    }
    has_begun.recv().map_err(|_| miette!("{}: a process of the MPI job has died", scenario.name))?;
    let outcome = together::lead(run);
    let is_stuck = outcome.as_ref().is_err_and(RunError::is_of_one_rank);
    coordinator.is_stuck.fetch_or(is_stuck, Ordering::Relaxed);
    drop(end);
    Ok(outcome)
}

/// Sends the workers away, and waits until they know it; ends the job if they cannot hear it.
pub fn leave() {
    let Some(coordinator) = COORDINATOR.get() else { return };
    if coordinator.is_stuck.load(Ordering::Relaxed) {
        together::abort();
    }
    let Some(Open { errands, thread, universe }) = coordinator.open().take() else { return };
    drop(errands);
    if !thread.join().unwrap_or(false) {
        // The end of MPI would wait for those that have died.
        std::mem::forget(universe);
    }
}

/// Has a run computed by a worker that is free, or will be.
fn have_computed(
    coordinator: &Coordinator,
    scenario: &Scenario,
    options: &RunOptions,
    listener: &mut RunListener<'_>,
) -> Result<Summary, JobError> {
    let order = Order::new(scenario, options);
    let (answer, answers) = mpsc::channel();
    if let Some(open) = &*coordinator.open() {
        // If nobody takes it there will be no answer.
        let _ = open.errands.send(Errand::Run(OneRun { order, answer }));
    }
    for news in answers {
        match news {
            FromWorker::Alive { analyses, cycle } if analyses > 0 => listener.analysed(analyses, cycle),
            FromWorker::Ready(_) | FromWorker::Alive { .. } => {}
            FromWorker::Warning(text) => listener.warning(&text),
            FromWorker::MethodFailed { cycle, reason } => listener.method_failed(cycle, &reason),
            FromWorker::Done(outcome) => return outcome.map_err(JobError::from),
        }
    }
    let report = miette!("the process that computed it has died, or there was none");
    Err(JobError { report, may_pass: true, cannot_resume: false })
}
