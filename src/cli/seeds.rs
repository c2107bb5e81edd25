//! `isobar run --seeds`.

use super::arguments::RunArguments;
use super::console::{print, show, width};
use super::launch::{self, failures};
use super::long;
use super::shown::Shown;
use crate::batch::seeds::{FailedSeed, SeedsSummary, run_all};
use crate::batch::{BatchKind, BatchPlan, Runner, interrupted, unfinished};
use crate::options::RunOptions;
use crate::output::report::{REPORT, REPORT_FILE};
use crate::output::{Outputs, STATE};
use crate::progress::RunsProgress;
use crate::ranks;
use crate::scenario::Scenario;
use crate::tables::Table;
use crate::text::{clean, shown_path};
use miette::{IntoDiagnostic, Report, miette};
use serde_json::json;
use std::fs;

/// What `--seeds` asks for, of one scenario.
pub struct SeedsOptions {
    seeds: Vec<u64>,
    against: String,
    all_files: bool,
}

impl SeedsOptions {
    /// What an interrupted batch was asked for.
    pub fn of_plan(seeds: Vec<u64>, against: String, all_files: bool) -> Self {
        Self { seeds, against, all_files }
    }
}

/// Finds out what is asked for; `None` without `--seeds`.
pub fn options(
    arguments: &RunArguments,
    scenario: &Scenario,
    options: &RunOptions,
) -> Result<Option<SeedsOptions>, Report> {
    let Some(count) = arguments.seeds else { return Ok(None) };
    let first = options.seed.unwrap_or(scenario.seed);
    let last = first.checked_add(count - 1).ok_or_else(|| miette!("there are no {count} seeds from {first} on"))?;
    let runs = |name: &str| options.methods.as_ref().is_none_or(|chosen| chosen.iter().any(|it| it == name));
    let mut methods = scenario.methods.keys().filter(|name| runs(name));
    let against = match &arguments.against {
        None => methods.next().cloned().unwrap_or_default(),
        Some(name) if methods.any(|it| it == name) => name.clone(),
        Some(name) => {
            launch::check_method(name, scenario)?;
            return Err(miette!("--against {} is not among the methods of --methods", clean(name)));
        }
    };
    Ok(Some(SeedsOptions { seeds: (first..=last).collect(), against, all_files: arguments.all_files }))
}

/// Runs a scenario with every seed, or, with `resume`, those that are not complete; whether none failed, and no method of any.
pub fn run(
    scenario: &Scenario,
    options: &RunOptions,
    wanted: &SeedsOptions,
    quiet: bool,
    shown: &mut Shown,
) -> Result<bool, Report> {
    run_by(&ranks::runner(launch::run_scenario), scenario, options, wanted, quiet, shown)
}

