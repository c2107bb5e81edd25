//! The program.

use isobar::cli::{self, RunOptions};
use isobar::progress::Progress;
use isobar::scenario::Scenario;
use isobar::summary::Summary;
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main(&run)
}

/// Where the command line hands over to the experiment.
fn run(_: &Scenario, _: &RunOptions, _: &mut Progress) -> Result<Summary, miette::Report> {
    Err(miette::miette!("this build cannot run experiments"))
}
