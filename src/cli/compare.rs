//! `isobar compare`.

use super::arguments::CompareArguments;
use super::console::{print, print_json, width};
use super::out_file;
use crate::comparison::{Comparison, Differences};
use crate::output::recorded::SavedRun;
use crate::safe_file;
use crate::tables::terminal::sentences;
use crate::text::shown_path;
use miette::{Report, miette};
use std::io::Read;
use std::path::Path;
use std::process::ExitCode;

/// What every page of isobar has in its head.
const MARK: &str = "<meta name=\"generator\" content=\"isobar\">";

/// Bytes within which it has that.
const HEAD_LENGTH: u64 = 500;

/// Compares runs: a page, and the differences on the terminal.
pub fn compare(arguments: &CompareArguments) -> Result<ExitCode, Report> {
    let runs = arguments.runs.iter().map(|run| SavedRun::open(run)).collect::<Result<Vec<_>, _>>()?;
    let comparison = Comparison::new(runs)?;
    let html = comparison.html().map_err(|error| miette!("{error}"))?;
    out_file::write(&arguments.out, arguments.overwrite, html.as_bytes(), "pages of isobar", is_page)?;
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

/// Whether a file is a page that isobar wrote. One that cannot be opened cannot be replaced either, and that says why.
fn is_page(path: &Path) -> bool {
    let Ok(file) = safe_file::open(path) else { return true };
    let mut head = Vec::new();
    let is_read = file.take(HEAD_LENGTH).read_to_end(&mut head).is_ok();
    is_read && String::from_utf8_lossy(&head).contains(MARK)
}
