//! What the user changes in a run.

use crate::output::Outputs;
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
    /// The methods to run; `None`: all. Each is one of the scenario's, or added in code.
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
    /// Whether other runs compute in this process at the same time, so that the memory of each is not known.
    #[serde(skip)]
    pub concurrent: bool,
    /// When checkpoints are written; `None`: never.
    pub checkpoints: Option<CheckpointPolicy>,
    /// Whether an interrupted run continues from its last checkpoint.
    #[serde(skip)]
    pub resume: bool,
    /// The directory of an earlier run from whose final state this one goes on. A run that is resumed needs it no more.
    #[serde(skip)]
    pub from: Option<PathBuf>,
}

/// When checkpoints are written: whichever comes first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckpointPolicy {
    /// Time between two checkpoints \[minutes\]; `None`: no matter how long ago the last one was.
    pub minutes: Option<f64>,
    /// Number of cycles between two checkpoints; `None`: no matter how many cycles there were.
    pub cycles: Option<usize>,
}

impl Default for CheckpointPolicy {
    /// Every five minutes.
    fn default() -> Self {
        Self { minutes: Some(5.0), cycles: None }
    }
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
            from: None,
        }
    }

    /// The options without those that belong to the process.
    pub fn of_run(&self) -> Self {
        let Self { methods, cycles, seed, overwrite, outputs, checkpoints, .. } = self.clone();
        Self { methods, cycles, seed, overwrite, outputs: outputs.of_run(), checkpoints, ..Self::new("") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_is_shown_while_it_computes_can_be_continued_without_that() {
        let options = RunOptions { outputs: Outputs::of(["netcdf"]), seed: Some(3), ..RunOptions::new("here") };
        let outputs = Outputs::of(["netcdf", "live"]);
        let shown = RunOptions { outputs, threads: Some(4), concurrent: true, resume: true, ..options.clone() };
        assert_eq!(shown.of_run(), options.of_run());
        let text = serde_json::to_string(&shown.of_run()).unwrap();
        assert_eq!(serde_json::from_str::<RunOptions>(&text).unwrap(), options.of_run());
    }
}
