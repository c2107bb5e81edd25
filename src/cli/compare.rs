//! `isobar compare`.

use super::arguments::CompareArguments;
use super::console::{print, print_json, width};
use crate::comparison::{Comparison, Differences};
use crate::output::recorded::SavedRun;
use crate::safe_file;
use crate::tables::terminal::sentences;
use crate::text::shown_path;
use miette::{Report, miette};
use std::fs::File;
use std::io::{ErrorKind, Read};
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
    write(arguments, &html)?;
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

fn write(arguments: &CompareArguments, html: &str) -> Result<(), Report> {
    let shown = shown_path(&arguments.out);
    let write = if arguments.overwrite { safe_file::replace } else { safe_file::write_new };
    if arguments.overwrite && safe_file::open(&arguments.out).is_ok_and(|file| !is_page(file)) {
        let help = "--overwrite replaces only pages of isobar; --out writes to another place";
        return Err(miette!(help = help, "{shown} is no such page"));
    }
    write(&arguments.out, html.as_bytes()).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => {
            miette!(help = "--overwrite replaces it, --out writes to another place", "{shown} exists")
        }
        _ => miette!("cannot write {shown}: {error}"),
    })
}

/// Whether a file is a page that isobar wrote.
fn is_page(file: File) -> bool {
    let mut head = Vec::new();
    let is_read = file.take(HEAD_LENGTH).read_to_end(&mut head).is_ok();
    is_read && String::from_utf8_lossy(&head).contains(MARK)
}
