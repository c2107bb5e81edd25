//! The program.

use isobar::checkpoint;
use isobar::cli::{self, RunOptions};
use isobar::run::RunError;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar::sink::Sink;
use isobar::sink::directory::working;
use miette::{Report, miette};
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main(&run)
}

/// Where the command line hands over to the experiment.
fn run(scenario: &Scenario, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, Report> {
    isobar::run::run(scenario, options, listener).map_err(|error| match error {
        RunError::Experiment(error) => error.locate(scenario).into(),
        RunError::Place(error) => miette!("{}: {error}", scenario.name),
        error => {
            let kept = working(&options.out).ok().and_then(|working| Some(checkpoint::file::list(&working).first()?.0));
            let help = match kept {
                Some(cycle) => {
                    let out = options.out.display();
                    format!("the run is kept up to cycle {cycle}: `isobar resume {out}` continues it")
                }
                None => "nothing of the run is kept".to_string(),
            };
            miette!(help = help, "{}: {error}", scenario.name)
        }
    })
}
