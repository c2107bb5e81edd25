//! `isobar check`.

use super::arguments::CheckArguments;
use super::console::{print, print_json, show, warn};
use super::list::described;
use super::lookup;
use super::write_back::name_database;
use crate::run::experiment;
use crate::text::clean;
use miette::Report;
use serde_json::json;
use std::process::ExitCode;

/// Says of each scenario whether it is valid. One that is not does not keep the others from being checked.
pub fn check(arguments: &CheckArguments) -> Result<ExitCode, Report> {
    let (mut code, mut found) = (ExitCode::SUCCESS, Vec::new());
    for argument in &arguments.scenarios {
        let loaded = lookup::load(argument).and_then(|mut scenario| {
            name_database(&mut scenario, arguments.sensors.as_deref())?;
            Ok(scenario)
        });
        let checked = loaded.and_then(|scenario| match experiment::check(&scenario) {
            Ok(checked) if scenario.sweep.is_some() => {
                crate::batch::sweep::settings(&scenario, None).map(|_| (scenario, checked)).map_err(Report::from)
            }
            Ok(checked) => Ok((scenario, checked)),
            Err(error) => Err(error.locate(&scenario).into()),
        });
        match checked {
            Ok((scenario, checked)) if arguments.json => {
                let mut valid = described(&scenario);
                valid["valid"] = true.into();
                valid["information"] = checked.information.into();
                valid["warnings"] = checked.warnings.into();
                found.push(valid);
            }
            Ok((scenario, checked)) => {
                let grid = &scenario.grid.grid;
                let (cycles, window) = (scenario.cycle.count, scenario.cycle.window.hours());
                print(&format!(
                    "{}: valid; {} × {} cells, {cycles} cycles of {window} h, methods {}",
                    scenario.name,
                    grid.nx,
                    grid.ny,
                    super::list::methods(&scenario)
                ))?;
                checked.information.iter().try_for_each(|information| print(information))?;
                checked.warnings.iter().for_each(|warning| warn(warning));
            }
            Err(report) => {
                show(&report);
                code = ExitCode::FAILURE;
                let help = report.help().map(|help| help.to_string());
                let argument = clean(&argument.to_string_lossy());
                found.push(json!({ "file": argument, "valid": false, "error": report.to_string(), "help": help }));
            }
        }
    }
    if arguments.json {
        print_json(&json!({ "scenarios": found }))?;
    }
    Ok(code)
}
