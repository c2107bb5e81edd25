//! `isobar list`.

use super::arguments::ListArguments;
use super::console::{print, print_json, show, width};
use super::{explain, lookup};
use crate::reference::{self, KindReference, Reference};
use crate::scenario::Scenario;
use crate::shipped;
use crate::tables::{Cell, Table};
use crate::text::{clean, listed, nearest, shown_path};
use miette::{Report, miette};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::process::ExitCode;

/// Lists the kinds that a scenario may choose from, the keys of one of them, or the scenarios.
pub fn list(arguments: &ListArguments) -> Result<ExitCode, Report> {
    for reference in reference::all() {
        let chosen = match reference.option {
            "methods" => &arguments.of.methods,
            "models" => &arguments.of.models,
            "initial" => &arguments.of.initial,
            "covariances" => &arguments.of.covariances,
            "instruments" => &arguments.of.instruments,
            option => unreachable!("--{option} is no option"),
        };
        if let Some(kind) = chosen {
            print_kinds(&reference, kind.as_deref(), arguments.json)?;
            return Ok(ExitCode::SUCCESS);
        }
    }
    if arguments.json { scenarios_as_json() } else { scenarios() }
}

/// All kinds of a list with a line about each, or the keys of one.
fn print_kinds(reference: &Reference, name: Option<&str>, as_json: bool) -> Result<(), Report> {
    let all = &reference.kinds;
    let Some(name) = name else {
        if as_json {
            let kind = |kind: &KindReference| json!({ "kind": kind.name, "about": kind.about });
            return print_json(&json!({ "kinds": all.iter().map(kind).collect::<Vec<_>>() }));
        }
        let rows = all.iter().map(|kind| [kind.name, kind.about].map(Cell::from).into());
        return print(&Table::new(&["kind", "what it is"], rows.collect()).terminal(width()));
    };
    let Some(kind) = all.iter().find(|kind| kind.name == name) else {
        let names = || all.iter().map(|kind| kind.name);
        let near = nearest(name, names()).map_or(String::new(), |near| format!("did you mean `{near}`?\n"));
        let help = format!("{near}there are: {}", listed(names()));
        return Err(miette!(help = help, "there is no kind `{}` of {}", clean(name), reference.title.to_lowercase()));
    };
    if as_json {
        return print_json(&json!({ "kind": kind.name, "about": kind.about, "keys": kind.keys }));
    }
    print(&match explain::table(&kind.keys).filled() {
        None => format!("{}. It has no keys.", kind.about),
        Some(keys) => format!("{}\n\n{}", kind.about, keys.terminal(width())),
    })
}

/// The same list for a program.
fn scenarios_as_json() -> Result<ExitCode, Report> {
    let (mut scenarios, mut faults) = (Vec::new(), Vec::new());
    for path in lookup::known()? {
        match Scenario::load(&path) {
            Ok(scenario) => scenarios.push(described(&scenario)),
            Err(error) => faults.push(Report::from(error)),
        }
    }
    print_json(&json!({ "scenarios": scenarios }))?;
    faults.iter().for_each(show);
    Ok(if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// A scenario in short, for a program.
pub fn described(scenario: &Scenario) -> Value {
    let grid = &scenario.grid.grid;
    let variable = |(name, unit): &(&str, &str)| json!({ "name": name, "unit": unit });
    json!({
        "scenario": scenario.name,
        "file": shown_path(&scenario.path),
        "title": scenario.title,
        "phenomenon": scenario.phenomenon,
        "grid": { "nx": grid.nx, "ny": grid.ny, "dx_km": grid.dx_m / 1e3, "dy_km": grid.dy_m / 1e3 },
        "variables": scenario.model.variables().iter().map(variable).collect::<Vec<_>>(),
        "cycles": scenario.cycle.count,
        "window_hours": scenario.cycle.window.hours(),
        "methods": scenario.methods.iter().map(|(name, method)| json!({ "name": name, "kind": method.kind })).collect::<Vec<_>>(),
    })
}

/// Lists the scenarios in ./scenarios and those inside the program; those that are not valid are reported after the list.
fn scenarios() -> Result<ExitCode, Report> {
    let mut faults = Vec::new();
    let (inside, outside): (Vec<PathBuf>, _) = lookup::known()?.into_iter().partition(|path| shipped::contains(path));
    let mut tables = Vec::new();
    for (title, paths) in [("In ./scenarios", outside), ("In isobar", inside)] {
        let mut rows = Vec::new();
        for path in paths {
            match Scenario::load(&path) {
                Ok(scenario) => {
                    let grid = format!("{} × {}", scenario.grid.grid.nx, scenario.grid.grid.ny);
                    let methods = methods(&scenario);
                    rows.push([scenario.name, scenario.title, grid, methods].map(Cell::from).into());
                }
                Err(error) => faults.push(Report::from(error)),
            }
        }
        let table = Table::new(&["scenario", "title", "grid", "methods"], rows).filled();
        tables.extend(table.map(|table| (title, table.terminal(width()))));
    }
    match tables.as_slice() {
        [(_, only)] => print(only)?,
        tables => {
            let shown = tables.iter().map(|(title, table)| format!("{title}\n{table}"));
            print(&shown.collect::<Vec<_>>().join("\n\n"))?;
        }
    }
    faults.iter().for_each(show);
    Ok(if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The names of a scenario's methods.
pub fn methods(scenario: &Scenario) -> String {
    listed(scenario.methods.keys().map(String::as_str))
}
