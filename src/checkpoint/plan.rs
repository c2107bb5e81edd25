//! What a run was asked to do: enough to begin it again, and to see whether a checkpoint is one of it.

use crate::event::RunInfo;
use crate::experiment::Experiment;
use crate::options::{CheckpointPolicy, RunOptions};
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

    /// The options of a run that goes on with this plan in the same place.
    pub fn options(&self, out: &Path, threads: Option<usize>, live: bool) -> RunOptions {
        let mut options = RunOptions { out: out.into(), threads, resume: true, ..self.options.clone() };
        options.outputs.set("live", live);
        options
    }
}

/// A run as it was asked for, and what that led to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What was asked for.
    pub run: PlannedRun,
    /// Checksum of what the scenario led to with its files.
    experiment: u32,
}

impl Plan {
    /// The plan of a run of a scenario.
    pub fn new(scenario: &Scenario, options: &RunOptions, experiment: &Experiment) -> Self {
        let RunInfo { layout, calibration, stations, methods: described, .. } = &experiment.info;
        let led_to = format!("{layout:?} {calibration:?} {stations:?} {described:?} {}", experiment.files);
        Self { run: PlannedRun::new(scenario, options), experiment: crc32fast::hash(led_to.as_bytes()) }
    }

    /// When checkpoints are written; `None`: never.
    pub fn policy(&self) -> Option<CheckpointPolicy> {
        self.run.options.checkpoints
    }

    /// Why the other plan is another one; `None` if it is not.
    pub fn difference(&self, other: &Plan) -> Option<&'static str> {
        if self.run.scenario_text != other.run.scenario_text {
            Some("its scenario is another one")
        } else if self.run.options != other.run.options {
            Some("it is of a run with other options")
        } else if self.experiment != other.experiment {
            Some(
                "what it reads was different: a file of stations, observations or fields, or the database of sensors has changed since",
            )
        } else {
            None
        }
    }
}
