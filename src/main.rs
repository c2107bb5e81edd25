//! The program.

use isobar::cli::{self, RunOptions};
use isobar::run::RunError;
use isobar::scenario::Scenario;
use isobar::sink::Sink;
use isobar::summary::Summary;
use miette::{Report, miette};
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main(&run)
}

/// Where the command line hands over to the experiment.
fn run(scenario: &Scenario, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, Report> {
    isobar::run::run(scenario, options, listener).map_err(|error| match error {
        RunError::Experiment(error) => error.locate(scenario).into(),
        error => miette!("{}: {error}", scenario.name),
    })
}
