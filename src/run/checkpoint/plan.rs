//! The plan of a run: enough to begin it again, and to decide whether a checkpoint belongs to it.

use crate::options::{CheckpointPolicy, RunOptions};
use crate::run::experiment::Experiment;
use crate::scenario::{Scenario, ScenarioError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A scenario and the options of its runs, as they were asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedRun {
    /// The scenario's file, beside which its station files are.
    scenario_path: PathBuf,
    /// The scenario, to the letter.
    scenario_text: String,
    /// What the command line changed.
    options: RunOptions,
}

impl PlannedRun {
    /// What a run, or each run of a batch, is asked to do.
    pub fn new(scenario: &Scenario, options: &RunOptions) -> Self {
        Self {
            // Whoever resumes the run may be in another directory.
            scenario_path: std::path::absolute(&scenario.path).unwrap_or_else(|_| scenario.path.clone()),
            scenario_text: scenario.text.clone(),
            options: options.of_run(),
        }
    }

    /// The scenario, read from its text.
    ///
    /// # Errors
    /// If it is not valid, or its station files are gone.
    pub fn scenario(&self) -> Result<Scenario, ScenarioError> {
        Scenario::parse(&self.scenario_path, &self.scenario_text)
    }

    /// The options of a run that continues this one in the same place.
    pub fn options(&self, out: &Path, threads: Option<usize>, live: bool) -> RunOptions {
        let mut options = RunOptions { out: out.into(), threads, resume: true, ..self.options.clone() };
        options.outputs.set("live", live);
        options
    }
}

/// The identity of a run: what was asked for, and a checksum of everything else on which its results depend.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What was asked for.
    pub run: PlannedRun,
    /// [`Experiment::inputs`].
    inputs: u32,
}

impl Plan {
    /// The plan of a run of a scenario.
    pub fn new(scenario: &Scenario, options: &RunOptions, experiment: &Experiment) -> Self {
        Self { run: PlannedRun::new(scenario, options), inputs: experiment.inputs }
    }

    /// When checkpoints are written; `None`: never.
    pub fn policy(&self) -> Option<CheckpointPolicy> {
        self.run.options.checkpoints
    }

    /// Why the other plan is that of another run; `None` if it is the same.
    pub fn difference(&self, other: &Plan) -> Option<&'static str> {
        if self.run.scenario_text != other.run.scenario_text {
            Some("its scenario is another one")
        } else if self.run.options != other.run.options {
            Some("it is of a run with other options")
        } else if self.inputs != other.inputs {
            Some(
                "other methods or networks were added to its scenario in code, or what it reads was different: a file of stations, \
                 observations or fields, or the database of sensors has changed since",
            )
        } else {
            None
        }
    }
}
