//! `isobar run`.

use super::arguments::RunArguments;
use super::{RunOptions, Runner, lookup, print};
use crate::progress::Progress;
use crate::scenario::Scenario;
use crate::scenario::text::{clean, listed, nearest};
use crate::table;
use miette::{Report, miette};
use std::collections::HashMap;
use std::process::ExitCode;

/// Runs scenarios one after the other. All are read before the first one runs.
pub fn run(arguments: &RunArguments, runner: &Runner) -> Result<ExitCode, Report> {
    let scenarios = arguments.scenarios.iter().map(|argument| lookup::load(argument)).collect::<Result<Vec<_>, _>>()?;
    check_names(&scenarios)?;
    let all = scenarios.iter().map(|scenario| options(arguments, scenario)).collect::<Result<Vec<_>, _>>()?;
    for (scenario, options) in scenarios.iter().zip(&all) {
        let mut progress = Progress::new(arguments.quiet);
        let summary = runner(scenario, options, &mut progress)?;
        drop(progress);
        let scores = table::scores(&summary, scenario.model.variables());
        print(&format!("{}: {}\n\n{scores}\n", scenario.name, scenario.title))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Scenarios of the same name would write into the same directory.
fn check_names(scenarios: &[Scenario]) -> Result<(), Report> {
    let mut seen = HashMap::new();
    for scenario in scenarios {
        if let Some(other) = seen.insert(&scenario.name, &scenario.path) {
            let paths = [other, &scenario.path].map(|path| clean(&path.display().to_string()));
            return Err(miette!("{} and {} would write into the same directory", paths[0], paths[1]));
        }
    }
    Ok(())
}

fn options(arguments: &RunArguments, scenario: &Scenario) -> Result<RunOptions, Report> {
    for method in arguments.methods.iter().flatten() {
        if !scenario.methods.contains_key(method) {
            let names = || scenario.methods.keys().map(String::as_str);
            let near = nearest(method, names()).map_or(String::new(), |near| format!("did you mean `{near}`?\n"));
            let help = format!("{near}methods of {}: {}", scenario.name, listed(names()));
            return Err(miette!(help = help, "{} has no method `{}`", scenario.name, clean(method)));
        }
    }
    let cycles = arguments.cycles.map(|cycles| cycles as usize);
    if let Some(cycles) = cycles.filter(|&cycles| cycles < scenario.cycle.score_from_cycle) {
        let first = scenario.cycle.score_from_cycle;
        let help = format!("--cycles {first} or more, or a smaller score_from_cycle");
        return Err(miette!(
            help = help,
            "{} counts scores from cycle {first}, so {cycles} cycles have none",
            scenario.name
        ));
    }
    Ok(RunOptions {
        out: arguments.out.join(&scenario.name),
        methods: arguments.methods.clone(),
        cycles,
        seed: arguments.seed,
        threads: arguments.threads.map(|threads| threads as usize),
        overwrite: arguments.overwrite,
        netcdf: scenario.output.netcdf && !arguments.no_netcdf,
        rerun: scenario.output.rerun && !arguments.no_rerun,
    })
}
