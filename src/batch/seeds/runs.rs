//! The runs of all seeds.

use crate::batch::{Job, JobError, Runner, Schedule, run_jobs};
use crate::options::RunOptions;
use crate::progress::{RunListener, RunsProgress};
use crate::run::experiment::ExperimentBuilder;
use crate::scenario::Scenario;
use crate::scores::Summary;
use miette::{Report, miette};
use serde::Serialize;
use std::fmt::{self, Display, Formatter};

/// The runs of all seeds, in the order of the seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct SeedRuns {
    /// How they were distributed.
    pub schedule: Schedule,
    /// The scores of those that are complete.
    pub complete: Vec<Summary>,
    /// Those that failed, and would fail again.
    pub failed: Vec<FailedSeed>,
    /// Those that could be completed another time.
    pub unfinished: Vec<FailedSeed>,
}

/// A seed whose run failed, or one of whose methods did.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FailedSeed {
    /// The seed.
    pub seed: u64,
    /// The method, if the others went on.
    pub method: Option<String>,
    /// Why.
    pub error: String,
}

/// Runs `scenario` with each of the seeds into `seed-N` below the directory of `options`, whose seed is left alone.
///
/// # Errors
/// If all runs failed, why the first one did; or if nothing can be written for a trial.
pub fn run_all(
    scenario: &Scenario,
    options: &RunOptions,
    seeds: &[u64],
    runner: &Runner<'_>,
    progress: &RunsProgress,
) -> Result<SeedRuns, Report> {
    let job = |&seed: &u64| {
        let out = options.out.join(format!("seed-{seed}"));
        Job { scenario, seed, methods: options.methods.clone(), out }
    };
    let jobs: Vec<Job<'_>> = seeds.iter().map(job).collect();
    let (schedule, outcomes) = run_jobs(&jobs, options, runner, progress)?;
    let mut runs = SeedRuns { schedule, complete: Vec::new(), failed: Vec::new(), unfinished: Vec::new() };
    let mut first_error = None;
    for (number, outcome) in outcomes {
        let seed = seeds[number];
        match outcome {
            Ok(summary) => {
                runs.failed.extend(summary.failures().map(|(name, failure)| FailedSeed {
                    seed,
                    method: Some(name.to_string()),
                    error: format!("failed in cycle {}: {}", failure.cycle, failure.reason),
                }));
                runs.complete.push(summary);
            }
            Err(JobError { report, may_pass, .. }) => {
                let list = if may_pass { &mut runs.unfinished } else { &mut runs.failed };
                list.push(FailedSeed { seed, method: None, error: report.to_string() });
                first_error.get_or_insert(report);
            }
        }
    }
    match first_error {
        Some(error) if runs.complete.is_empty() && runs.unfinished.is_empty() => {
            Err(error.wrap_err(format!("the runs of all {} seeds failed", seeds.len())))
        }
        _ => Ok(runs),
    }
}

impl ExperimentBuilder<'_> {
    /// Runs the experiment with each of the seeds into `seed-N` below the directory of `options`, whose seed is left alone;
    /// [`SeedsSummary::new`](super::SeedsSummary::new) makes means and differences of the scores.
    ///
    /// # Errors
    /// If all runs failed, why the first one did; or if nothing can be written for a trial.
    pub fn run_seeds(&self, options: &RunOptions, seeds: &[u64], progress: &RunsProgress) -> Result<SeedRuns, Report> {
        let run = |_: &Scenario, options: &RunOptions, listener: &mut RunListener<'_>| {
            let run = self.run(options, listener);
            run.map_err(|error| JobError::new(error, |error| miette!("{error}")))
        };
        run_all(&self.scenario, options, seeds, &Runner::here(run), progress)
    }
}

impl Display for FailedSeed {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        match &self.method {
            Some(method) => write!(formatter, "seed {}, method {method}: {}", self.seed, self.error),
            None => write!(formatter, "seed {}: {}", self.seed, self.error),
        }
    }
}
