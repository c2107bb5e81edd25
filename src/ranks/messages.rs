//! What the processes say to each other.

use crate::batch::JobError;
use crate::run::checkpoint::PlannedRun;
use crate::scores::Summary;
use miette::miette;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::ffi::OsString;

/// From rank 0.
#[derive(Debug, Serialize, Deserialize)]
pub enum ToWorker {
    /// Compute this run.
    Run(Box<Order>),
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
