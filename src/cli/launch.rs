//! What the commands that run scenarios share.

use crate::batch::JobError;
use crate::options::RunOptions;
use crate::output::Sink;
use crate::output::directory::{Stage, checkpoints, stage};
use crate::output::working;
use crate::ranks;
use crate::run::experiment::Experiment;
use crate::run::{self, Afterwards, RunError, Undivided, check_divided};
use crate::scenario::Scenario;
use crate::scores::Summary;
use crate::shell::command;
use crate::text::{clean, listed, nearest};
use miette::{Report, miette};
use std::path::Path;

/// The most failures of a batch that standard error names; the files have all of them.
const MOST_FAILURES: usize = 10;

/// Runs a scenario. An error names the scenario, and what of the run is kept.
pub fn run_scenario(scenario: &Scenario, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, JobError> {
    let run = run::run(scenario, options, listener);
    run.map_err(|error| JobError::new(error, |error| report(error, scenario, options)))
}

/// The same by all processes together, with something to be done once the outputs are complete.
pub fn run_scenario_then(
    scenario: &Scenario,
    options: &RunOptions,
    listener: &mut dyn Sink,
    afterwards: Afterwards<'_>,
) -> Result<Summary, Report> {
    let outcome = ranks::share(scenario, options, |communicator| {
        Experiment::builder(scenario).shared_by(communicator).run_all(options, listener, Some(afterwards))
    });
    outcome?.map_err(|error| report(error, scenario, options))
}

/// The error of a run.
fn report(error: RunError, scenario: &Scenario, options: &RunOptions) -> Report {
    match error {
        RunError::Experiment(error) => error.locate(scenario).into(),
        RunError::Place(_) | RunError::Earlier { .. } => miette!("{}: {error}", scenario.name),
        RunError::Undivided(error) => undivided(&error, scenario),
        error => {
            let help = kept(&options.out);
            miette!(help = help, "{}: {error}", scenario.name)
        }
    }
}

/// Refuses, of runs that several processes compute together, those with methods that cannot be divided.
pub fn check_shared(scenario: &Scenario, options: &RunOptions) -> Result<(), Report> {
    if ranks::others() == 0 {
        return Ok(());
    }
    check_divided(scenario, options, []).map_err(|error| undivided(&error, scenario))
}

fn undivided(error: &Undivided, scenario: &Scenario) -> Report {
    let help = "--methods chooses others; without the MPI launcher one process computes all of them";
    miette!(help = help, "{}: {error}", scenario.name)
}

/// What is kept of a run that has ended early, and how it goes on.
fn kept(out: &Path) -> String {
    let resume = command("isobar resume", &[out]);
    let cycle = working::path(out).ok().and_then(|working| Some(checkpoints(&working).first()?.0));
    match (stage(out), cycle) {
        (Ok(Stage::Complete | Stage::Published), _) => {
            format!("the run is complete: `{resume}` does the rest, once that is possible")
        }
        (_, Some(cycle)) => format!("the run is kept up to cycle {cycle}: `{resume}` continues it"),
        _ => "nothing of the run is kept".to_string(),
    }
}

/// Refuses a method that the scenario does not have.
pub fn check_method(method: &str, scenario: &Scenario) -> Result<(), Report> {
    if scenario.methods.contains_key(method) {
        return Ok(());
    }
    let names = || scenario.methods.keys().map(String::as_str);
    let near = nearest(method, names()).map_or(String::new(), |near| format!("did you mean `{near}`?\n"));
    let help = format!("{near}methods of {}: {}", scenario.name, listed(names()));
    Err(miette!(help = help, "{} has no method `{}`", scenario.name, clean(method)))
}

/// Refuses a number of cycles of which none counts for the scores.
pub fn check_cycles(cycles: Option<usize>, scenario: &Scenario) -> Result<(), Report> {
    let first = scenario.cycle.score_from_cycle;
    let Some(cycles) = cycles.filter(|&cycles| cycles < first) else { return Ok(()) };
    let help = format!("--cycles {first} or more, or a smaller score_from_cycle");
    Err(miette!(help = help, "{} counts scores from cycle {first}, so {cycles} cycles have none", scenario.name))
}

/// What of a batch failed.
pub fn failures(name: &str, failed: &[String]) -> Report {
    let help = "the scores are those of all that did not fail";
    let more = failed.len().saturating_sub(MOST_FAILURES);
    let more = if more > 0 { format!("\nand {more} more") } else { String::new() };
    let named = failed[..failed.len().min(MOST_FAILURES)].join("\n");
    miette!(help = help, "{name}: failed:\n{named}{more}")
}
