//! `isobar compare`.

use super::arguments::CompareArguments;
use super::console::print;
use crate::comparison::Comparison;
use crate::output::recorded::SavedRun;
use crate::safe_file;
use crate::text::shown_path;
use miette::{Report, miette};
use std::io::ErrorKind;
use std::process::ExitCode;

/// Compares runs: a page, and the differences on the terminal.
pub fn compare(arguments: &CompareArguments) -> Result<ExitCode, Report> {
    let runs = arguments.runs.iter().map(|run| SavedRun::open(run)).collect::<Result<Vec<_>, _>>()?;
    let comparison = Comparison::new(runs)?;
    let html = comparison.html().map_err(|error| miette!("{error}"))?;
    write(arguments, &html)?;
    for (title, differences) in [
        ("Differences of analysis RMSE from run A", comparison.between_runs()),
        ("Differences of analysis RMSE from each run's best method", comparison.within_runs()),
    ] {
        if !differences.rows.is_empty() {
            print(&format!("{title}\n{}\n* significant at the level of 5 %\n", differences.terminal()))?;
        }
    }
    print(&format!("{}: with intervals, scores and figures", shown_path(&arguments.out)))?;
    Ok(ExitCode::SUCCESS)
}

fn write(arguments: &CompareArguments, html: &str) -> Result<(), Report> {
    let shown = shown_path(&arguments.out);
    let write = if arguments.overwrite { safe_file::replace } else { safe_file::write_new };
    write(&arguments.out, html.as_bytes()).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => {
            miette!(help = "--overwrite replaces it, --out writes to another place", "{shown} exists")
        }
        _ => miette!("cannot write {shown}: {error}"),
    })
}
