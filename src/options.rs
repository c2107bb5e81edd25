//! What the user changes in a run.

use crate::sink::Outputs;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What the command line changes in a run of a scenario.
///
/// What belongs to the process and not to the run, such as the number of threads, is not serialised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunOptions {
    /// The directory of this run's files, named after the scenario.
    #[serde(skip)]
    pub out: PathBuf,
    /// The methods to run; `None`: all of the scenario. Each is one of the scenario's.
    pub methods: Option<Vec<String>>,
    /// Number of cycles instead of the scenario's.
    pub cycles: Option<usize>,
    /// Seed instead of the scenario's.
    pub seed: Option<u64>,
    /// Number of threads; `None`: one for each core.
    #[serde(skip)]
    pub threads: Option<usize>,
    /// Whether files of an earlier run are replaced.
    pub overwrite: bool,
    /// The outputs to write beside the summary and the scores.
    pub outputs: Outputs,
    /// Whether other runs go on in this process, so that the memory of one cannot be told from that of another.
    #[serde(skip)]
    pub concurrent: bool,
    /// When checkpoints are written; `None`: never.
    pub checkpoints: Option<CheckpointPolicy>,
    /// Whether an interrupted run continues from its last checkpoint.
    #[serde(skip)]
    pub resume: bool,
}

/// When checkpoints are written: whichever comes first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckpointPolicy {
    /// Time between two checkpoints \[minutes\]; `None`: no matter how long ago the last one was.
    pub minutes: Option<f64>,
    /// Number of cycles between two checkpoints; `None`: no matter how many cycles there were.
    pub cycles: Option<usize>,
}

impl RunOptions {
    /// A run as the scenario says, on all cores, which writes nothing but its scores.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self {
            out: out.into(),
            methods: None,
            cycles: None,
            seed: None,
            threads: None,
            overwrite: false,
            outputs: Outputs::default(),
            concurrent: false,
            checkpoints: None,
            resume: false,
        }
    }

    /// The options without those that belong to the process, as they come back when they are deserialised.
    pub fn of_run(&self) -> Self {
        let Self { methods, cycles, seed, overwrite, outputs, checkpoints, .. } = self.clone();
        Self { methods, cycles, seed, overwrite, outputs, checkpoints, ..Self::new("") }
    }
}
