//! `isobar exact`.

use super::arguments::ExactArguments;
use super::console::{print, width};
use super::threads::workers;
use super::{launch, long, lookup, out_file};
use crate::exact::{ExactOptions, ExactSummary, exact_heard};
use crate::progress::ExactProgress;
use crate::safe_file;
use crate::scenario::Scenario;
use crate::tables::scores;
use crate::text::shown_path;
use miette::Report;
use serde_json::{Value, json};
use std::path::Path;
use std::process::ExitCode;

/// The largest file that is replaced \[bytes\].
const LARGEST_FILE: u64 = 100_000_000;

/// Prints the exact performance of a scenario's methods.
pub fn run(arguments: &ExactArguments) -> Result<ExitCode, Report> {
    let scenario = lookup::load(&arguments.scenario)?;
    arguments.part.methods.iter().flatten().try_for_each(|method| launch::check_method(method, &scenario))?;
    let cycles = arguments.part.cycles.map(|cycles| cycles as usize);
    launch::check_cycles(cycles, &scenario)?;
    let options = ExactOptions { methods: arguments.part.methods.clone(), cycles };
    let workers = workers(arguments.part.threads)?;
    if let Some(out) = arguments.out.as_deref().filter(|out| !arguments.overwrite && out.exists()) {
        return Err(out_file::exists(out));
    }
    let progress = ExactProgress::new(arguments.quiet, &scenario.name);
    let summary = workers.install(|| exact_heard(&scenario, &options, &|done| progress.heard(done)));
    drop(progress);
    let summary = summary?;
    print(&text(&summary, &scenario))?;
    if let Some(out) = &arguments.out {
        let document = format!("{:#}\n", document(&summary, &scenario));
        out_file::write(out, arguments.overwrite, document.as_bytes(), "files of isobar exact", is_document)?;
        print(&format!("\nFile: {}", shown_path(out)))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The scores as JSON.
fn document(summary: &ExactSummary, scenario: &Scenario) -> Value {
    let left_out: Vec<Value> =
        summary.left_out.iter().map(|(method, reason)| json!({ "method": method, "reason": reason })).collect();
    json!({
        "exact": scenario.name,
        "title": scenario.title,
        "version": crate::VERSION,
        "cycles": summary.cycles,
        "scored_from_cycle": summary.scored_from_cycle,
        "scores": long::of_exact(summary, scenario.model.variables()),
        "left_out": left_out,
    })
}

/// Whether a file is such a document.
fn is_document(path: &Path) -> bool {
    let bytes = safe_file::read_named(path, LARGEST_FILE).ok();
    let document = bytes.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
    document.is_some_and(|document| document.get("exact").is_some() && document.get("scores").is_some())
}

fn text(summary: &ExactSummary, scenario: &Scenario) -> String {
    let table = scores::of_values(&summary.methods, scenario.model.variables()).terminal(width());
    let mut text = format!(
        "{}: {}\n\nExact root-mean-square error of background and analysis, and what is claimed of the latter, cycles {} to \
         {}\n{table}\n",
        scenario.name, scenario.title, summary.scored_from_cycle, summary.cycles
    );
    for (name, reason) in &summary.left_out {
        text += &format!("\n{name} is left out: {reason}");
    }
    text
}
