//! `isobar resume`.

use super::arguments::ResumeArguments;
use super::seeds::SeedsOptions;
use super::{run, seeds, sweep};
use crate::batch::{BatchKind, BatchPlan};
use crate::interrupt;
use crate::options::RunOptions;
use crate::output::directory::{SEEDS_FILE, SUMMARY_FILE, SWEEP_FILE, working};
use crate::run::checkpoint::{PlannedRun, journal};
use crate::scenario::Scenario;
use crate::text::shown_path;
use miette::{Report, miette};
use std::path::Path;
use std::process::ExitCode;

/// Continues interrupted runs, one after the other. All are examined before the first one is continued.
pub fn resume(arguments: &ResumeArguments) -> Result<ExitCode, Report> {
    let found = arguments.runs.iter().map(|out| interrupted(out, arguments)).collect::<Result<Vec<_>, _>>()?;
    interrupt::listen();
    let mut code = ExitCode::SUCCESS;
    for (scenario, options, kind) in &found {
        let went_well = match kind {
            None => run::run_one(scenario, options, arguments.quiet)?,
            Some(BatchKind::Seeds { seeds: list, against, all_files }) => {
                let wanted = SeedsOptions::of_plan(list.clone(), against.clone(), *all_files);
                seeds::run(scenario, options, &wanted, arguments.quiet)?
            }
            Some(BatchKind::Sweep) => sweep::run_one(scenario, options, arguments.quiet)?,
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
    let shown = shown_path(out);
    let working = working(out)?;
    if !working.exists() {
        let is_complete = [SUMMARY_FILE, SEEDS_FILE, SWEEP_FILE].iter().any(|file| out.join(file).is_file());
        return Err(if is_complete {
            miette!("{shown}: the run is complete")
        } else {
            miette!("{shown}: no run was interrupted there, nor is one complete")
        });
    }
    let threads = arguments.threads.map(|threads| threads as usize);
    let batch = BatchPlan::read(&working).map_err(|reason| {
        let help = format!("--overwrite begins it anew; what is complete of it is in {}", shown_path(&working));
        miette!(help = help, "{shown}: its batch cannot be continued: {reason}")
    })?;
    let scenario = |run: &PlannedRun| {
        run.scenario(out).map_err(|error| Report::from(error).wrap_err(format!("{shown} cannot be resumed")))
    };
    if let Some(plan) = batch {
        return Ok((scenario(&plan.run)?, plan.run.options(out, threads, false), Some(plan.kind)));
    }
    let plan = journal::plan(&working).map_err(|reason| {
        miette!(help = "nothing of it can be used: begin it anew", "{shown}: its journal cannot be used: {reason}")
    })?;
    Ok((scenario(&plan.run)?, plan.run.options(out, threads, arguments.live), None))
}
