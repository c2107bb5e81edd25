//! `isobar compare`.

use super::arguments::CompareArguments;
use super::console::print;
use crate::comparison::Comparison;
use crate::output::recorded::SavedRun;
use miette::{Report, miette};
use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

/// Compares runs: a page, and the differences on the terminal.
pub fn compare(arguments: &CompareArguments) -> Result<ExitCode, Report> {
    let runs = arguments.runs.iter().map(|run| SavedRun::open(run)).collect::<Result<Vec<_>, _>>()?;
    let comparison = Comparison::new(runs)?;
    let html = comparison.html().map_err(|error| miette!("{error}"))?;
    write(arguments, &html)?;
    for (title, differences) in [
        ("Differences of the scores from run A", comparison.between_runs()),
        ("Differences of the scores from each run's best method", comparison.within_runs()),
    ] {
        if !differences.rows.is_empty() {
            print(&format!("{title}\n{}\n* significant at the level of 5 %\n", differences.terminal()))?;
        }
    }
    print(&format!("{}: with intervals, scores and figures", arguments.out.display()))?;
    Ok(ExitCode::SUCCESS)
}

fn write(arguments: &CompareArguments, html: &str) -> Result<(), Report> {
    let path = &arguments.out;
    let mut options = OpenOptions::new();
    options.write(true).truncate(true);
    if arguments.overwrite {
        options.create(true)
    } else {
        options.create_new(true)
    };
    let written = options.open(path).and_then(|mut file| file.write_all(html.as_bytes()));
    written.map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => {
            miette!(help = "--overwrite replaces it, --out writes to another place", "{} exists", path.display())
        }
        _ => miette!("cannot write {}: {error}", path.display()),
    })
}
