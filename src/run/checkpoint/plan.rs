//! The plan of a run: enough to begin it again, and to decide whether a checkpoint belongs to it.

use crate::options::{CheckpointPolicy, RunOptions};
use crate::place::{from_root, parent_of, seen_from};
use crate::run::earlier::Earlier;
use crate::run::experiment::{Experiment, Inputs};
use crate::scenario::{Scenario, ScenarioError};
use crate::shipped;
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// A scenario and the options of its runs, as they were asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedRun {
    /// The scenario's file, beside which the files are that it names: its absolute path, of whatever bytes.
    scenario_path: OsString,
    /// The same, seen from the directory in which that of the run is: both may be moved together.
    scenario_beside: OsString,
    /// The scenario, to the letter.
    scenario_text: String,
    /// What the command line changed.
    options: RunOptions,
    /// The database of sensors, if the command line named it.
    sensors: Option<OsString>,
}

impl PlannedRun {
    /// What a run, or each run of a batch, is asked to do.
    pub fn new(scenario: &Scenario, options: &RunOptions) -> Self {
        // Whoever resumes the run may be in another directory.
        let from_root = |path: &Path| from_root(path).into_os_string();
        Self {
            scenario_path: from_root(&scenario.path),
            scenario_beside: seen_from(parent_of(&options.out), &scenario.path).into_os_string(),
            scenario_text: scenario.text.clone(),
            options: options.of_run(),
            sensors: scenario.named_database().map(from_root),
        }
    }

    /// The database of sensors, if the command line named it. Whoever goes on with the run names it again: the plan comes
    /// from a file.
    pub fn named_database(&self) -> Option<&Path> {
        self.sensors.as_ref().map(Path::new)
    }

    /// Whether a file is that of the scenario, as it was.
    pub fn is_of(&self, path: &Path) -> bool {
        Scenario::load(path).is_ok_and(|scenario| scenario.text == self.scenario_text)
    }

    /// The scenario, read from its text, with the files that are now where they were when the run in `out` began: as seen
    /// from there, or, where some are missing, at their absolute paths.
    ///
    /// # Errors
    /// If it is not valid, or a file that it names is gone.
    pub fn scenario(&self, out: &Path) -> Result<Scenario, ScenarioError> {
        let places = self.places(out);
        let mut found = Vec::new();
        for path in &places {
            match Scenario::parse(path, &self.scenario_text) {
                Ok(scenario) if has_database(&scenario) => return Ok(scenario),
                other => found.push(other),
            }
        }
        // None is complete: a database may be yet to be made. Else the fault is shown where the scenario is.
        let is_there = places.iter().position(|path| path.is_file());
        let best = found.iter().position(Result::is_ok).or(is_there).unwrap_or(0);
        found.swap_remove(best)
    }

    /// Where the scenario may be.
    fn places(&self, out: &Path) -> Vec<PathBuf> {
        let path = PathBuf::from(&self.scenario_path);
        if shipped::contains(&path) {
            return vec![path];
        }
        let parent = parent_of(out);
        let beside = parent.canonicalize().unwrap_or_else(|_| parent.to_path_buf()).join(&self.scenario_beside);
        // Without detours, as far as it is there: messages show it.
        let directory = parent_of(&beside).canonicalize().ok();
        let beside = directory.zip(beside.file_name()).map_or_else(|| beside.clone(), |(place, name)| place.join(name));
        let mut places = vec![beside, path];
        places.dedup();
        places
    }

    /// The options of a run that continues this one in the same place.
    pub fn options(&self, out: &Path, threads: Option<usize>, live: bool) -> RunOptions {
        let mut options = RunOptions { out: out.into(), threads, resume: true, ..self.options.clone() };
        options.outputs.set("live", live);
        options
    }
}

/// Whether the database of sensors is there, if the scenario names one.
fn has_database(scenario: &Scenario) -> bool {
    scenario.sensors.as_ref().is_none_or(|sensors| sensors.database.exists() || shipped::is_file(&sensors.database))
}

/// The identity of a run: what was asked for, and everything else on which its results depend.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What was asked for.
    pub run: PlannedRun,
    /// What it reads.
    inputs: Inputs,
    /// The runs from which it goes on, if any.
    pub earlier: Option<Earlier>,
}

impl Plan {
    /// The plan of a run of a scenario.
    pub fn new(scenario: &Scenario, options: &RunOptions, experiment: &Experiment, earlier: Option<Earlier>) -> Self {
        Self { run: PlannedRun::new(scenario, options), inputs: experiment.inputs.clone(), earlier }
    }

    /// When checkpoints are written; `None`: never.
    pub fn policy(&self) -> Option<CheckpointPolicy> {
        self.run.options.checkpoints
    }

    /// A checksum of all that [`Plan::difference`] compares.
    pub fn checksum(&self) -> u32 {
        let Self { run, inputs, earlier } = self;
        let compared = postcard::to_stdvec(&(&run.scenario_text, &run.options, inputs, earlier));
        crc32fast::hash(&compared.expect("a plan can be serialised"))
    }

    /// Why the other plan is that of another run; `None` if it is the same.
    pub fn difference(&self, other: &Plan) -> Option<String> {
        if self.run.scenario_text != other.run.scenario_text {
            Some("its scenario is another one".into())
        } else if self.run.options != other.run.options {
            Some("it is of a run with other options".into())
        } else if self.earlier != other.earlier {
            Some("it is of a run that goes on from another one".into())
        } else {
            self.inputs.difference(&other.inputs)
        }
    }
}