/// The same with another function that runs a scenario.
fn run_by(
    runner: &Runner<'_>,
    scenario: &Scenario,
    options: &RunOptions,
    wanted: &SeedsOptions,
    quiet: bool,
    shown: &mut Shown,
) -> Result<bool, Report> {
    let SeedsOptions { seeds, against, all_files } = wanted;
    let kind = BatchKind::Seeds { seeds: seeds.clone(), against: against.clone(), all_files: *all_files };
    let directory = BatchPlan::begin(scenario, options, kind, [scenario])?;
    let mut each = RunOptions { out: directory.path().to_path_buf(), ..options.clone() };
    if !wanted.all_files {
        each.outputs = Outputs::default();
    }
    // Nothing goes on from them.
    each.outputs.set(STATE, false);
    let methods = options.methods.as_ref().map_or(scenario.methods.len(), Vec::len);
    let analyses = methods * options.cycles.unwrap_or(scenario.cycle.count);
    let progress = RunsProgress::new(quiet, &scenario.name, "seeds", wanted.seeds.len(), analyses);
    let runs = run_all(scenario, &each, seeds, runner, &progress);
    drop(progress);
    if let Some(error) = interrupted(&options.out, directory.path(), seeds.len()) {
        return Err(error);
    }
    let runs = runs?;
    let missing: Vec<(String, String)> =
        runs.unfinished.iter().map(|seed| (format!("seed {}", seed.seed), seed.error.clone())).collect();
    if let Some(error) = unfinished(&options.out, directory.path(), seeds.len(), &missing) {
        return Err(error);
    }
    let summary = SeedsSummary::new(runs, &wanted.against).expect("a run is complete, or there is an error");
    summary.write(directory.path()).into_diagnostic()?;
    if options.outputs.contains(REPORT) {
        let html = summary.html(scenario).map_err(|error| miette!("{error}"))?;
        let path = directory.path().join(REPORT_FILE);
        fs::write(&path, html).map_err(|error| miette!("cannot write {}: {error}", shown_path(&path)))?;
    }
    directory.complete().into_diagnostic()?;
    match shown {
        Shown::Printed => {
            print(&text(&summary, scenario))?;
            print(&format!("Files: {}\n", shown_path(&options.out)))?;
        }
        Shown::Collected(runs) => runs.push(json!({
            "scenario": scenario.name,
            "title": scenario.title,
            "seeds": summary.seeds,
            "against": summary.against,
            "cycles": summary.cycles,
            "scored_from_cycle": summary.scored_from_cycle,
            "directory": shown_path(&options.out),
            "scores": long::of_seeds(&summary, scenario.model.variables()),
            "failures": summary.failed.iter().map(FailedSeed::to_string).collect::<Vec<_>>(),
        })),
    }
    if !summary.failed.is_empty() {
        let failed: Vec<String> = summary.failed.iter().map(FailedSeed::to_string).collect();
        show(&failures(&scenario.name, &failed));
    }
    Ok(summary.failed.is_empty())
}

