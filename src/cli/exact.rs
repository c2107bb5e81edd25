//! `isobar exact`.

use super::arguments::ExactArguments;
use super::console::{print, width};
use super::{launch, lookup};
use crate::exact::{ExactOptions, ExactSummary, exact};
use crate::scenario::Scenario;
use crate::tables::scores;
use miette::{IntoDiagnostic, Report};
use rayon::ThreadPoolBuilder;
use std::process::ExitCode;

/// Prints the exact performance of a scenario's methods.
pub fn run(arguments: &ExactArguments) -> Result<ExitCode, Report> {
    let scenario = lookup::load(&arguments.scenario)?;
    arguments.part.methods.iter().flatten().try_for_each(|method| launch::check_method(method, &scenario))?;
    let cycles = arguments.part.cycles.map(|cycles| cycles as usize);
    launch::check_cycles(cycles, &scenario)?;
    let options = ExactOptions { methods: arguments.part.methods.clone(), cycles };
    let threads = arguments.part.threads.map_or(0, |threads| threads as usize);
    let workers = ThreadPoolBuilder::new().num_threads(threads).build().into_diagnostic()?;
    let summary = workers.install(|| exact(&scenario, &options))?;
    print(&text(&summary, &scenario))?;
    Ok(ExitCode::SUCCESS)
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
