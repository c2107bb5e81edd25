//! Scores over settings: the scenario again and again with other values of some keys, as its `[sweep]` says.
//!
//! A key below `methods.NAME` concerns that method alone. Every other key concerns all methods. A method is run with all
//! combinations of the values of the keys that concern it, each with the same seeds, and so meets the same truths and
//! observations in all settings but those that change the truth.

mod files;
mod heat;
mod page;
mod settings;
mod tables;

pub use settings::{Setting, settings};

use crate::batch::Schedule;
use crate::scenario::Scenario;
use crate::scores::statistics::{Interval, independent_mean};
use crate::scores::{MethodScores, Summary, Values};
use indexmap::IndexMap;
use serde::Serialize;
use toml::Value;

/// Scores over settings, as `sweep.json` holds them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SweepSummary {
    /// Name of the scenario.
    pub scenario: String,
    /// Number of cycles of each run.
    pub cycles: usize,
    /// First cycle that counts for the scores.
    pub scored_from_cycle: usize,
    /// Version of isobar.
    pub version: String,
    /// How the runs were distributed.
    pub schedule: Schedule,
    /// The seeds of each setting.
    pub seeds: Vec<u64>,
    /// The score by which settings are compared: less is better.
    pub score: String,
    /// What failed: directory of the run, and why.
    pub failed: Vec<(String, String)>,
    /// The results, method by method.
    pub methods: IndexMap<String, Vec<SettingScores>>,
    /// For each method the numbers of its best settings among them: one for each combination of values that all methods
    /// share, for these may change the truth. A method without any score has none.
    pub best: IndexMap<String, Vec<usize>>,
}

/// A method's scores with one setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SettingScores {
    /// The directory of its runs.
    pub directory: String,
    /// The values of the keys that concern the method.
    pub values: IndexMap<String, Value>,
    /// Scores by dotted name, `rmse_analysis.h`, `crps.h`.
    pub scores: IndexMap<String, SweepScore>,
}

/// A score over the seeds of a setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SweepScore {
    /// Its mean over the seeds that have it.
    pub mean: f64,
    /// The mean's 95 % interval; `None` for fewer than three seeds.
    pub interval: Option<Interval>,
    /// Number of seeds that have it.
    pub seeds: usize,
}

/// A run of a setting: its number among the settings, and what came of it.
pub type Outcome = (usize, Result<Summary, String>);

impl SweepSummary {
    /// The scores of runs.
    pub fn new(
        scenario: &Scenario,
        settings: &[Setting],
        seeds: Vec<u64>,
        score: String,
        (schedule, outcomes): (Schedule, Vec<Outcome>),
        cycles: usize,
    ) -> Self {
        let mut methods: IndexMap<String, Vec<SettingScores>> = IndexMap::new();
        let mut failed = Vec::new();
        for (number, setting) in settings.iter().enumerate() {
            let own = || outcomes.iter().filter(|(of, _)| *of == number).map(|(_, outcome)| outcome);
            for outcome in own() {
                match outcome {
                    Err(error) => failed.push((setting.directory.clone(), error.clone())),
                    Ok(summary) => failed.extend(summary.failures().map(|(name, failure)| {
                        let place = format!("{}/seed-{}, method {name}", setting.directory, summary.seed);
                        (place, format!("failed in cycle {}: {}", failure.cycle, failure.reason))
                    })),
                }
            }
            for method in &setting.methods {
                let all = own().filter_map(|outcome| outcome.as_ref().ok()?.methods.get(method)).map(MethodScores::all);
                methods.entry(method.clone()).or_default().push(SettingScores {
                    directory: setting.directory.clone(),
                    values: setting.values.clone(),
                    scores: means(all.collect()),
                });
            }
        }
        // In the order of the scenario.
        methods.sort_by_key(|name, _| scenario.methods.get_index_of(name));
        let best = methods.iter().map(|(name, own)| (name.clone(), best(name, own, &score))).collect();
        Self {
            scenario: scenario.name.clone(),
            cycles,
            scored_from_cycle: scenario.cycle.score_from_cycle,
            version: crate::VERSION.into(),
            schedule,
            seeds,
            score,
            failed,
            methods,
            best,
        }
    }
}

/// The score by which settings are compared unless the scenario says another: the analysis error of the first variable;
/// without a truth the departure of passive observations from the analysis, or of all from the background, of the first variable
/// that has one.
pub fn first_score(scenario: &Scenario, outcomes: &[Outcome]) -> String {
    let variables: Vec<&str> = scenario.model.variables().iter().map(|variable| variable.0).collect();
    let candidates = ["rmse_analysis", "passive_departure_analysis", "departure_background"];
    let keys = candidates.iter().flat_map(|kind| variables.iter().map(move |variable| format!("{kind}.{variable}")));
    let runs = || outcomes.iter().filter_map(|(_, outcome)| outcome.as_ref().ok());
    let has = |key: &String| runs().any(|run| run.methods.values().any(|scores| scores.values.contains_key(key)));
    let first = keys.clone().next().unwrap_or_default();
    keys.into_iter().find(has).unwrap_or(first)
}

