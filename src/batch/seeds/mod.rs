//! The same experiment over several seeds: what holds of the methods, and not only of one stretch of weather.
//!
//! The runs of different seeds are independent. Over n of them a score has the mean m and the standard deviation s, and
//! the 95 % interval m ± t s/√n with Student's t of n − 1 degrees of freedom. Methods meet the same truths and the same
//! observations, so they are compared seed by seed: the mean of the differences has an interval of its own, far narrower
//! than those of the two scores.

mod files;
mod page;
mod runs;
mod tables;

pub use runs::{FailedSeed, SeedRuns, run_all};

use crate::batch::Schedule;
use crate::scores::Values;
use crate::scores::statistics::{Interval, independent_mean};
use indexmap::IndexMap;
use serde::Serialize;

/// The fewest seeds over which a spread can be estimated.
pub const FEWEST_SEEDS: u64 = 3;

/// Scores over seeds, as `seeds.json` holds them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SeedsSummary {
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
    /// The method with which the others are compared.
    pub against: String,
    /// The seeds whose runs are complete.
    pub seeds: Vec<u64>,
    /// What failed: whole runs, and methods of complete ones.
    pub failed: Vec<FailedSeed>,
    /// Scores by method, then by dotted name, `rmse_analysis.h`; their meaning is that in [`crate::scores::SCORES`].
    pub methods: IndexMap<String, IndexMap<String, SeedsScore>>,
}

/// A score over seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SeedsScore {
    /// Its mean over the seeds that have it.
    pub mean: f64,
    /// The mean's 95 % interval; `None` for fewer than three seeds.
    pub interval: Option<Interval>,
    /// How it differs from that of the method with which the others are compared; `None` for that method itself.
    pub difference: Option<PairedDifference>,
    /// The score of each seed, in the order of [`SeedsSummary::seeds`].
    pub values: Vec<Option<f64>>,
}

/// The mean over seeds of a score minus that of another method.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PairedDifference {
    /// The mean.
    pub mean: f64,
    /// Its 95 % interval; `None` for fewer than three seeds.
    pub interval: Option<Interval>,
    /// Whether the interval does not hold zero: whether the difference is significant at the level of 5 %.
    pub significant: Option<bool>,
    /// The mean of the other method's score over the same seeds.
    pub reference: f64,
}

impl SeedsSummary {
    /// The scores of runs that differ in their seeds only; `None` if none is complete.
    pub fn new(runs: SeedRuns, against: &str) -> Option<Self> {
        let SeedRuns { schedule, complete, failed, unfinished: _ } = runs;
        let first = complete.first()?;
        let scores: Vec<IndexMap<&str, Values>> = complete
            .iter()
            .map(|run| run.methods.iter().map(|(name, scores)| (name.as_str(), scores.all())).collect())
            .collect();
        let values = |method: &str, score: &str| -> Vec<Option<f64>> {
            scores.iter().map(|run| run.get(method)?.get(score).copied()).collect()
        };
        let mut names: IndexMap<&str, Vec<&str>> = IndexMap::new();
        for (method, own) in scores.iter().flatten() {
            let known = names.entry(method).or_default();
            for score in own.keys().filter(|score| !known.contains(&score.as_str())).collect::<Vec<_>>() {
                known.push(score);
            }
        }
        let methods = names.into_iter().map(|(method, scores)| {
            let scores = scores.into_iter().filter_map(|score| {
                let reference = (method != against).then(|| values(against, score));
                Some((score.to_string(), SeedsScore::new(values(method, score), reference.as_deref())?))
            });
            (method.to_string(), scores.collect())
        });
        Some(Self {
            scenario: first.scenario.clone(),
            cycles: first.cycles,
            scored_from_cycle: first.scored_from_cycle,
            version: first.version.clone(),
            schedule,
            against: against.to_string(),
            seeds: complete.iter().map(|run| run.seed).collect(),
            methods: methods.collect(),
            failed,
        })
    }

    fn score(&self, method: &str, score: &str) -> Option<&SeedsScore> {
        self.methods.get(method)?.get(score)
    }
}

impl SeedsScore {
    fn new(values: Vec<Option<f64>>, reference: Option<&[Option<f64>]>) -> Option<Self> {
        let mean = independent_mean(&values.iter().copied().flatten().collect::<Vec<_>>())?;
        let difference = reference.and_then(|reference| {
            let pairs = values.iter().zip(reference).filter_map(|(&own, &other)| own.zip(other));
            let (own, other): (Vec<f64>, Vec<f64>) = pairs.unzip();
            PairedDifference::new(&own, &other)
        });
        Some(Self { mean: mean.mean, interval: mean.interval(), difference, values })
    }
}

impl PairedDifference {
    fn new(own: &[f64], other: &[f64]) -> Option<Self> {
        let pairs: Vec<f64> = own.iter().zip(other).map(|(own, other)| own - other).collect();
        let mean = independent_mean(&pairs)?;
        let interval = mean.interval();
        let significant = interval.map(|interval| interval.excludes_zero());
        Some(Self { mean: mean.mean, interval, significant, reference: independent_mean(other)?.mean })
    }

