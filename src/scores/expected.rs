//! The accepted scores of a scenario, and how a run compares with them.

use super::kinds::SCORES;
use super::{Summary, Values};
use indexmap::IndexMap;
use std::fmt::Write;

/// The key of the tolerance in `[expected]`.
pub const TOLERANCE_KEY: &str = "relative_tolerance";

/// The accepted scores of a scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// How far a score may be from the accepted one, relative to it.
    pub relative_tolerance: f64,
    /// Scores by method, of the kinds that are compared.
    pub methods: IndexMap<String, Values>,
}

impl Expected {
    /// The scores of a run as the accepted ones.
    pub fn from_summary(summary: &Summary, relative_tolerance: f64) -> Self {
        let regressed = |values: &Values| -> Values {
            let mut all = Values::new();
            for kind in SCORES.iter().filter(|kind| kind.regressed) {
                all.extend(of_kind(values, kind.name).map(|(key, value)| (key.clone(), value)));
            }
            all
        };
        let methods = summary.methods.iter().map(|(name, scores)| (name.clone(), regressed(&scores.values)));
        Self { relative_tolerance, methods: methods.collect() }
    }

    /// The section `[expected]` of the scenario. Scores have five digits.
    pub fn to_toml(&self) -> String {
        let mut text = String::from("[expected]\n# Written by `isobar regress --accept`.\n");
        writeln!(text, "{TOLERANCE_KEY} = {}", self.relative_tolerance).expect("a String takes any text");
        for (method, values) in &self.methods {
            write!(text, "\n[expected.{method}]\n").expect("a String takes any text");
            for kind in SCORES {
                let entry = |(key, value): (&String, f64)| match key.split_once('.') {
                    Some((_, variable)) => format!("{variable} = {}", digits(value)),
                    None => digits(value),
                };
                let entries = of_kind(values, kind.name).map(entry).collect::<Vec<_>>().join(", ");
                if entries.is_empty() {
                    continue;
                }
                let entries = if kind.per_variable { format!("{{ {entries} }}") } else { entries };
                text += &format!("{} = {entries}\n", kind.name);
            }
        }
        text
    }
}

/// The values of a kind, with their keys.
fn of_kind<'a>(values: &'a Values, name: &'a str) -> impl Iterator<Item = (&'a String, f64)> {
    let is_of_kind = move |key: &str| key.split('.').next() == Some(name);
    values.iter().filter(move |(key, _)| is_of_kind(key)).map(|(key, &value)| (key, value))
}

/// A number of five significant digits, as TOML writes it.
fn digits(score: f64) -> String {
    let rounded: f64 = format!("{score:.4e}").parse().unwrap_or(score);
    format!("{rounded:?}")
}

/// A score of a run beside the accepted one.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// The method.
    pub method: String,
    /// The key of the score, `rmse_analysis.h`.
    pub score: String,
    /// The accepted value; `None` if there is none yet.
    pub from: Option<f64>,
    /// The value of the run; `None` if the run has none.
    pub to: Option<f64>,
    /// The change relative to the accepted value \[%\]; `None` unless there are both, or if it is infinite.
    pub change_percent: Option<f64>,
    /// Whether both values exist and differ by no more than the tolerance.
    pub within_tolerance: bool,
}

/// The scores of a run beside the accepted ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// The relative tolerance.
    pub relative_tolerance: f64,
    /// Every score that either has.
    pub scores: Vec<Moved>,
}

impl Regression {
    /// Compares a run with the accepted scores.
    pub fn new(expected: &Expected, summary: &Summary) -> Self {
        let found = Expected::from_summary(summary, expected.relative_tolerance);
        let absent = Values::new();
        let gone = expected.methods.keys().filter(|name| !found.methods.contains_key(*name));
        let mut scores = Vec::new();
        for method in found.methods.keys().chain(gone) {
            let [accepted, found] = [expected, &found].map(|side| side.methods.get(method).unwrap_or(&absent));
            let gone = accepted.keys().filter(|score| !found.contains_key(*score));
            for score in found.keys().chain(gone) {
                let (from, to) = (accepted.get(score).copied(), found.get(score).copied());
                scores.push(moved(method, score, from, to, expected.relative_tolerance));
            }
        }
        Self { relative_tolerance: expected.relative_tolerance, scores }
    }

