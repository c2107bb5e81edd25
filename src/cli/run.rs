//! `isobar run`.

use super::arguments::RunArguments;
use super::console::{print, show, width};
use super::launch::{check_cycles, check_method, check_shared, run_scenario_then};
use super::shown::Shown;
use super::write_back::{self, name_database, write_sensors};
use super::{long, lookup, seeds};
use crate::interrupt;
use crate::memory;
use crate::options::{CheckpointPolicy, RunOptions};
use crate::progress::Progress;
use crate::run::experiment::check_sensors;
use crate::scenario::Scenario;
use crate::scores::Exchanged;
use crate::shell::command;
use crate::tables;
use crate::text::{listed, shown_path};
use miette::{Report, miette};
use serde_json::json;
use std::collections::HashMap;
use std::ffi::OsString;
use std::process::ExitCode;

/// Runs scenarios one after the other. All are read before the first one runs. The exit code is 1 if a method failed.
pub fn run(arguments: &RunArguments) -> Result<ExitCode, Report> {
    let load = |argument: &OsString| {
        let mut scenario = lookup::load(argument)?;
        name_database(&mut scenario, arguments.sensors.as_deref())?;
        Ok::<_, Report>(scenario)
    };
    let scenarios = arguments.scenarios.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    check_names(&scenarios)?;
    if let ([first, second, ..], Some(from)) = (&*scenarios, &arguments.from) {
        let (from, names) = (shown_path(from), [&first.name, &second.name]);
        return Err(miette!("{} and {} cannot both go on from {from}: run one after the other", names[0], names[1]));
    }
    let of_scenario = |scenario: &Scenario| {
        let options = options(arguments, scenario)?;
        let seeds = seeds::options(arguments, scenario, &options)?;
        Ok::<_, Report>((options, seeds))
    };
    let all = scenarios.iter().map(of_scenario).collect::<Result<Vec<_>, _>>()?;
    for (scenario, (options, _)) in scenarios.iter().zip(&all).filter(|(_, (_, seeds))| seeds.is_none()) {
        check_shared(scenario, options)?;
        check_sensors(scenario).map_err(|error| error.locate(scenario))?;
    }
    interrupt::listen();
    let mut shown = if arguments.json { Shown::Collected(Vec::new()) } else { Shown::Printed };
    let mut run_all = || {
        let mut code = ExitCode::SUCCESS;
        for (scenario, (options, seeds)) in scenarios.iter().zip(&all) {
            let went_well = match seeds {
                Some(seeds) => seeds::run(scenario, options, seeds, arguments.quiet, &mut shown)?,
                None => run_one(scenario, options, arguments.quiet, &mut shown)?,
            };
            if !went_well {
                code = ExitCode::FAILURE;
            }
        }
        Ok(code)
    };
    // What is complete is shown whatever becomes of the rest.
    let outcome = run_all();
    shown.finish()?;
    outcome
}

/// Runs a scenario, or continues it; whether no method failed and, if observations are read from files, any was used.
pub(super) fn run_one(
    scenario: &Scenario,
    options: &RunOptions,
    quiet: bool,
    shown: &mut Shown,
) -> Result<bool, Report> {
    let mut progress = Progress::new(quiet);
    let mut written = None;
    let summary = run_scenario_then(scenario, options, &mut progress, &mut |out| {
        // Before anything is printed: what is printed may reach nobody, and is not worth the run.
        written = write_sensors(scenario, out);
        !matches!(written, Some(Err(_)))
    })?;
    drop(progress);
    let (of_sensors, wrote_sensors) = write_back::report(written);
    let variables = scenario.model.variables();
    match shown {
        Shown::Printed => {
            let scores = tables::scores::on_terminal(&summary, variables, width());
            print(&format!("{}: {}\n\n{scores}\n", scenario.name, scenario.title))?;
            print(&format!("Files: {}\n", shown_path(&options.out)))?;
            if let Some(Exchanged { count, messages_per_cycle, bytes_per_cycle }) = summary.ranks {
                let (messages, bytes) = (messages_per_cycle.round(), memory::in_words(bytes_per_cycle));
                print(&format!("Ranks: {count}, each of which sends up to {messages} messages with {bytes} in a cycle\n"))?;
            }
            of_sensors.map_or(Ok(()), |text| print(&text))?;
        }
        Shown::Collected(runs) => runs.push(json!({
            "scenario": scenario.name,
            "title": scenario.title,
            "seed": summary.seed,
            "cycles": summary.cycles,
            "scored_from_cycle": summary.scored_from_cycle,
            "directory": shown_path(&options.out),
            "scores": long::of_run(&summary, variables),
            "failures": summary.failures().map(|(name, it)| json!({ "method": name, "cycle": it.cycle, "reason": it.reason })).collect::<Vec<_>>(),
        })),
    }
    let failed: Vec<&str> = summary.failures().map(|(name, _)| name).collect();
    if !failed.is_empty() {
        show(&miette!(
            help = "the files are complete, with missing values and without scores where a method failed",
            "{}: failed: {}",
            scenario.name,
            listed(failed.iter().copied())
        ));
    }
    let reads_files = scenario.networks.iter().any(|network| network.instrument.is_recorded());
    let nothing_used = reads_files && summary.observations.used + summary.observations.passive == 0;
    if nothing_used {
        let check = command("isobar check", &[&scenario.path]);
        let help = format!("the warnings at the beginning say why, as does `{check}`; observations.nc has all of them");
        show(&miette!(help = help, "{}: no observation was used", scenario.name));
    }
    Ok(wrote_sensors && failed.is_empty() && !nothing_used)
}

