//! `isobar resume`.

use super::arguments::ResumeArguments;
use super::seeds::SeedsOptions;
use super::{RunOptions, Runner, run, seeds, sweep};
use crate::checkpoint::journal;
use crate::interrupt;
use crate::scenario::Scenario;
use crate::seeds::{BatchKind, BatchPlan};
use crate::sink::directory::{SEEDS_FILE, SUMMARY_FILE, SWEEP_FILE, working};
use crate::text::clean;
use miette::{Report, miette};
use std::path::Path;
use std::process::ExitCode;

/// Goes on with interrupted runs, one after the other. All are looked at before the first one goes on.
pub fn resume(arguments: &ResumeArguments, runner: &Runner) -> Result<ExitCode, Report> {
    let found = arguments.runs.iter().map(|out| interrupted(out, arguments)).collect::<Result<Vec<_>, _>>()?;
    interrupt::listen();
    let mut code = ExitCode::SUCCESS;
    for (scenario, options, kind) in &found {
        let went_well = match kind {
            None => run::run_one(scenario, options, arguments.quiet, true, runner)?,
            Some(BatchKind::Seeds { seeds: list, against, all_files }) => {
                let wanted = SeedsOptions::of_plan(list.clone(), against.clone(), *all_files);
                seeds::run(scenario, options, &wanted, runner, arguments.quiet)?
            }
            Some(BatchKind::Sweep) => sweep::run_one(scenario, options, runner, arguments.quiet)?,
        };
        if !went_well {
            code = ExitCode::FAILURE;
        }
    }
    Ok(code)
}

/// What was interrupted: scenario, options, and of what it is a batch, if it is one.
type Interrupted = (Scenario, RunOptions, Option<BatchKind>);

/// The interrupted run, or batch of runs, that would have ended in `out`.
fn interrupted(out: &Path, arguments: &ResumeArguments) -> Result<Interrupted, Report> {
    let shown = clean(&out.display().to_string());
    let working = working(out)?;
    if !working.exists() {
        let is_complete = [SUMMARY_FILE, SEEDS_FILE, SWEEP_FILE].iter().any(|file| out.join(file).is_file());
        return Err(match is_complete {
            true => miette!("{shown}: the run is complete"),
            false => miette!(help = "`isobar run` begins one", "{shown}: no run was interrupted there"),
        });
    }
    let threads = arguments.threads.map(|threads| threads as usize);
    let batch = BatchPlan::read(&working).map_err(|reason| {
        miette!(help = "begin it anew with --overwrite", "{shown}: its batch cannot go on: {reason}")
    })?;
    if let Some(plan) = batch {
        return Ok((plan.run.scenario()?, plan.run.options(out, threads, false), Some(plan.kind)));
    }
    let plan = journal::plan(&working).map_err(|reason| {
        miette!(help = "begin it anew: `isobar run`", "{shown}: its journal is of no use: {reason}")
    })?;
    Ok((plan.run.scenario()?, plan.run.options(out, threads, arguments.live), None))
}
