//! What the commands that run scenarios share.

use crate::options::RunOptions;
use crate::output::Sink;
use crate::output::directory::{checkpoints, working};
use crate::run::{self, RunError};
use crate::scenario::Scenario;
use crate::scores::Summary;
use crate::text::{clean, listed, nearest};
use miette::{Report, miette};

/// Runs a scenario. An error names the scenario, and what of the run is kept.
pub fn run_scenario(scenario: &Scenario, options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, Report> {
    run::run(scenario, options, listener).map_err(|error| match error {
        RunError::Experiment(error) => error.locate(scenario).into(),
        RunError::Place(error) => miette!("{}: {error}", scenario.name),
        error => {
            let kept = working(&options.out).ok().and_then(|working| Some(checkpoints(&working).first()?.0));
            let help = kept.map_or("nothing of the run is kept".to_string(), |cycle| {
                let out = options.out.display();
                format!("the run is kept up to cycle {cycle}: `isobar resume {out}` continues it")
            });
            miette!(help = help, "{}: {error}", scenario.name)
        }
    })
}

/// Refuses a method that the scenario does not have.
pub fn check_method(method: &str, scenario: &Scenario) -> Result<(), Report> {
    if scenario.methods.contains_key(method) {
        return Ok(());
    }
    let names = || scenario.methods.keys().map(String::as_str);
    let near = nearest(method, names()).map_or(String::new(), |near| format!("did you mean `{near}`?\n"));
    let help = format!("{near}methods of {}: {}", scenario.name, listed(names()));
    Err(miette!(help = help, "{} has no method `{}`", scenario.name, clean(method)))
}

/// Refuses a number of cycles of which none counts for the scores.
pub fn check_cycles(cycles: Option<usize>, scenario: &Scenario) -> Result<(), Report> {
    let first = scenario.cycle.score_from_cycle;
    let Some(cycles) = cycles.filter(|&cycles| cycles < first) else { return Ok(()) };
    let help = format!("--cycles {first} or more, or a smaller score_from_cycle");
    Err(miette!(help = help, "{} counts scores from cycle {first}, so {cycles} cycles have none", scenario.name))
}
