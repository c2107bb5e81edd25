//! `isobar compare`.

use super::arguments::CompareArguments;
use super::console::{print, print_json, width};
use super::out_file;
use crate::comparison::{Comparison, Differences};
use crate::output::recorded::SavedRun;
use crate::tables::terminal::sentences;
use crate::text::shown_path;
use miette::{Report, miette};
use std::process::ExitCode;

/// Compares runs: a page, and the differences on the terminal.
pub fn compare(arguments: &CompareArguments) -> Result<ExitCode, Report> {
    let runs = arguments.runs.iter().map(|run| SavedRun::open(run)).collect::<Result<Vec<_>, _>>()?;
    let comparison = Comparison::new(runs)?;
    let html = comparison.html().map_err(|error| miette!("{error}"))?;
    out_file::write(&arguments.out, arguments.overwrite, html.as_bytes(), "pages of isobar", out_file::is_page)?;
    if arguments.json {
        print_json(&comparison.json(&arguments.out))?;
        return Ok(ExitCode::SUCCESS);
    }
    print(&format!("{}\n", comparison.legend().join("\n")))?;
    for (title, Differences { words, table }) in [
        ("Differences of the scores from run A", comparison.between_runs()),
        ("Differences of the scores from each run's best method", comparison.within_runs()),
    ] {
        if !table.rows.is_empty() {
            let (words, table) = (sentences(&words.join("\n"), width()), table.terminal(width()));
            print(&format!("{title}\n{words}\n\n{table}\n* significant at the level of 5 %\n"))?;
        }
    }
    print(&format!("{}: with intervals, scores and figures", shown_path(&arguments.out)))?;
    Ok(ExitCode::SUCCESS)
}