    /// The difference and half the width of its interval in % of the other method's score.
    fn percent(&self) -> Option<(f64, Option<f64>)> {
        let percent = |value: f64| 100.0 * value / self.reference.abs();
        let half_width = self.interval.map(|interval| percent(interval.half_width()));
        Some((percent(self.mean), half_width)).filter(|it| it.0.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::kinds::SECONDS;
    use crate::scores::{Failure, MethodScores, Summary};

    fn run(seed: u64, methods: &[(&str, f64)]) -> Summary {
        let scores = |h: f64| {
            let values = [("rmse_analysis.h".to_string(), h), (SECONDS.to_string(), 0.5)].into();
            MethodScores { values, ..MethodScores::default() }
        };
        Summary {
            scenario: "s".into(),
            seed,
            cycles: 9,
            scored_from_cycle: 3,
            version: "0".into(),
            observations: Default::default(),
            methods: methods.iter().map(|&(name, h)| (name.to_string(), scores(h))).collect(),
            ranks: None,
        }
    }

    fn summary(complete: Vec<Summary>) -> SeedsSummary {
        let failed = vec![FailedSeed { seed: 99, method: None, error: "no".into() }];
        SeedsSummary::new(SeedRuns { schedule: Schedule::default(), complete, failed, unfinished: Vec::new() }, "kf")
            .unwrap()
    }

    /// Against a calculation by hand: mean 5, s = 1, t of 3 degrees of freedom 3.182.
    #[test]
    fn the_mean_has_students_interval_and_the_difference_is_taken_seed_by_seed() {
        let [low, high] = [5.0 - 1.0, 5.0 + 1.0];
        let values = [low, high, 5.0, 5.0];
        let runs = values.iter().zip(1..).map(|(&kf, seed)| run(seed, &[("kf", kf), ("fkf", kf + 0.1)])).collect();
        let summary = summary(runs);
        let kf = &summary.methods["kf"]["rmse_analysis.h"];
        let deviation = (2.0_f64 / 3.0).sqrt();
        let half_width = 3.182 * deviation / 2.0;
        assert_eq!((kf.mean, kf.difference), (5.0, None));
        assert!((kf.interval.unwrap().half_width() / half_width - 1.0).abs() < 0.005, "{kf:?}");
        let fkf = &summary.methods["fkf"]["rmse_analysis.h"].difference.unwrap();
        assert!((fkf.mean - 0.1).abs() < 1e-12 && fkf.interval.unwrap().half_width() < 1e-9);
        assert_eq!((fkf.significant, fkf.reference), (Some(true), 5.0));
        assert!((fkf.percent().unwrap().0 - 2.0).abs() < 1e-9);
        let time = &summary.methods["fkf"][SECONDS];
        assert_eq!((time.mean, time.difference.unwrap().significant), (0.5, Some(false)));
    }

    /// A method that is missing from a run costs only that pair.
    #[test]
    fn a_seed_without_a_method_counts_for_the_others() {
        let all: [(&str, f64); 2] = [("kf", 2.0), ("fkf", 3.0)];
        let runs = vec![run(1, &all), run(2, &[("kf", 8.0)]), run(3, &all), run(4, &all), run(5, &[("fkf", 9.0)])];
        let summary = summary(runs);
        let fkf = &summary.methods["fkf"]["rmse_analysis.h"];
        assert_eq!(fkf.values, [Some(3.0), None, Some(3.0), Some(3.0), Some(9.0)]);
        assert_eq!(fkf.mean, 4.5);
        let difference = fkf.difference.unwrap();
        assert_eq!((difference.mean, difference.reference), (1.0, 2.0));
        assert_eq!(summary.seeds, [1, 2, 3, 4, 5]);
    }

    #[test]
    fn a_method_that_failed_has_no_score_of_that_seed() {
        let all = [("kf", 2.0), ("fkf", 3.0)];
        let mut runs = vec![run(1, &all), run(2, &all), run(3, &all)];
        runs[1].methods["fkf"] = MethodScores {
            failure: Some(Failure { cycle: 4, reason: "lost".into() }),
            values: [(SECONDS.to_string(), 9.0)].into(),
            ..MethodScores::default()
        };
        let summary = summary(runs);
        assert_eq!(summary.methods["fkf"][SECONDS].values, [Some(0.5), None, Some(0.5)]);
        assert_eq!(summary.methods["kf"][SECONDS].values, [Some(0.5); 3]);
    }

    #[test]
    fn two_seeds_have_no_interval_and_none_no_summary() {
        let summary = summary(vec![run(1, &[("kf", 1.0)]), run(2, &[("kf", 3.0)])]);
        let kf = &summary.methods["kf"]["rmse_analysis.h"];
        assert_eq!((kf.mean, kf.interval), (2.0, None));
        let none = SeedRuns {
            schedule: Schedule::default(),
            complete: Vec::new(),
            failed: Vec::new(),
            unfinished: Vec::new(),
        };
        assert_eq!(SeedsSummary::new(none, "kf"), None);
    }
}
