//! `isobar diagnose`.

use super::print;
use crate::diagnostics::tables::{Titled, all};
use crate::saved::SavedRun;
use crate::sink::report::tables::Cell;
use crate::table;
use crate::text::clean;
use miette::{Report, miette};
use std::path::PathBuf;
use std::process::ExitCode;

/// The most rows of a table that are printed; the report has them all.
const MOST_ROWS: usize = 60;

/// Prints the diagnostics of runs.
pub fn diagnose(runs: &[PathBuf]) -> Result<ExitCode, Report> {
    let runs = runs.iter().map(|run| SavedRun::open(run)).collect::<Result<Vec<_>, _>>()?;
    for run in &runs {
        let shown = clean(&run.directory.display().to_string());
        let tables = all(&run.summary);
        if tables.is_empty() {
            return Err(miette!(help = "run it again", "{shown}: its summary.json holds no diagnostics"));
        }
        let (first, last) = (run.summary.scored_from_cycle, run.summary.cycles);
        print(&format!("{shown}, cycles {first} to {last}; intervals hold with 95 %\n"))?;
        for titled in tables.iter().filter(|titled| titled.table.rows.len() <= MOST_ROWS) {
            print(&text(titled))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The most columns with notes that a terminal holds.
const MOST_WITH_NOTES: usize = 7;

/// The table below its heading; explanations are on the page, and what does not fit here.
fn text(titled: &Titled) -> String {
    let header: Vec<&str> = titled.table.header.iter().map(String::as_str).collect();
    let cell = |cell: &Cell| match cell.note.as_str() {
        note if !note.is_empty() && header.len() <= MOST_WITH_NOTES => format!("{} ({note})", cell.text),
        _ => cell.text.clone(),
    };
    let rows = titled.table.rows.iter().map(|row| row.iter().map(cell).collect());
    format!("{}\n{}\n", titled.title, table::plain(&header, rows.collect()))
}
