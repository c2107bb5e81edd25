//! The plan of a run: enough to begin it again, and to decide whether a checkpoint belongs to it.

use crate::options::{CheckpointPolicy, RunOptions};
use crate::run::experiment::Experiment;
use crate::scenario::{Scenario, ScenarioError};
use percent_encoding::{AsciiSet, CONTROLS, percent_decode_str, percent_encode};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf, absolute};

/// What of a path is encoded: what is no text anyway.
const ENCODED: &AsciiSet = &CONTROLS.add(b'%');

/// A scenario and the options of its runs, as they were asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedRun {
    /// The scenario's file, beside which its station files are.
    scenario_path: AnyPath,
    /// The scenario, to the letter.
    scenario_text: String,
    /// What the command line changed.
    options: RunOptions,
    /// The database of sensors, if the command line named it.
    sensors: Option<AnyPath>,
}

impl PlannedRun {
    /// What a run, or each run of a batch, is asked to do.
    pub fn new(scenario: &Scenario, options: &RunOptions) -> Self {
        Self {
            scenario_path: AnyPath::absolute(&scenario.path),
            scenario_text: scenario.text.clone(),
            options: options.of_run(),
            sensors: scenario.named_database().map(AnyPath::absolute),
        }
    }

    /// The database of sensors, if the command line named it. Whoever goes on with the run names it again: the plan comes
    /// from a file.
    pub fn named_database(&self) -> Option<&Path> {
        self.sensors.as_ref().map(|path| path.0.as_path())
    }

    /// The scenario's file.
    pub fn scenario_path(&self) -> &Path {
        &self.scenario_path.0
    }

    /// Whether the scenario's file is still what it was.
    pub fn has_scenario(&self) -> bool {
        Scenario::load(self.scenario_path()).is_ok_and(|scenario| scenario.text == self.scenario_text)
    }

    /// The scenario, read from its text.
    ///
    /// # Errors
    /// If it is not valid, or its station files are gone.
    pub fn scenario(&self) -> Result<Scenario, ScenarioError> {
        Scenario::parse(self.scenario_path(), &self.scenario_text)
    }

    /// The options of a run that continues this one in the same place.
    pub fn options(&self, out: &Path, threads: Option<usize>, live: bool) -> RunOptions {
        let mut options = RunOptions { out: out.into(), threads, resume: true, ..self.options.clone() };
        options.outputs.set("live", live);
        options
    }
}

/// A path that is kept as text, whatever its bytes are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
struct AnyPath(PathBuf);

impl AnyPath {
    /// The path from the root: whoever resumes the run may be in another directory.
    fn absolute(path: &Path) -> Self {
        Self(absolute(path).unwrap_or_else(|_| path.to_path_buf()))
    }
}

impl From<AnyPath> for String {
    fn from(path: AnyPath) -> Self {
        percent_encode(path.0.as_os_str().as_encoded_bytes(), ENCODED).to_string()
    }
}

impl From<String> for AnyPath {
    fn from(text: String) -> Self {
        let decoded = percent_decode_str(&text);
        #[cfg(unix)]
        {
            use std::os::unix::ffi::OsStringExt;
            Self(std::ffi::OsString::from_vec(decoded.collect()).into())
        }
        #[cfg(not(unix))]
        Self(decoded.decode_utf8_lossy().into_owned().into())
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
                "other methods were added to its scenario in code, or what it reads was different: a file of stations, \
                 observations or fields, or the database of sensors has changed since",
            )
        } else {
            None
        }
    }
}