/// When checkpoints are written.
fn policy(arguments: &RunArguments) -> Option<CheckpointPolicy> {
    let minutes = Some(arguments.checkpoint_minutes).filter(|&minutes| minutes > 0.0);
    let cycles = arguments.checkpoint_cycles.map(|cycles| cycles as usize);
    (minutes.is_some() || cycles.is_some()).then_some(CheckpointPolicy { minutes, cycles })
}

/// Scenarios of the same name would write into the same directory.
fn check_names(scenarios: &[Scenario]) -> Result<(), Report> {
    let mut seen = HashMap::new();
    for scenario in scenarios {
        // `..toml` would be written to the parent of where it belongs.
        if scenario.name.starts_with('.') {
            let path = shown_path(&scenario.path);
            return Err(miette!(help = "give the file another name", "{path}: no directory can be named after it"));
        }
        if let Some(other) = seen.insert(&scenario.name, &scenario.path) {
            let paths = [other, &scenario.path].map(|path| shown_path(path));
            return Err(miette!("{} and {} would write into the same directory", paths[0], paths[1]));
        }
    }
    Ok(())
}

pub(super) fn options(arguments: &RunArguments, scenario: &Scenario) -> Result<RunOptions, Report> {
    arguments.methods.iter().flatten().try_for_each(|method| check_method(method, scenario))?;
    let methods = arguments.methods.as_deref().unwrap_or_default();
    if let Some((_, name)) = methods.iter().enumerate().find(|(number, name)| methods[..*number].contains(name)) {
        return Err(miette!("--methods names `{name}` twice"));
    }
    let cycles = arguments.cycles.map(|cycles| cycles as usize);
    if arguments.from.is_none() {
        check_cycles(cycles, scenario)?;
    }
    Ok(RunOptions {
        out: arguments.out.join(&scenario.name),
        methods: arguments.methods.clone(),
        cycles,
        seed: arguments.seed,
        threads: arguments.threads.map(|threads| threads as usize),
        overwrite: arguments.overwrite,
        outputs: arguments.outputs.apply(&scenario.outputs)?,
        concurrent: false,
        checkpoints: policy(arguments),
        resume: false,
        from: arguments.from.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::arguments::{Arguments, Command};
    use super::*;
    use crate::output::{OUTPUTS, Outputs};
    use clap::Parser;
    use std::path::Path;

    fn options_of(line: &[&str]) -> Result<RunOptions, Report> {
        let text = include_str!("template.toml");
        let scenario = Scenario::parse(Path::new("mine.toml"), text)?;
        let line = ["isobar", "run", "mine.toml"].iter().chain(line);
        match Arguments::try_parse_from(line).map_err(|error| miette!("{error}"))?.command {
            Command::Run(arguments) => options(&arguments, &scenario),
            other => Err(miette!("{other:?}")),
        }
    }

    #[test]
    fn options_are_the_scenarios_unless_the_user_says_otherwise() {
        let plain = options_of(&[]).unwrap();
        let outputs = OUTPUTS.iter().filter(|output| output.by_default);
        let mut all = RunOptions {
            outputs: Outputs::of(outputs.map(|output| output.name)),
            checkpoints: Some(CheckpointPolicy::default()),
            ..RunOptions::new("out/mine")
        };
        assert_eq!(plain, all);
        let changed =
            options_of(&["--methods", "fkf,free", "--cycles", "7", "--no-netcdf", "--out", "x", "--seed", "9"]);
        let methods = Some(vec!["fkf".to_string(), "free".to_string()]);
        all.outputs.set("netcdf", false);
        let wanted = RunOptions { out: "x/mine".into(), methods, cycles: Some(7), seed: Some(9), ..all };
        assert_eq!(changed.unwrap(), wanted);
    }

    #[test]
    fn options_that_do_not_fit_the_scenario_are_refused() {
        let message = |line: &[&str]| options_of(line).unwrap_err().to_string();
        assert_eq!(message(&["--methods", "kf"]), "mine has no method `kf`");
        assert_eq!(message(&["--methods", "free,free"]), "--methods names `free` twice");
        assert!(message(&["--cycles", "3"]).contains("counts scores from cycle 6"));
    }
}
