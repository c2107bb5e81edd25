//! `isobar list`.

use super::arguments::ListArguments;
use super::console::{print, show, width};
use super::lookup;
use crate::reference::{self, Reference};
use crate::scenario::Scenario;
use crate::shipped;
use crate::tables::{Cell, Table, keys};
use crate::text::{clean, listed, nearest};
use miette::{Report, miette};
use std::path::PathBuf;
use std::process::ExitCode;

/// Lists the kinds that a scenario may choose from, the keys of one of them, or the scenarios.
pub fn list(arguments: &ListArguments) -> Result<ExitCode, Report> {
    for reference in reference::all() {
        let chosen = match reference.option {
            "methods" => &arguments.methods,
            "models" => &arguments.models,
            "initial" => &arguments.initial,
            "covariances" => &arguments.covariances,
            "instruments" => &arguments.instruments,
            option => unreachable!("--{option} is no option"),
        };
        if let Some(kind) = chosen {
            print(&kinds(&reference, kind.as_deref())?)?;
            return Ok(ExitCode::SUCCESS);
        }
    }
    scenarios()
}

/// All kinds of a list with a line about each, or the keys of one.
fn kinds(reference: &Reference, name: Option<&str>) -> Result<String, Report> {
    let all = &reference.kinds;
    let Some(name) = name else {
        let rows = all.iter().map(|kind| [kind.name, kind.about].map(Cell::from).into());
        return Ok(Table::new(&["kind", "what it is"], rows.collect()).terminal(width()));
    };
    let Some(kind) = all.iter().find(|kind| kind.name == name) else {
        let names = || all.iter().map(|kind| kind.name);
        let near = nearest(name, names()).map_or(String::new(), |near| format!("did you mean `{near}`?\n"));
        let help = format!("{near}there are: {}", listed(names()));
        return Err(miette!(help = help, "there is no kind `{}` of {}", clean(name), reference.title.to_lowercase()));
    };
    Ok(match keys::table(&kind.keys).filled() {
        None => format!("{}. It has no keys.", kind.about),
        Some(keys) => format!("{}\n\n{}", kind.about, keys.terminal(width())),
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
