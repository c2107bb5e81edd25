//! `isobar exact`.

use super::arguments::ExactArguments;
use super::console::{print, width};
use super::{launch, long, lookup};
use crate::exact::{ExactOptions, ExactSummary, exact_heard};
use crate::progress::ExactProgress;
use crate::safe_file;
use crate::scenario::Scenario;
use crate::tables::scores;
use crate::text::shown_path;
use miette::{IntoDiagnostic, Report, miette};
use rayon::ThreadPoolBuilder;
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
    let threads = arguments.part.threads.map_or(0, |threads| threads as usize);
    let workers = ThreadPoolBuilder::new().num_threads(threads).build().into_diagnostic()?;
    if let Some(out) = arguments.out.as_deref().filter(|out| !arguments.overwrite && out.exists()) {
        let help = "--overwrite replaces it, --out writes to another place";
        return Err(miette!(help = help, "{} exists", shown_path(out)));
    }
    let progress = ExactProgress::new(arguments.quiet, &scenario.name);
    let summary = workers.install(|| exact_heard(&scenario, &options, &|done| progress.heard(done)));
    drop(progress);
    let summary = summary?;
    print(&text(&summary, &scenario))?;
    if let Some(out) = &arguments.out {
        write(out, arguments.overwrite, &summary, &scenario)?;
        print(&format!("\nFile: {}", shown_path(out)))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the scores as JSON; a file that is no such file is not replaced.
fn write(out: &Path, overwrite: bool, summary: &ExactSummary, scenario: &Scenario) -> Result<(), Report> {
    let shown = shown_path(out);
    let left_out: Vec<Value> =
        summary.left_out.iter().map(|(method, reason)| json!({ "method": method, "reason": reason })).collect();
    let document = json!({
        "exact": scenario.name,
        "title": scenario.title,
        "version": crate::VERSION,
        "cycles": summary.cycles,
        "scored_from_cycle": summary.scored_from_cycle,
        "scores": long::of_exact(summary, scenario.model.variables()),
        "left_out": left_out,
    });
    if overwrite && out.exists() {
        let old = safe_file::read_named(out, LARGEST_FILE).ok();
        let old = old.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
        if !old.is_some_and(|old| old.get("exact").is_some() && old.get("scores").is_some()) {
            let help = "--overwrite replaces only files of isobar exact; --out writes to another place";
            return Err(miette!(help = help, "{shown} is no such file"));
        }
    }
    let write = if overwrite { safe_file::replace } else { safe_file::write_new };
    write(out, format!("{document:#}\n").as_bytes()).map_err(|error| miette!("cannot write {shown}: {error}"))
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
