//! Scores in the long form, for other programs: each with its unit, nothing rounded.

use crate::batch::seeds::SeedsSummary;
use crate::exact::ExactSummary;
use crate::scores::{Score, Summary, Values};
use serde::Serialize;

/// A score of a method.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScoreRow<'a> {
    /// The method.
    pub method: &'a str,
    /// The score's name, as in `summary.json`.
    pub score: &'static str,
    /// The variable; `None` for a score of the method as a whole.
    pub variable: Option<&'a str>,
    /// The unit of all values, in UDUNITS spelling.
    pub unit: &'a str,
    /// The score, or its mean over several seeds.
    pub value: f64,
    /// Lower end of its 95 % interval, if it has one.
    pub low: Option<f64>,
    /// Upper end of it.
    pub high: Option<f64>,
    /// Of several seeds: how it differs from that of the method with which the others are compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference: Option<DifferenceRow>,
}

/// A difference of two scores.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DifferenceRow {
    /// The difference.
    pub value: f64,
    /// Lower end of its 95 % interval, if it has one.
    pub low: Option<f64>,
    /// Upper end of it.
    pub high: Option<f64>,
    /// Whether it is significant at the level of 5 %; `None` if that is not known.
    pub significant: Option<bool>,
}

impl<'a> ScoreRow<'a> {
    fn new(method: &'a str, score: &Score<'a>, value: f64) -> Self {
        let variable = Some(score.variable.0).filter(|name| !name.is_empty());
        let (score, unit) = (score.kind.name, score.unit());
        Self { method, score, variable, unit, value, low: None, high: None, difference: None }
    }
}

/// All scores of a run, by method; `variables` are names and units.
pub fn of_run<'a>(summary: &'a Summary, variables: &[(&'a str, &'a str)]) -> Vec<ScoreRow<'a>> {
    let mut rows = Vec::new();
    for (method, scores) in &summary.methods {
        for score in Score::all(variables, |_| true) {
            let key = score.key();
            let Some(&value) = scores.values.get(&key) else { continue };
            let interval = scores.intervals.get(&key);
            let (low, high) = (interval.map(|it| it.low), interval.map(|it| it.high));
            rows.push(ScoreRow { low, high, ..ScoreRow::new(method, &score, value) });
        }
    }
    rows
}

/// All exact scores, by method.
pub fn of_exact<'a>(summary: &'a ExactSummary, variables: &[(&'a str, &'a str)]) -> Vec<ScoreRow<'a>> {
    let of_method = |(method, values): (&'a String, &'a Values)| {
        let row = |score: Score<'a>| values.get(&score.key()).map(|&value| ScoreRow::new(method, &score, value));
        Score::all(variables, |_| true).into_iter().filter_map(row).collect::<Vec<_>>()
    };
    summary.methods.iter().flat_map(of_method).collect()
}

/// All mean scores over seeds, by method.
pub fn of_seeds<'a>(summary: &'a SeedsSummary, variables: &[(&'a str, &'a str)]) -> Vec<ScoreRow<'a>> {
    let mut rows = Vec::new();
    for (method, scores) in &summary.methods {
        for score in Score::all(variables, |_| true) {
            let Some(own) = scores.get(&score.key()) else { continue };
            let (low, high) = (own.interval.map(|it| it.low), own.interval.map(|it| it.high));
            let difference = own.difference.map(|it| DifferenceRow {
                value: it.mean,
                low: it.interval.map(|it| it.low),
                high: it.interval.map(|it| it.high),
                significant: it.significant,
            });
            rows.push(ScoreRow { low, high, difference, ..ScoreRow::new(method, &score, own.mean) });
        }
    }
    rows
}
