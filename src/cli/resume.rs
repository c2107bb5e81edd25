//! `isobar resume`.

use super::arguments::ResumeArguments;
use super::console::print;
use super::outputs::check_switch;
use super::seeds::SeedsOptions;
use super::shown::Shown;
use super::write_back::{self, planned_scenario, write_sensors};
use super::{run, seeds, sweep};
use crate::batch::{BatchKind, BatchPlan};
use crate::interrupt;
use crate::options::RunOptions;
use crate::output::destination::is_complete;
use crate::output::directory::{BATCH_FILE, JOURNAL_FILE, Stage, holds, stage, tidy};
use crate::output::working;
use crate::run::checkpoint::journal;
use crate::run::finish;
use crate::scenario::Scenario;
use crate::sensors::write_back::SENSORS_FILE;
use crate::shell::command;
use crate::text::shown_path;
use miette::{IntoDiagnostic, Report, miette};
use std::path::Path;
use std::process::ExitCode;

/// What is left to be done of a run or batch.
enum Left {
    /// The rest of its cycles.
    Run(Box<Scenario>, RunOptions),
    /// The rest of its runs.
    Batch(Box<Scenario>, RunOptions, BatchKind),
    /// What comes after the last cycle; the scenario is that of sensors that are to be written back.
    End(Option<Box<Scenario>>),
}

/// Continues interrupted runs, one after the other. All are examined before the first one is continued.
pub fn resume(arguments: &ResumeArguments) -> Result<ExitCode, Report> {
    if arguments.live {
        check_switch("live")?;
    }
    let found = arguments.runs.iter().map(|out| Ok((out, left(out, arguments)?)));
    let found = found.collect::<Result<Vec<_>, Report>>()?;
    interrupt::listen();
    let mut code = ExitCode::SUCCESS;
    for (out, left) in &found {
        let went_well = match left {
            Left::Run(scenario, options) => run::run_one(scenario, options, arguments.quiet, &mut Shown::Printed)?,
            Left::Batch(scenario, options, BatchKind::Seeds { seeds: list, against, all_files }) => {
                let wanted = SeedsOptions::of_plan(list.clone(), against.clone(), *all_files);
                seeds::run(scenario, options, &wanted, arguments.quiet, &mut Shown::Printed)?
            }
            Left::Batch(scenario, options, BatchKind::Sweep) => sweep::run_one(scenario, options, arguments.quiet)?,
            Left::End(scenario) => end(out, scenario.as_deref())?,
        };
        if !went_well {
            code = ExitCode::FAILURE;
        }
    }
    Ok(code)
}

/// What is left of the run, or batch of runs, that was to end in `out`.
fn left(out: &Path, arguments: &ResumeArguments) -> Result<Left, Report> {
    let shown = shown_path(out);
    let stage = stage(out)?;
    let working = working::path(out)?;
    let is_there = |file: &str| working.join(file).is_file();
    if stage == Stage::Absent || (stage == Stage::Interrupted && !is_there(JOURNAL_FILE) && !is_there(BATCH_FILE)) {
        if stage == Stage::Interrupted {
            tidy(out);
        }
        return Err(nothing_left(out));
    }
    let threads = arguments.threads.map(|threads| threads as usize);
    let sensors = arguments.sensors.as_deref();
    if stage != Stage::Interrupted {
        // Of a batch nothing is written back.
        let writes = is_there(JOURNAL_FILE) && holds(out, SENSORS_FILE)?;
        let plan = writes.then(|| journal::plan(&working)).transpose();
        let plan = plan.map_err(|reason| miette!("{shown}: its journal cannot be used: {reason}"))?;
        let scenario = plan.map(|plan| planned_scenario(&plan.run, sensors, out, true)).transpose()?;
        return Ok(Left::End(scenario.map(Box::new)));
    }
    let batch = BatchPlan::read(&working).map_err(|reason| {
        let help = format!("--overwrite begins it anew; what is complete of it is in {}", shown_path(&working));
        miette!(help = help, "{shown}: its batch cannot be continued: {reason}")
    })?;
    if let Some(plan) = batch {
        let scenario = planned_scenario(&plan.run, sensors, out, false)?;
        return Ok(Left::Batch(Box::new(scenario), plan.run.options(out, threads, false), plan.kind));
    }
    let plan = journal::plan(&working).map_err(|reason| {
        miette!(help = "nothing of it can be used: begin it anew", "{shown}: its journal cannot be used: {reason}")
    })?;
    let scenario = planned_scenario(&plan.run, sensors, out, true)?;
    Ok(Left::Run(Box::new(scenario), plan.run.options(out, threads, arguments.live)))
}

/// Why there is nothing to be continued.
fn nothing_left(out: &Path) -> Report {
    let shown = shown_path(out);
    let is_complete = is_complete(out);
    let table = out.join(SENSORS_FILE);
    if is_complete && table.is_file() {
        let import = command("isobar sensors import sensors.db", &[&table]);
        let help = format!("if a database of sensors, as sensors.db, lacks its sensors: `{import}`");
        return miette!(help = help, "{shown}: the run is complete");
    }
    if is_complete {
        miette!("{shown}: the run is complete")
    } else {
        miette!("{shown}: no run was interrupted there, nor is one complete")
    }
}

/// Does what comes after the last cycle of a run; whether all went well.
fn end(out: &Path, scenario: Option<&Scenario>) -> Result<bool, Report> {
    let mut written = None;
    finish(out, &mut |out| {
        written = scenario.and_then(|scenario| write_sensors(scenario, out));
        !matches!(written, Some(Err(_)))
    })
    .into_diagnostic()?;
    let (of_sensors, wrote_sensors) = write_back::report(written);
    print(&format!("{}: the run is complete", shown_path(out)))?;
    of_sensors.map_or(Ok(()), |text| print(&text))?;
    Ok(wrote_sensors)
}
