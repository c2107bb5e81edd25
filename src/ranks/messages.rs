//! What the processes say to each other.

use crate::batch::JobError;
use crate::options::RunOptions;
use crate::place::from_root;
use crate::run::checkpoint::PlannedRun;
use crate::scenario::Scenario;
use crate::scores::Summary;
use miette::{Report, miette};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// From rank 0.
#[derive(Debug, Serialize, Deserialize)]
pub enum ToWorker {
    /// Compute this run.
    Run(Box<Order>),
    /// Compute this run together with all others. Nothing more is said until it is over.
    Share(Box<Order>),
    /// End the run under way after this cycle, with a checkpoint.
    End,
    /// There will be no more.
    Leave,
}

/// A run that is to be computed.
#[derive(Debug, Serialize, Deserialize)]
pub struct Order {
    /// The scenario, and what the command line changed.
    pub plan: PlannedRun,
    /// The directory of its files, from the root.
    pub out: OsString,
    /// Its threads; `None`: one for each core of the worker.
    pub threads: Option<usize>,
    /// Whether it goes on from its last checkpoint.
    pub resume: bool,
    /// The directory, from the root, of an earlier run from whose final state it goes on.
    pub from: Option<OsString>,
}

impl Order {
    /// To run a scenario.
    pub fn new(scenario: &Scenario, options: &RunOptions) -> Self {
        let from_root = |path: &PathBuf| from_root(path).into_os_string();
        Self {
            plan: PlannedRun::new(scenario, options),
            out: from_root(&options.out),
            threads: options.threads,
            resume: options.resume,
            from: options.from.as_ref().map(from_root),
        }
    }

    /// The scenario, as this process reads it.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn scenario(&self) -> Result<Scenario, Report> {
        let mut scenario = self.plan.scenario(Path::new(&self.out))?;
        if let Some(named) = self.plan.named_database() {
            scenario.name_database(named);
        }
        Ok(scenario)
    }

    /// The options of the run.
    pub fn options(&self) -> RunOptions {
        let from = self.from.as_ref().map(PathBuf::from);
        let options = self.plan.options(Path::new(&self.out), self.threads, false);
        RunOptions { resume: self.resume, from, ..options }
    }
}

/// To rank 0.
#[derive(Debug, Serialize, Deserialize)]
pub enum FromWorker {
    /// The worker is there.
    Ready(Greeting),
    /// How many analyses there were since it was last said, and the cycle of the last; and a sign of life.
    Alive { analyses: usize, cycle: usize },
    /// Something to be said to the user.
    Warning(String),
    /// A method has failed.
    MethodFailed { cycle: usize, reason: String },
    /// The run is over.
    Done(Box<Result<Summary, Failure>>),
}

/// Who a worker is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Greeting {
    /// Version of isobar.
    pub version: String,
    /// Checksum of the program.
    pub program: u32,
    /// Threads that it may have.
    pub threads: usize,
    /// The vector instructions of its processor, on which the last bits of results depend.
    pub instructions: String,
}

/// Why a run ended early.
#[derive(Debug, Serialize, Deserialize)]
pub struct Failure {
    message: String,
    help: Option<String>,
    may_pass: bool,
    cannot_resume: bool,
}

impl From<JobError> for Failure {
    fn from(error: JobError) -> Self {
        let JobError { report, may_pass, cannot_resume } = error;
        Self { message: report.to_string(), help: report.help().map(|it| it.to_string()), may_pass, cannot_resume }
    }
}

impl From<Failure> for JobError {
    fn from(failure: Failure) -> Self {
        let Failure { message, help, may_pass, cannot_resume } = failure;
        let report = match help {
            Some(help) => miette!(help = help, "{message}"),
            None => miette!("{message}"),
        };
        Self { report, may_pass, cannot_resume }
    }
}

/// As it is sent.
pub fn packed(message: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(message).expect("messages are plain data")
}

/// What was sent.
///
/// # Errors
/// In words, if it is something else.
pub fn unpacked<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    serde_json::from_slice(bytes).map_err(|error| format!("a message that cannot be read: {error}"))
}
