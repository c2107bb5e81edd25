//! `isobar sweep`.

use super::arguments::SweepArguments;
use super::console::{print, show, width};
use super::{launch, lookup};
use crate::batch::sweep::{Outcome, SweepSummary, first_score, settings};
use crate::batch::{BatchKind, BatchPlan, Job, JobOutcome, interrupted, run_jobs, unfinished};
use crate::interrupt;
use crate::options::{CheckpointPolicy, RunOptions};
use crate::output::Outputs;
use crate::output::report::REPORT;
use crate::progress::RunsProgress;
use crate::ranks;
use crate::scenario::Scenario;
use crate::text::shown_path;
use miette::{IntoDiagnostic, Report, miette};
use std::fs;
use std::process::ExitCode;

/// Runs a scenario with all settings of its sweep. The exit code is 1 if a run or a method failed.
pub fn sweep(arguments: &SweepArguments) -> Result<ExitCode, Report> {
    let scenario = lookup::load(&arguments.scenario)?;
    arguments.part.methods.iter().flatten().try_for_each(|method| launch::check_method(method, &scenario))?;
    let cycles = arguments.part.cycles.map(|cycles| cycles as usize);
    launch::check_cycles(cycles, &scenario)?;
    let outputs = Outputs::of([REPORT].into_iter().filter(|report| scenario.outputs.contains(report)));
    let options = RunOptions {
        methods: arguments.part.methods.clone(),
        cycles,
        threads: arguments.part.threads.map(|threads| threads as usize),
        overwrite: arguments.overwrite,
        outputs,
        checkpoints: Some(CheckpointPolicy::default()),
        ..RunOptions::new(arguments.out.join(format!("{}-sweep", scenario.name)))
    };
    interrupt::listen();
    Ok(if run_one(&scenario, &options, arguments.quiet)? { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Runs a sweep, or continues it; whether nothing failed.
pub(super) fn run_one(scenario: &Scenario, options: &RunOptions, quiet: bool) -> Result<bool, Report> {
    let (sweep, settings) = settings(scenario, options.methods.as_deref())?;
    let seeds: Vec<u64> = (scenario.seed..).take(sweep.seeds).collect();
    let scenarios = settings.iter().map(|own| &own.scenario);
    let directory = BatchPlan::begin(scenario, options, BatchKind::Sweep, scenarios)?;
    let mut jobs = Vec::new();
    for own in &settings {
        let folder = directory.path().join(&own.directory);
        let text = own.scenario.text_in(&directory.destination().join(&own.directory));
        let written = fs::create_dir_all(&folder).and_then(|()| fs::write(folder.join("scenario.toml"), text));
        written.map_err(|error| miette!("cannot write {}: {error}", shown_path(&folder)))?;
        jobs.extend(seeds.iter().map(|&seed| Job {
            scenario: &own.scenario,
            seed,
            methods: Some(own.methods.clone()),
            out: folder.join(format!("seed-{seed}")),
        }));
    }
    let cycles = options.cycles.unwrap_or(scenario.cycle.count);
    let analyses: usize = settings.iter().map(|own| own.methods.len()).sum::<usize>() * cycles;
    let progress = RunsProgress::new(quiet, &scenario.name, "runs", jobs.len(), analyses.div_ceil(settings.len()));
    let each = RunOptions { outputs: Outputs::default(), ..options.clone() };
    let outcomes = run_jobs(&jobs, &each, &ranks::runner(launch::run_scenario), &progress);
    drop(progress);
    if let Some(error) = interrupted(&options.out, directory.path(), jobs.len()) {
        return Err(error);
    }
    let (schedule, outcomes) = outcomes?;
    let missing = outcomes.iter().filter_map(|(job, outcome)| match outcome {
        Err(error) if error.may_pass => {
            let (folder, seed) = (&settings[job / seeds.len()].directory, jobs[*job].seed);
            Some((format!("{folder}/seed-{seed}"), error.report.to_string()))
        }
        _ => None,
    });
    if let Some(error) = unfinished(&options.out, directory.path(), jobs.len(), &missing.collect::<Vec<_>>()) {
        return Err(error);
    }
    if let Some((_, Err(_))) = outcomes.iter().find(|(_, outcome)| outcome.is_err())
        && outcomes.iter().all(|(_, outcome)| outcome.is_err())
    {
        let first = outcomes.into_iter().find_map(|(_, outcome)| outcome.err()).expect("all of them failed");
        return Err(first.report.wrap_err(format!("all {} runs failed", jobs.len())));
    }
    let of_setting = |(job, outcome): JobOutcome| -> Outcome {
        (job / seeds.len(), outcome.map_err(|error| error.report.to_string()))
    };
    let outcomes: Vec<Outcome> = outcomes.into_iter().map(of_setting).collect();
    let score = sweep.score.clone().unwrap_or_else(|| first_score(scenario, &outcomes));
    let summary = SweepSummary::new(scenario, &settings, seeds.clone(), score, (schedule, outcomes), cycles);
    summary.write(directory.path(), scenario, options.outputs.contains(REPORT)).into_diagnostic()?;
    directory.complete().into_diagnostic()?;
    print(&text(&summary, scenario))?;
    print(&format!("Files: {}\n", shown_path(&options.out)))?;
    if !summary.failed.is_empty() {
        let failed: Vec<String> = summary.failed.iter().map(|(place, error)| format!("{place}: {error}")).collect();
        show(&launch::failures(&scenario.name, &failed));
    }
    Ok(summary.failed.is_empty())
}

fn text(summary: &SweepSummary, scenario: &Scenario) -> String {
    let (first, last) = (summary.scored_from_cycle, summary.cycles);
    let mut text = format!(
        "{}: {}\n\nMeans over {} seeds, cycles {first} to {last}\n",
        scenario.name,
        scenario.title,
        summary.seeds.len()
    );
    for table in summary.tables(scenario.model.variables()) {
        text += &format!("\n{}\n", table.terminal(width()));
    }
    let best = summary.best_in_words();
    if !best.is_empty() {
        text += &format!("\nBest settings (*)\n{}\n", best.join("\n"));
    }
    for (place, error) in &summary.failed {
        text += &format!("\nfailed: {place}: {error}");
    }
    text
}
