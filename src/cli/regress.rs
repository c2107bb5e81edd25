//! `isobar regress`.

use super::arguments::RegressArguments;
use super::console::{print, show, width};
use super::{launch, lookup};
use crate::batch::{JobError, OTHER_BYTES, Schedule, side_by_side, temporary};
use crate::interrupt;
use crate::options::RunOptions;
use crate::progress::RunsProgress;
use crate::run::experiment::estimated_bytes;
use crate::scenario::{Scenario, accept};
use crate::scores::{Expected, Regression, Summary};
use crate::shell::command;
use crate::shipped;
use miette::{IntoDiagnostic, Report, miette};
use std::process::ExitCode;

/// Runs scenarios and says which scores moved. The exit code is 1 if one is outside of its tolerance, unless the new
/// scores are accepted.
pub fn regress(arguments: &RegressArguments) -> Result<ExitCode, Report> {
    let scenarios = match arguments.scenarios.as_slice() {
        [] => all()?,
        given => given.iter().map(|argument| lookup::load(argument)).collect::<Result<Vec<_>, _>>()?,
    };
    if scenarios.is_empty() {
        return Err(miette!("there are no scenarios in ./scenarios"));
    }
    if let Some(inside) = scenarios.iter().find(|it| arguments.accept && shipped::contains(&it.path)) {
        let file = format!("{}.toml", inside.name);
        let help = format!("`isobar init --from {} {file}` makes a file of it", inside.name);
        return Err(miette!(help = help, "{} is inside the program, and its scores stay as they are", inside.name));
    }
    interrupt::listen();
    let mut passed = true;
    let judge_one = |scenario: &Scenario, outcome: Result<Summary, JobError>| match outcome
        .map_err(Report::from)
        .and_then(|summary| judge(scenario, &summary, arguments.accept))
    {
        Ok(as_expected) => passed &= as_expected,
        Err(_) if interrupt::requested() => {}
        Err(report) => {
            show(&report);
            passed = false;
        }
    };
    run_all(&scenarios, arguments, judge_one)?;
    Ok(match (interrupt::requested(), passed) {
        (true, _) => ExitCode::from(interrupt::EXIT_CODE),
        (false, true) => ExitCode::SUCCESS,
        (false, false) => ExitCode::FAILURE,
    })
}

/// Runs scenarios, as many at a time as threads and memory allow. `judge` is given the outcomes in the order of the scenarios, each
/// as soon as those before it are there; after a signal no more are run.
fn run_all(
    scenarios: &[Scenario],
    arguments: &RegressArguments,
    mut judge: impl FnMut(&Scenario, Result<Summary, JobError>),
) -> Result<(), Report> {
    let directory = temporary::directory()?;
    let threads = arguments.threads.map(|threads| threads as usize);
    let schedule = Schedule::new(threads, scenarios.len(), || Ok(Some(largest_bytes(scenarios))))?;
    let analyses: usize = scenarios.iter().map(|it| it.methods.len() * it.cycle.count).sum();
    let per_run = analyses.div_ceil(scenarios.len());
    let progress = RunsProgress::new(arguments.quiet, "regress", "scenarios", scenarios.len(), per_run);
    let run = |number: usize| {
        let scenario = &scenarios[number];
        let out = directory.path().join(&scenario.name);
        let (threads, concurrent) = (Some(schedule.threads_each), schedule.at_once > 1);
        let options = RunOptions { threads, concurrent, ..RunOptions::new(out) };
        launch::run_scenario(scenario, &options, &mut progress.listener(scenario.name.clone()))
    };
    side_by_side(scenarios.len(), schedule.at_once, run, |number, outcome| {
        progress.aside(|| judge(&scenarios[number], outcome));
    });
    Ok(())
}

/// What the largest of the scenarios is estimated to take \[bytes\]. What is wrong with a scenario its run will say.
fn largest_bytes(scenarios: &[Scenario]) -> u64 {
    let bytes = scenarios.iter().filter_map(|scenario| estimated_bytes(scenario).ok()).fold(0.0, f64::max);
    bytes as u64 + OTHER_BYTES
}

/// All scenarios in ./scenarios, or else inside the program, but those that are run only when they are named.
fn all() -> Result<Vec<Scenario>, Report> {
    let mut scenarios = Vec::new();
    for path in lookup::all()? {
        let scenario = Scenario::load(&path)?;
        if scenario.regression {
            scenarios.push(scenario);
        } else {
            print(&format!("{}: not run (regression = false)", scenario.name))?;
        }
    }
    Ok(scenarios)
}

/// Prints which scores of a scenario have moved, and accepts the new ones if asked to; whether all is well.
fn judge(scenario: &Scenario, summary: &Summary, accept_new: bool) -> Result<bool, Report> {
    if scenario.expected.methods.is_empty() && !accept_new {
        let accept = command("isobar regress --accept", &[&scenario.path]);
        print(&format!("{}: no scores were accepted yet; `{accept}` accepts those of this run", scenario.name))?;
        return Ok(false);
    }
    let regression = Regression::new(&scenario.expected, summary);
    print(&format!("{}: {}", scenario.name, regression.describe(width())))?;
    if !accept_new {
        return Ok(regression.passed());
    }
    if let Some((name, failure)) = summary.failures().next() {
        return Err(miette!(
            "method {name} failed in cycle {}: {}; nothing is accepted",
            failure.cycle,
            failure.reason
        ));
    }
    accept(scenario, &Expected::from_summary(summary, scenario.expected.relative_tolerance)).into_diagnostic()?;
    print(&format!("{}: accepted", scenario.name))?;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::MethodScores;

    fn summary(scenario: &Scenario, h: f64) -> Summary {
        let mut scores = MethodScores::default();
        scores.values.insert("rmse_analysis.h".into(), h);
        Summary {
            scenario: scenario.name.clone(),
            seed: scenario.seed,
            cycles: scenario.cycle.count,
            scored_from_cycle: scenario.cycle.score_from_cycle,
            version: String::new(),
            observations: Default::default(),
            methods: scenario.methods.keys().map(|name| (name.clone(), scores.clone())).collect(),
            ranks: None,
        }
    }

    #[test]
    fn scores_pass_once_they_are_accepted_and_until_they_move() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("mine.toml");
        std::fs::write(&path, include_str!("template.toml")).unwrap();
        let passes = |accept: bool, h: f64| {
            let scenario = Scenario::load(&path).unwrap();
            judge(&scenario, &summary(&scenario, h), accept).unwrap()
        };
        assert!(!passes(false, 4.0), "nothing was accepted yet");
        assert!(passes(true, 4.0));
        assert!(passes(false, 4.0));
        assert!(passes(false, 4.0002), "within 0.01 %");
        assert!(!passes(false, 4.2));
        assert!(passes(true, 4.2));
        assert!(!passes(false, 4.0));
    }
}
