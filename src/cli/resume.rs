//! `isobar resume`.

use super::arguments::ResumeArguments;
use super::{RunOptions, Runner, run};
use crate::checkpoint::journal;
use crate::interrupt;
use crate::scenario::Scenario;
use crate::scenario::text::clean;
use crate::sink::directory::working;
use miette::{Report, miette};
use std::path::Path;
use std::process::ExitCode;

/// Goes on with interrupted runs, one after the other. All are looked at before the first one goes on.
pub fn resume(arguments: &ResumeArguments, runner: &Runner) -> Result<ExitCode, Report> {
    let found = arguments.runs.iter().map(|out| interrupted(out, arguments)).collect::<Result<Vec<_>, _>>()?;
    interrupt::listen();
    let mut code = ExitCode::SUCCESS;
    for (scenario, options) in &found {
        if !run::run_one(scenario, options, arguments.quiet, true, runner)? {
            code = ExitCode::FAILURE;
        }
    }
    Ok(code)
}

/// The interrupted run that would have ended in `out`.
fn interrupted(out: &Path, arguments: &ResumeArguments) -> Result<(Scenario, RunOptions), Report> {
    let shown = clean(&out.display().to_string());
    let working = working(out)?;
    if !working.exists() {
        return Err(match out.join(crate::sink::directory::SUMMARY_FILE).is_file() {
            true => miette!("{shown}: the run is complete"),
            false => miette!(help = "`isobar run` begins one", "{shown}: no run was interrupted there"),
        });
    }
    let plan = journal::plan(&working).map_err(|reason| {
        miette!(help = "begin it anew: `isobar run`", "{shown}: its journal is of no use: {reason}")
    })?;
    let options = plan.options(out, arguments.threads.map(|threads| threads as usize), arguments.live);
    Ok((plan.scenario()?, options))
}
