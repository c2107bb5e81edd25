//! `isobar diagnose`.

use super::console::{print, width};
use crate::output::recorded::SavedRun;
use crate::tables::diagnostics::{all, in_words};
use crate::tables::terminal::sentences;
use crate::text::shown_path;
use miette::{Report, miette};
use std::path::PathBuf;
use std::process::ExitCode;

/// The most rows of a table that are printed; the report has them all.
const MOST_ROWS: usize = 60;

/// Prints the diagnostics of runs.
pub fn diagnose(runs: &[PathBuf]) -> Result<ExitCode, Report> {
    let runs = runs.iter().map(|run| SavedRun::open(run)).collect::<Result<Vec<_>, _>>()?;
    for run in &runs {
        let shown = shown_path(&run.directory);
        let tables = all(&run.summary);
        if tables.is_empty() {
            return Err(miette!(help = "run it again", "{shown}: its summary.json holds no diagnostics"));
        }
        let (first, last) = (run.summary.scored_from_cycle, run.summary.cycles);
        print(&format!("{shown}, cycles {first} to {last}; intervals hold with 95 %\n"))?;
        let words = in_words(&run.summary);
        if !words.is_empty() {
            print(&format!("{}\n", sentences(&words.join("\n"), width())))?;
        }
        for titled in tables.iter().filter(|titled| titled.table.rows.len() <= MOST_ROWS) {
            print(&format!("{}\n{}\n", titled.title, titled.table.terminal_with_notes(width())))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}
