//! The runs themselves: as many at a time as threads and memory allow.

use crate::cli::RunOptions;
use crate::progress::SeedsProgress;
use crate::scenario::Scenario;
use crate::sink::{Sink, SinkError};
use crate::summary::Summary;
use miette::{IntoDiagnostic, Report};
use serde::Serialize;
use std::fmt::{self, Display, Formatter};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use sysinfo::System;

/// Cycles of the run that shows how much memory one takes.
const TRIAL_CYCLES: usize = 2;

/// The share of the available memory that all runs together may take.
const MEMORY_SHARE: f64 = 0.7;

/// What a run takes beyond its methods: truth, observations, files \[bytes\].
const OTHER_BYTES: u64 = 50_000_000;

/// What runs an experiment: a listener hears its events.
pub type Run<'a> = dyn Fn(&Scenario, &RunOptions, &mut dyn Sink) -> Result<Summary, Report> + Sync + 'a;

/// How the runs are distributed over threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Schedule {
    /// Runs at a time.
    pub at_once: usize,
    /// Threads of each.
    pub threads_each: usize,
}

/// The runs of all seeds, in the order of the seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct SeedRuns {
    /// How they were distributed.
    pub schedule: Schedule,
    /// The scores of those that are complete.
    pub complete: Vec<Summary>,
    /// The others.
    pub failed: Vec<FailedSeed>,
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
/// A run that fails does not keep the others from being run. Whatever the schedule, every run has the same bits.
///
/// # Errors
/// If all runs failed, why the first one did; or if nothing can be written for a trial.
pub fn run_all(
    scenario: &Scenario,
    options: &RunOptions,
    seeds: &[u64],
    run: &Run<'_>,
    progress: &SeedsProgress,
) -> Result<SeedRuns, Report> {
    let schedule = schedule(scenario, options, seeds, run)?;
    let next = AtomicUsize::new(0);
    let outcomes = Mutex::new(Vec::with_capacity(seeds.len()));
    let work = || {
        while let Some(&seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed)) {
            let own = RunOptions {
                out: options.out.join(format!("seed-{seed}")),
                seed: Some(seed),
                threads: Some(schedule.threads_each),
                concurrent: schedule.at_once > 1,
                checkpoints: None,
                ..options.clone()
            };
            let outcome = run(scenario, &own, &mut progress.listener(seed));
            outcomes.lock().unwrap_or_else(PoisonError::into_inner).push((seed, outcome));
        }
    };
    thread::scope(|scope| {
        (0..schedule.at_once).for_each(|_| drop(scope.spawn(work)));
    });
    let mut outcomes = outcomes.into_inner().unwrap_or_else(PoisonError::into_inner);
    outcomes.sort_by_key(|(seed, _)| *seed);
    let mut runs = SeedRuns { schedule, complete: Vec::new(), failed: Vec::new() };
    let mut first_error = None;
    for (seed, outcome) in outcomes {
        match outcome {
            Ok(summary) => {
                runs.failed.extend(summary.failures().map(|(name, failure)| FailedSeed {
                    seed,
                    method: Some(name.to_string()),
                    error: format!("failed in cycle {}: {}", failure.cycle, failure.reason),
                }));
                runs.complete.push(summary);
            }
            Err(error) => {
                runs.failed.push(FailedSeed { seed, method: None, error: error.to_string() });
                first_error.get_or_insert(error);
            }
        }
    }
    match first_error {
        Some(error) if runs.complete.is_empty() => {
            Err(error.wrap_err(format!("the runs of all {} seeds failed", seeds.len())))
        }
        _ => Ok(runs),
    }
}

/// As many runs at a time as there are threads, as far as they fit into memory, and the threads divided among them.
fn schedule(scenario: &Scenario, options: &RunOptions, seeds: &[u64], run: &Run<'_>) -> Result<Schedule, Report> {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let threads = options.threads.unwrap_or(cores);
    let wanted = threads.min(seeds.len());
    let at_once = match wanted {
        0 | 1 => 1,
        _ => {
            let directory = tempfile::tempdir().into_diagnostic()?;
            let needed_bytes = trial(scenario, options, seeds[0], run, directory.path());
            let both = needed_bytes.zip(available_bytes());
            both.map_or(1, |(needed_bytes, available_bytes)| fitting(wanted, needed_bytes, available_bytes))
        }
    };
    Ok(Schedule { at_once, threads_each: (threads / at_once).max(1) })
}

/// The memory that a run takes, from its first cycles; `None` if they fail, of which the run itself will tell.
fn trial(scenario: &Scenario, options: &RunOptions, seed: u64, run: &Run<'_>, directory: &Path) -> Option<u64> {
    let cycles = options.cycles.unwrap_or(scenario.cycle.count).min(TRIAL_CYCLES);
    let out = directory.join("trial");
    let (cycles, seed) = (Some(cycles), Some(seed));
    let RunOptions { methods, threads, concurrent, .. } = options.clone();
    let options = RunOptions { methods, cycles, seed, threads, concurrent, ..RunOptions::new(out) };
    let summary = run(scenario, &options, &mut Nobody).ok()?;
    let of_methods: u64 = summary.methods.values().filter_map(|scores| scores.peak_memory_bytes).sum();
    Some(of_methods + OTHER_BYTES)
}

/// How many of the wanted runs of a size fit; at least one.
fn fitting(wanted: usize, needed_bytes: u64, available_bytes: u64) -> usize {
    let most = MEMORY_SHARE * available_bytes as f64 / needed_bytes as f64;
    (most as usize).clamp(1, wanted.max(1))
}

/// Memory that can be had without swapping, also within the limits of a container; `None` where the system does not tell.
fn available_bytes() -> Option<u64> {
    let mut system = System::new().ok()?;
    system.refresh_memory();
    let of_container = system.cgroup_limits().map(|limits| limits.free_memory);
    Some(of_container.map_or(system.available_memory(), |free| free.min(system.available_memory())))
}

/// Hears nothing.
struct Nobody;

impl Sink for Nobody {
    fn record(&mut self, _: &crate::event::Event<'_>) -> Result<(), SinkError> {
        Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_runs_at_a_time_than_fit_into_memory_but_always_one() {
        let gigabyte = 1_000_000_000;
        assert_eq!(fitting(8, gigabyte, 100 * gigabyte), 8);
        assert_eq!(fitting(8, gigabyte, 5 * gigabyte), 3);
        assert_eq!(fitting(8, gigabyte, gigabyte), 1);
        assert!(available_bytes().is_none_or(|bytes| bytes > 1_000_000));
    }
}
