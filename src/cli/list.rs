//! `isobar list`.

use super::{lookup, print, show};
use crate::scenario::Scenario;
use crate::scenario::text::listed;
use crate::tables::{Cell, Table};
use miette::{Report, miette};
use std::process::ExitCode;

/// Lists the scenarios in ./scenarios; those that are not valid are reported after the list.
pub fn list() -> Result<ExitCode, Report> {
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
    print(&Table::new(&["scenario", "title", "grid", "methods"], rows).terminal())?;
    faults.iter().for_each(show);
    Ok(if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The names of a scenario's methods.
pub fn methods(scenario: &Scenario) -> String {
    listed(scenario.methods.keys().map(String::as_str))
}
