//! `isobar regress`.

use super::arguments::RegressArguments;
use super::{RunOptions, Runner, lookup, print, show};
use crate::interrupt;
use crate::progress::Progress;
use crate::scenario::{Scenario, accept};
use crate::scores::{Expected, Regression};
use miette::{IntoDiagnostic, Report, miette};
use std::process::ExitCode;

/// Runs scenarios and says which scores moved. The exit code is 1 if one is outside of its tolerance, unless the new
/// scores are accepted.
pub fn regress(arguments: &RegressArguments, runner: &Runner) -> Result<ExitCode, Report> {
    let scenarios = match arguments.scenarios.as_slice() {
        [] => all()?,
        given => given.iter().map(|argument| lookup::load(argument)).collect::<Result<Vec<_>, _>>()?,
    };
    if scenarios.is_empty() {
        return Err(miette!("there are no scenarios in ./scenarios"));
    }
    interrupt::listen();
    let mut code = ExitCode::SUCCESS;
    for scenario in &scenarios {
        match regress_one(scenario, arguments, runner) {
            Ok(true) => {}
            Ok(false) => code = ExitCode::FAILURE,
            Err(report) => {
                show(&report);
                code = ExitCode::FAILURE;
                if interrupt::requested() {
                    return Ok(ExitCode::from(interrupt::EXIT_CODE));
                }
            }
        }
    }
    Ok(code)
}

/// All scenarios in ./scenarios but those that are run only when they are named.
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

/// Whether all is well with a scenario.
fn regress_one(scenario: &Scenario, arguments: &RegressArguments, runner: &Runner) -> Result<bool, Report> {
    let directory = tempfile::tempdir().into_diagnostic()?;
    let threads = arguments.threads.map(|threads| threads as usize);
    let options = RunOptions { threads, ..RunOptions::new(directory.path().join(&scenario.name)) };
    let mut progress = Progress::new(arguments.quiet);
    let summary = runner(scenario, &options, &mut progress)?;
    drop(progress);
    let regression = Regression::new(&scenario.expected, &summary);
    print(&format!("{}: {}", scenario.name, regression.describe()))?;
    if !arguments.accept {
        return Ok(regression.passed());
    }
    if let Some((name, failure)) = summary.failures().next() {
        return Err(miette!(
            "method {name} failed in cycle {}: {}; nothing is accepted",
            failure.cycle,
            failure.reason
        ));
    }
    accept(scenario, &Expected::from_summary(&summary, scenario.expected.relative_tolerance)).into_diagnostic()?;
    print(&format!("{}: accepted", scenario.name))?;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::{MethodScores, Summary};
    use crate::sink::Sink;

    fn runner(h: f64) -> impl Fn(&Scenario, &RunOptions, &mut dyn Sink) -> Result<Summary, Report> + Sync {
        move |scenario, _, _| {
            let mut scores = MethodScores::default();
            scores.values.insert("rmse_analysis.h".into(), h);
            Ok(Summary {
                scenario: scenario.name.clone(),
                seed: scenario.seed,
                cycles: scenario.cycle.count,
                scored_from_cycle: scenario.cycle.score_from_cycle,
                version: String::new(),
                observations: Default::default(),
                methods: scenario.methods.keys().map(|name| (name.clone(), scores.clone())).collect(),
            })
        }
    }

    #[test]
    fn scores_pass_once_they_are_accepted_and_until_they_move() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("mine.toml");
        std::fs::write(&path, include_str!("template.toml")).unwrap();
        let passes = |accept: bool, h: f64| {
            let scenario = Scenario::load(&path).unwrap();
            let arguments = RegressArguments { scenarios: Vec::new(), accept, threads: None, quiet: true };
            regress_one(&scenario, &arguments, &runner(h)).unwrap()
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