/// The mean of each score over the runs that have it.
fn means(all: Vec<Values>) -> IndexMap<String, SweepScore> {
    let mut values: IndexMap<String, Vec<f64>> = IndexMap::new();
    for (name, value) in all.into_iter().flatten() {
        values.entry(name).or_default().push(value);
    }
    let mean = |(name, values): (String, Vec<f64>)| {
        let mean = independent_mean(&values)?;
        Some((name, SweepScore { mean: mean.mean, interval: mean.interval(), seeds: values.len() }))
    };
    values.into_iter().filter_map(mean).collect()
}

impl SettingScores {
    /// The values that all methods share, but for those of some keys.
    fn common(&self, method: &str, but: &[&str]) -> IndexMap<String, Value> {
        let own = format!("methods.{method}.");
        let common = self.values.iter().filter(|(key, _)| !key.starts_with(&own) && !but.contains(&key.as_str()));
        common.map(|(key, value)| (key.clone(), value.clone())).collect()
    }
}

/// Shared values, and the settings that have them, with their numbers.
type Group<'a> = (IndexMap<String, Value>, Vec<(usize, &'a SettingScores)>);

/// The settings of a method in groups of the same shared values, but for those of some keys.
fn groups<'a>(method: &str, settings: &'a [SettingScores], but: &[&str]) -> Vec<Group<'a>> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for (number, own) in settings.iter().enumerate() {
        let common = own.common(method, but);
        match groups.iter_mut().find(|group| group.0 == common) {
            Some(group) => group.1.push((number, own)),
            None => groups.push((common, vec![(number, own)])),
        }
    }
    groups
}

/// The number of the setting with the least mean in each group, the first of several; settings with a failed seed do not
/// compete.
fn best(method: &str, settings: &[SettingScores], score: &str) -> Vec<usize> {
    let of_group = |(_, group): Group<'_>| {
        let scores = || group.iter().filter_map(|(number, own)| Some((*number, own.scores.get(score)?)));
        let most = scores().map(|(_, score)| score.seeds).max()?;
        let complete = scores().filter(|(_, score)| score.seeds == most);
        complete.min_by(|a, b| a.1.mean.total_cmp(&b.1.mean)).map(|(number, _)| number)
    };
    groups(method, settings, &[]).into_iter().filter_map(of_group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setting(common: i64, mean: f64, seeds: usize) -> SettingScores {
        let scores = [("rmse_analysis.h".to_string(), SweepScore { mean, interval: None, seeds })].into();
        let values = [("grid.nx", common), ("methods.var.scale", seeds as i64)];
        let values = values.map(|(key, value)| (key.to_string(), Value::Integer(value))).into();
        SettingScores { directory: String::new(), values, scores }
    }

    #[test]
    fn the_best_setting_has_the_least_score_of_those_that_never_failed() {
        let settings = [setting(1, 3.0, 4), setting(1, 1.0, 3), setting(1, 2.0, 4), setting(1, 2.0, 4)];
        assert_eq!(best("var", &settings, "rmse_analysis.h"), [2]);
        assert!(best("var", &settings, "rmse_analysis.u").is_empty());
        assert!(best("var", &[], "rmse_analysis.h").is_empty());
    }

    /// What all methods share may change the truth: scores of two truths are not compared.
    #[test]
    fn there_is_a_best_setting_for_each_combination_of_shared_values() {
        let settings = [setting(1, 3.0, 4), setting(2, 9.0, 4), setting(1, 2.0, 4), setting(2, 8.0, 4)];
        assert_eq!(best("var", &settings, "rmse_analysis.h"), [2, 3]);
        let of_key = groups("var", &settings, &["grid.nx"]);
        assert_eq!((of_key.len(), of_key[0].1.len()), (1, 4));
    }

    #[test]
    fn means_are_over_the_runs_that_have_the_score() {
        let run = |entries: &[(&str, f64)]| entries.iter().map(|&(name, value)| (name.to_string(), value)).collect();
        let found = means(vec![run(&[("a", 1.0)]), run(&[("a", 3.0), ("b", 5.0)]), run(&[("a", 2.0)])]);
        assert_eq!((found["a"].mean, found["a"].seeds, found["b"].mean, found["b"].seeds), (2.0, 3, 5.0, 1));
        // Student's t of 2 degrees of freedom times 1/√3.
        let half_width = found["a"].interval.unwrap().half_width();
        assert!((half_width / (4.303 / 3f64.sqrt()) - 1.0).abs() < 0.01, "{half_width}");
    }
}