fn text(summary: &SeedsSummary, scenario: &Scenario) -> String {
    let variables = scenario.model.variables();
    let (count, against) = (summary.seeds.len(), &summary.against);
    let tables = |tables: Vec<Table>| tables.iter().map(|it| it.terminal(width())).collect::<Vec<_>>().join("\n\n");
    let mut text = format!(
        "{}: {}\n\nMean over {count} seeds ± half the width of its 95 % interval, cycles {} to {}\n{}\n",
        scenario.name,
        scenario.title,
        summary.scored_from_cycle,
        summary.cycles,
        tables(summary.means(variables))
    );
    if summary.methods.len() > 1 {
        let differences = tables(summary.differences(variables));
        text += &format!(
            "\nDifference from {against} with the same seed, in % of its mean\n{differences}\n\n\
             * significant at the level of 5 %\n"
        );
    }
    for failed in &summary.failed {
        text += &format!("\nfailed: {failed}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::JobError;
    use crate::progress::RunListener;
    use crate::scores::{MethodScores, Summary};
    use std::path::Path;

    /// A runner that fails for some seeds.
    fn runner(
        fails: &'static [u64],
        may_pass: bool,
    ) -> impl Fn(&Scenario, &RunOptions, &mut RunListener<'_>) -> Result<Summary, JobError> + Sync {
        move |scenario, options, _| {
            let seed = options.seed.unwrap_or_default();
            if fails.contains(&seed) {
                let report = miette!("cycle 3, method fkf: it went wrong");
                return Err(JobError { report, may_pass, cannot_resume: false });
            }
            let mut scores = MethodScores::default();
            scores.values.insert("rmse_analysis.h".into(), seed as f64);
            Ok(Summary {
                scenario: scenario.name.clone(),
                seed,
                cycles: scenario.cycle.count,
                scored_from_cycle: scenario.cycle.score_from_cycle,
                version: crate::VERSION.into(),
                observations: Default::default(),
                methods: scenario.methods.keys().map(|name| (name.clone(), scores.clone())).collect(),
                ranks: None,
            })
        }
    }

    fn run_with(fails: &'static [u64], out: &Path) -> Result<bool, Report> {
        run_by(&Runner::here(runner(fails, false)), out, false)
    }

    fn run_by(runner: &Runner<'_>, out: &Path, resume: bool) -> Result<bool, Report> {
        let scenario = Scenario::parse(Path::new("mine.toml"), include_str!("template.toml")).unwrap();
        let outputs = Outputs::of(["netcdf", REPORT]);
        let options = RunOptions { threads: Some(2), outputs, resume, ..RunOptions::new(out) };
        let wanted = SeedsOptions { seeds: (1..=5).collect(), against: "fkf".into(), all_files: false };
        super::run_by(runner, &scenario, &options, &wanted, true, &mut Shown::Printed)
    }

    #[test]
    fn a_seed_that_fails_is_named_and_the_others_count() {
        let parent = tempfile::tempdir().unwrap();
        let out = parent.path().join("mine");
        assert!(!run_with(&[2], &out).unwrap(), "the exit code tells that something failed");
        let text = fs::read_to_string(out.join("seeds.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["seeds"], serde_json::json!([1, 3, 4, 5]));
        assert_eq!(json["failed"][0]["seed"], 2);
        assert_eq!(json["failed"][0]["error"], "cycle 3, method fkf: it went wrong");
        assert_eq!(json["methods"]["fkf"]["rmse_analysis.h"]["mean"], 3.25);
        let page = fs::read_to_string(out.join(REPORT_FILE)).unwrap();
        assert!(page.contains("seed 2: cycle 3, method fkf: it went wrong"));
    }

    /// As when the disk is full for a while: two seeds leave files, one does not, one fails for good.
    #[test]
    fn a_batch_some_of_whose_outputs_could_not_be_written_goes_on_later() {
        let parent = tempfile::tempdir().unwrap();
        let out = parent.path().join("my batch");
        let writes = |options: &RunOptions, summary: &Summary| {
            fs::create_dir_all(&options.out).unwrap();
            fs::write(options.out.join("summary.json"), serde_json::to_string(summary).unwrap()).unwrap();
        };
        let full = |scenario: &Scenario, options: &RunOptions, sink: &mut RunListener<'_>| match options.seed {
            Some(4) => runner(&[4], true)(scenario, options, sink),
            _ => runner(&[5], false)(scenario, options, sink).inspect(|summary| writes(options, summary)),
        };
        let error = run_by(&Runner::here(full), &out, false).unwrap_err();
        let said = error.to_string();
        assert!(said.contains("1 of 5 runs could not be completed. seed 4: cycle 3"), "{said}");
        let help = error.help().unwrap().to_string();
        assert!(help.contains("my batch'` runs the others") && !out.exists(), "{help}");
        // Once there is space, the others are run, and those alone; what failed for good does so again.
        let later = |scenario: &Scenario, options: &RunOptions, sink: &mut RunListener<'_>| {
            let is_trial = options.out.ends_with("trial");
            assert!(is_trial || [Some(4), Some(5)].contains(&options.seed), "{:?} is run again", options.seed);
            runner(&[5], false)(scenario, options, sink)
        };
        assert!(!run_by(&Runner::here(later), &out, true).unwrap());
        let json: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(out.join("seeds.json")).unwrap()).unwrap();
        assert_eq!(json["seeds"], serde_json::json!([1, 2, 3, 4]));
        assert_eq!(json["failed"][0]["seed"], 5);
    }

    #[test]
    fn if_all_seeds_fail_nothing_is_left_but_the_reason() {
        let parent = tempfile::tempdir().unwrap();
        let error = run_with(&[1, 2, 3, 4, 5], &parent.path().join("mine")).unwrap_err();
        assert!(format!("{error:?}").contains("it went wrong"), "{error:?}");
        assert!(error.to_string().contains("all 5 seeds failed"));
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    }
}
