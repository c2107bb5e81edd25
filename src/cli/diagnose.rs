//! `isobar diagnose`.

use super::console::{print, print_json, width};
use crate::output::recorded::SavedRun;
use crate::scores::MethodScores;
use crate::shell::command;
use crate::tables::diagnostics::{all, in_words, worst_biases};
use crate::tables::terminal::sentences;
use crate::text::{listed, shown_path};
use miette::{Report, miette};
use serde_json::{Map, Value, json};
use std::path::PathBuf;
use std::process::ExitCode;

/// The most rows of a table that are printed; the report has them all.
const MOST_ROWS: usize = 60;

/// Biases that are shown without being asked for.
const WORST: usize = 5;

/// Prints the diagnostics of runs: the verdicts and the worst biases, and on request all tables.
pub fn diagnose(runs: &[PathBuf], with_all: bool, as_json: bool) -> Result<ExitCode, Report> {
    let runs = runs.iter().map(|run| SavedRun::open(run)).collect::<Result<Vec<_>, _>>()?;
    if as_json {
        let runs = runs.iter().map(described).collect::<Result<Vec<_>, _>>()?;
        print_json(&json!({ "runs": runs }))?;
        return Ok(ExitCode::SUCCESS);
    }
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
        if !with_all {
            if let Some(worst) = worst_biases(&run.summary, WORST).filled() {
                let title = "Biases with the largest errors for what is claimed of them";
                print(&format!("{title}\n{}\n", worst.terminal(width())))?;
            }
            let all = command("isobar diagnose --all", &[&run.directory]);
            let titles = listed(tables.iter().map(|titled| titled.title));
            print(&sentences(&format!("`{all}` also prints: {titles}"), width()))?;
            continue;
        }
        for titled in tables.iter().filter(|titled| titled.table.rows.len() <= MOST_ROWS) {
            print(&format!("{}\n{}\n", titled.title, titled.table.terminal_with_notes(width())))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The diagnostics of a run for a program: as `summary.json` has them, with the units of its variables.
fn described(run: &SavedRun) -> Result<Value, Report> {
    let summary = &run.summary;
    let units: Map<String, Value> =
        run.scores()?.variables.into_iter().map(|(name, unit)| (name, unit.into())).collect();
    let method = |(name, scores): (&String, &MethodScores)| json!({ "method": name, "diagnostics": scores.diagnostics, "stability": scores.stability, "failure": scores.failure });
    Ok(json!({
        "directory": shown_path(&run.directory),
        "scenario": summary.scenario,
        "seed": summary.seed,
        "cycles": summary.cycles,
        "scored_from_cycle": summary.scored_from_cycle,
        "units": units,
        "words": in_words(summary),
        "observations": summary.observations,
        "methods": summary.methods.iter().map(method).collect::<Vec<_>>(),
    }))
}
