//! `isobar list`.

use super::arguments::ListArguments;
use super::console::{print, show, width};
use super::lookup;
use crate::kinds::reference::{self, KeyReference, Reference};
use crate::scenario::Scenario;
use crate::tables::{Cell, Table};
use crate::text::{clean, listed, nearest};
use miette::{Report, miette};
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
    let row = |KeyReference { name, unit, allowed, default, meaning }: &KeyReference| {
        [name.as_str(), *unit, allowed.as_str(), default.as_str(), *meaning].map(Cell::from).into()
    };
    let keys = Table::new(&["key", "unit", "value", "default", "meaning"], kind.keys.iter().map(row).collect());
    Ok(match keys.filled() {
        None => format!("{}. It has no keys.", kind.about),
        Some(keys) => format!("{}\n\n{}", kind.about, keys.terminal(width())),
    })
}

/// Lists the scenarios in ./scenarios; those that are not valid are reported after the list.
fn scenarios() -> Result<ExitCode, Report> {
    let (mut rows, mut faults) = (Vec::new(), Vec::new());
    let paths = lookup::all()?;
    if paths.is_empty() {
        return Err(miette!(
            help = "`isobar init` writes a scenario to start from",
            "there are no scenarios in ./scenarios"
        ));
    }
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
    print(&Table::new(&["scenario", "title", "grid", "methods"], rows).terminal(width()))?;
    faults.iter().for_each(show);
    Ok(if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The names of a scenario's methods.
pub fn methods(scenario: &Scenario) -> String {
    listed(scenario.methods.keys().map(String::as_str))
}
