//! The plan of a batch of runs, kept beside its complete runs: enough to continue it.

use crate::interrupt;
use crate::options::RunOptions;
use crate::output::directory::BATCH_FILE;
use crate::output::kept_runs::KeptRuns;
use crate::output::{Existing, OutputDirectory, SinkError};
use crate::run::checkpoint::PlannedRun;
use crate::run::experiment::{self, Inputs};
use crate::safe_file;
use crate::scenario::Scenario;
use crate::shell::command;
use crate::text::shown_path;
use miette::{IntoDiagnostic, Report, miette};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

/// A batch as it was asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BatchPlan {
    /// Version of isobar: the runs of another one may have other scores.
    version: String,
    /// What each of its runs is asked to do.
    pub run: PlannedRun,
    /// What it is a batch of.
    pub kind: BatchKind,
    /// What its runs read.
    inputs: Inputs,
}

/// What a batch is made of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BatchKind {
    /// Runs with several seeds.
    Seeds {
        /// The seeds.
        seeds: Vec<u64>,
        /// The method with which the others are compared.
        against: String,
        /// Whether all files of every seed are written.
        all_files: bool,
    },
    /// Runs with several settings, as the scenario's `[sweep]` says.
    Sweep,
}

impl BatchPlan {
    /// Creates the directory of a batch, or with `resume` opens that of an interrupted one, and writes its plan there.
    /// `scenarios` are those of its runs.
    ///
    /// # Errors
    /// If the directory cannot be created, something else is there, or what the runs read is not what the complete ones
    /// read.
    pub fn begin<'a>(
        scenario: &Scenario,
        options: &RunOptions,
        kind: BatchKind,
        scenarios: impl IntoIterator<Item = &'a Scenario>,
    ) -> Result<OutputDirectory, Report> {
        let inputs = experiment::inputs_of(scenarios, options.seed, options.cycles);
        let inputs = inputs.map_err(|error| error.locate(scenario))?;
        let existing = if options.overwrite { Existing::Overwrite } else { Existing::Refuse };
        let open = if options.resume { OutputDirectory::resume_batch } else { OutputDirectory::create_batch };
        let directory = open(options.out.clone(), existing).into_diagnostic()?;
        let plan = Self { version: crate::VERSION.into(), run: PlannedRun::new(scenario, options), kind, inputs };
        let old =
            if options.resume { Self::read(directory.working()).map_err(|reason| miette!(reason))? } else { None };
        if let Some(difference) = old.as_ref().and_then(|old| plan.inputs.difference(&old.inputs)) {
            let out = shown_path(&options.out);
            let help = "put back what was there when it began, or begin it anew with --overwrite";
            return Err(miette!(help = help, "{out}: its batch cannot be continued: {difference}"));
        }
        if old.as_ref() != Some(&plan) {
            plan.write(directory.working()).into_diagnostic()?;
        }
        Ok(directory)
    }

    fn write(&self, working: &Path) -> Result<(), SinkError> {
        let path = working.join(BATCH_FILE);
        let text = serde_json::to_string(self).map_err(|error| error.to_string());
        let written =
            text.and_then(|text| safe_file::replace(&path, text.as_bytes()).map_err(|error| error.to_string()));
        written.map_err(|reason| SinkError { path, reason })
    }

    /// Reads the plan of the batch in a working directory; `None` if there is no batch.
    ///
    /// # Errors
    /// In words, if it cannot be used.
    pub fn read(working: &Path) -> Result<Option<Self>, String> {
        let path = working.join(BATCH_FILE);
        if !path.is_file() {
            return Ok(None);
        }
        let text = fs::read_to_string(&path).map_err(|error| error.to_string())?;
        let plan: Self = serde_json::from_str(&text).map_err(|error| error.to_string())?;
        if plan.version != crate::VERSION {
            return Err(format!("it was begun by isobar {}, and this is isobar {}", plan.version, crate::VERSION));
        }
        Ok(Some(plan))
    }
}

/// The error of a batch that a signal has ended; `None` without a signal.
pub fn interrupted(out: &Path, outputs: &Path, jobs: usize) -> Option<Report> {
    if !interrupt::requested() {
        return None;
    }
    let runs = KeptRuns::of(outputs);
    Some(miette!(help = kept(out, runs, ""), "ended by a signal after {} of {jobs} runs", runs.complete))
}

/// The error of a batch some of whose runs could not be completed, but could be another time; `failed` are their names and
/// what was said of them. `None` if there are no such runs.
pub fn unfinished(out: &Path, outputs: &Path, jobs: usize, failed: &[(String, String)]) -> Option<Report> {
    let (name, error) = failed.first()?;
    let help = kept(out, KeptRuns::of(outputs), " once that is mended");
    Some(miette!(help = help, "{} of {jobs} runs could not be completed. {name}: {error}", failed.len()))
}

/// What is kept of a batch, and how it is continued.
fn kept(out: &Path, runs: KeptRuns, when: &str) -> String {
    if runs.is_empty() {
        "nothing is kept".to_string()
    } else {
        format!("{runs} are kept: `{}` runs the others{when}", command("isobar resume", &[out]))
    }
}
