//! `isobar check`.

use super::arguments::CheckArguments;
use super::console::{print, print_json, show, warn, width};
use super::list::described;
use super::lookup;
use super::write_back::name_database;
use crate::memory;
use crate::run::experiment::{self, Checked, Cost};
use crate::scenario::{Scenario, ScenarioError};
use crate::tables::Table;
use crate::text::{clean, counted};
use miette::Report;
use serde_json::{Value, json};
use std::ffi::OsStr;
use std::process::ExitCode;

/// Says of each scenario whether it is valid, and what it is estimated to cost. One that is not valid does not keep the others
/// from being checked.
pub fn check(arguments: &CheckArguments) -> Result<ExitCode, Report> {
    let (mut code, mut found) = (ExitCode::SUCCESS, Vec::new());
    for argument in &arguments.scenarios {
        match check_one(argument, arguments) {
            Ok((scenario, checked)) if arguments.json => found.push(valid(&scenario, &checked)),
            Ok((scenario, checked)) => print_valid(&scenario, &checked)?,
            Err(faults) => {
                faults.iter().for_each(show);
                code = ExitCode::FAILURE;
                found.push(invalid(argument, &faults));
            }
        }
    }
    if arguments.json {
        print_json(&json!({ "scenarios": found }))?;
    }
    Ok(code)
}

/// What is found of a scenario.
///
/// # Errors
/// All that is wrong with it, as far as it can be told apart; at least one fault.
fn check_one(argument: &OsStr, arguments: &CheckArguments) -> Result<(Scenario, Checked), Vec<Report>> {
    let mut scenario = lookup::load(argument).map_err(|fault| vec![fault])?;
    name_database(&mut scenario, arguments.sensors.as_deref()).map_err(|fault| vec![fault])?;
    let located = |faults: Vec<experiment::ExperimentError>| -> Vec<Report> {
        faults.iter().map(|fault| fault.locate(&scenario).into()).collect()
    };
    let checked = experiment::check(&scenario).map_err(located)?;
    if scenario.sweep.is_some() {
        crate::batch::sweep::settings(&scenario, None).map_err(|fault| vec![fault.into()])?;
    }
    Ok((scenario, checked))
}

fn print_valid(scenario: &Scenario, checked: &Checked) -> Result<(), Report> {
    let grid = &scenario.grid.grid;
    let (cycles, window) = (scenario.cycle.count, scenario.cycle.window.hours());
    print(&format!(
        "{}: valid; {} × {} cells, {} of {window} h, methods {}",
        scenario.name,
        grid.nx,
        grid.ny,
        counted(cycles, "cycle"),
        super::list::methods(scenario)
    ))?;
    checked.information.iter().try_for_each(|information| print(information))?;
    let row = |(name, Cost { bytes, seconds }): &(String, Cost)| {
        vec![name.as_str().into(), memory::in_words(*bytes).into(), approximate(*seconds).into()]
    };
    let table = Table::new(&["method", "memory", "a cycle"], checked.costs.iter().map(row).collect());
    let all: f64 = checked.costs.iter().map(|(_, cost)| cost.seconds).sum();
    print(&format!(
        "Estimated from sizes and a short timing of the model on this machine; right within a factor of about 3:\n{}",
        table.terminal(width())
    ))?;
    print(&format!("All methods, {}: about {}", counted(cycles, "cycle"), approximate(all * cycles as f64)))?;
    checked.warnings.iter().for_each(|warning| warn(warning));
    Ok(())
}

/// A time with two digits, in a unit that suits it.
fn approximate(seconds: f64) -> String {
    let units = [(86400.0, "days"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms")];
    let (size, unit) = units.into_iter().find(|(size, _)| seconds >= *size).unwrap_or((1e-3, "ms"));
    let value = seconds / size;
    let decimals = if value < 0.095 { 3 } else { usize::from(value < 9.95) };
    format!("{value:.decimals$} {unit}")
}

fn valid(scenario: &Scenario, checked: &Checked) -> Value {
    let mut valid = described(scenario);
    valid["valid"] = true.into();
    valid["information"] = checked.information.clone().into();
    valid["warnings"] = checked.warnings.clone().into();
    let cost = |(name, cost): &(String, Cost)| json!({ "method": name, "memory_bytes": cost.bytes.round(), "seconds_per_cycle": cost.seconds });
    valid["estimates"] = checked.costs.iter().map(cost).collect();
    valid
}

/// A scenario with faults, the first of them as a whole.
fn invalid(argument: &OsStr, reports: &[Report]) -> Value {
    let faults: Vec<Value> = reports
        .iter()
        .flat_map(|report| match report.downcast_ref::<ScenarioError>() {
            Some(fault) => std::iter::once(fault).chain(fault.others()).map(of_scenario).collect(),
            None => vec![json!({ "error": report.to_string(), "help": report.help().map(|help| help.to_string()) })],
        })
        .collect();
    let first = faults.first().cloned().unwrap_or_default();
    let argument = clean(&argument.to_string_lossy());
    json!({ "file": argument, "valid": false, "error": first["error"], "help": first["help"], "faults": faults })
}

fn of_scenario(fault: &ScenarioError) -> Value {
    let (line, column) = fault.line_and_column().unzip();
    json!({ "line": line, "column": column, "error": fault.message(), "help": fault.own_help() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_two_digits_and_a_unit() {
        let times = [4e-5, 0.0042, 0.35, 3.0, 150.0, 9000.0, 1e6].map(approximate);
        assert_eq!(times, ["0.040 ms", "4.2 ms", "350 ms", "3.0 s", "2.5 min", "2.5 h", "12 days"]);
    }
}