    /// Whether there are scores, all within the tolerance.
    pub fn passed(&self) -> bool {
        !self.scores.is_empty() && self.outside() == 0
    }

    /// Number of scores that are not within the tolerance.
    pub fn outside(&self) -> usize {
        self.scores.iter().filter(|score| !score.within_tolerance).count()
    }
}

fn moved(method: &str, score: &str, from: Option<f64>, to: Option<f64>, tolerance: f64) -> Moved {
    let both = from.zip(to);
    Moved {
        method: method.to_string(),
        score: score.to_string(),
        from,
        to,
        change_percent: both.map(|(from, to)| 100.0 * (to - from) / from.abs()).filter(|percent| percent.is_finite()),
        // Accepted scores are rounded to five digits: a relative 5e-5 at most.
        within_tolerance: both.is_some_and(|(from, to)| (to - from).abs() <= tolerance.max(5e-5) * from.abs()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::MethodScores;

    fn summary() -> Summary {
        let scores = |entries: &[(&str, f64)]| MethodScores {
            values: entries.iter().map(|&(key, value)| (key.to_string(), value)).collect(),
            ..MethodScores::default()
        };
        let free = scores(&[("rmse_background.h", 19.25), ("rmse_analysis.h", 19.25), ("rmse_analysis.u", 4.0)]);
        let filter = scores(&[("rmse_analysis.h", 3.84), ("bias_rmse", 0.77), ("seconds_per_cycle", 2.0)]);
        Summary {
            scenario: "test".into(),
            seed: 1,
            cycles: 40,
            scored_from_cycle: 10,
            version: "0".into(),
            observations: Default::default(),
            methods: [("free".to_string(), free), ("filter".to_string(), filter)].into(),
            ranks: None,
        }
    }

    #[test]
    fn a_run_agrees_with_itself_and_not_with_another() {
        let summary = summary();
        let expected = Expected::from_summary(&summary, 0.02);
        let same = Regression::new(&expected, &summary);
        assert!(same.passed() && same.scores.len() == 5, "the time is not compared: {same:?}");
        assert_eq!(same.describe(100), "5 scores, none moved");

        let mut other = summary.clone();
        other.methods["free"].values["rmse_analysis.h"] *= 1.05;
        other.methods["free"].values["rmse_analysis.u"] *= 0.99;
        let moved = Regression::new(&expected, &other);
        assert_eq!((moved.passed(), moved.outside()), (false, 1));
        let text = moved.describe(100);
        assert!(text.contains("+5.000") && text.contains("OUTSIDE"), "{text}");
        assert!(text.contains("-1.000") && text.contains("within"), "{text}");
    }

    #[test]
    fn a_score_that_only_one_side_has_is_outside() {
        let mut summary = summary();
        let expected = Expected::from_summary(&summary, 0.02);
        summary.methods["filter"].values.shift_remove("bias_rmse");
        summary.methods["free"].values.insert("bias_rmse".into(), 1.0);
        let regression = Regression::new(&expected, &summary);
        assert_eq!(regression.outside(), 2);
        assert!(regression.describe(100).contains("missing") && regression.describe(100).contains("not accepted yet"));
        let nothing = Regression::new(&Expected { relative_tolerance: 0.02, methods: Default::default() }, &summary);
        assert!(!nothing.passed());
    }

    #[test]
    fn accepted_scores_are_written_kind_by_kind() {
        let text = Expected::from_summary(&summary(), 0.02).to_toml();
        let of_free = "[expected.free]\nrmse_background = { h = 19.25 }\nrmse_analysis = { h = 19.25, u = 4.0 }\n";
        assert!(text.contains(of_free) && text.ends_with("\nbias_rmse = 0.77\n"), "{text}");
    }
}
