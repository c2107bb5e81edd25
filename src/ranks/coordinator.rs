//! Rank 0, as the rest of the program sees it: runs are computed elsewhere.

use super::messages::{FromWorker, Order};
use super::post::Errand;
use crate::batch::{Elsewhere, JobError, Runner};
use crate::options::RunOptions;
use crate::place::from_root;
use crate::progress::RunListener;
use crate::run::checkpoint::PlannedRun;
use crate::scenario::Scenario;
use crate::scores::Summary;
use miette::miette;
use mpi::environment::Universe;
use std::sync::mpsc::{self, Sender};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;

/// MPI is there once in a process, and so is this.
static COORDINATOR: OnceLock<Coordinator> = OnceLock::new();

/// The workers, and the way to them.
pub struct Coordinator {
    workers: usize,
    threads_each: usize,
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
    /// With this number of workers, each with `threads_each` threads.
    pub fn new(workers: usize, threads_each: usize, open: Open) -> Self {
        Self { workers, threads_each, open: Mutex::new(Some(open)) }
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

/// Sends the workers away, and waits until they know it.
pub fn leave() {
    let Some(Open { errands, thread, universe }) = COORDINATOR.get().and_then(|it| it.open().take()) else { return };
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
    let plan = PlannedRun::new(scenario, options);
    let (threads, resume) = (options.threads, options.resume);
    let order = Order { plan, out: from_root(&options.out).into_os_string(), threads, resume };
    let (answer, answers) = mpsc::channel();
    if let Some(open) = &*coordinator.open() {
        // If nobody takes it there will be no answer.
        let _ = open.errands.send(Errand { order, answer });
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
