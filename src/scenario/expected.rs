//! `[expected]`: the scores that a run of the scenario had when they were last accepted.

use super::method::Method;
use super::model::ModelSettings;
use crate::reader::{Limits, Read, Section};
use crate::summary::{MethodScores, PerVariable, Summary};
use indexmap::IndexMap;
use std::fmt::Write;

/// The key of the tolerance in `[expected]`.
pub(super) const TOLERANCE_KEY: &str = "relative_tolerance";

/// The tolerance of a scenario that gives none.
const DEFAULT_TOLERANCE: f64 = 1e-4;

/// Accepted scores.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// How far a score may be from the accepted one, relative to it.
    pub relative_tolerance: f64,
    /// Scores by method.
    pub methods: IndexMap<String, ExpectedScores>,
}

/// The accepted scores of one method; their meaning is that in [`MethodScores`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExpectedScores {
    /// Root-mean-square error of the background, per variable.
    pub rmse_background: PerVariable,
    /// Root-mean-square error of the analysis, per variable.
    pub rmse_analysis: PerVariable,
    /// Root-mean-square claimed standard deviation of the analysis; empty for a method without one.
    pub spread_analysis: PerVariable,
    /// Root-mean-square error of the bias parameters.
    pub bias_rmse: Option<f64>,
    /// Root-mean-square claimed standard deviation of the bias parameters.
    pub bias_spread: Option<f64>,
    /// Normalised innovation squared per observation.
    pub innovation_chi2: Option<f64>,
    /// Root-mean-square error of the smoothed estimates; empty for a method without a smoother, as what follows.
    pub rmse_smoothed: PerVariable,
    /// Root-mean-square claimed standard deviation of the smoothed estimates.
    pub spread_smoothed: PerVariable,
    /// Root-mean-square error of the bias parameters as they are smoothed.
    pub bias_rmse_smoothed: Option<f64>,
    /// Root-mean-square claimed standard deviation of the bias parameters as they are smoothed.
    pub bias_spread_smoothed: Option<f64>,
}

const PER_VARIABLE: [&str; 5] =
    ["rmse_background", "rmse_analysis", "spread_analysis", "rmse_smoothed", "spread_smoothed"];
const SINGLE: [&str; 5] = ["bias_rmse", "bias_spread", "innovation_chi2", "bias_rmse_smoothed", "bias_spread_smoothed"];

impl ExpectedScores {
    /// All scores by dotted name, `rmse_analysis.h`.
    pub fn entries(&self) -> IndexMap<String, f64> {
        let tables = PER_VARIABLE.iter().zip(self.tables());
        let named =
            tables.flat_map(|(name, table)| table.iter().map(move |(key, &score)| (format!("{name}.{key}"), score)));
        let single = SINGLE.iter().zip(self.single());
        named.chain(single.filter_map(|(name, score)| Some((name.to_string(), score?)))).collect()
    }

    /// In the order of [`PER_VARIABLE`].
    fn tables(&self) -> [&PerVariable; 5] {
        let smoothed = [&self.rmse_smoothed, &self.spread_smoothed];
        [&self.rmse_background, &self.rmse_analysis, &self.spread_analysis, smoothed[0], smoothed[1]]
    }

    /// In the order of [`SINGLE`].
    fn single(&self) -> [Option<f64>; 5] {
        [self.bias_rmse, self.bias_spread, self.innovation_chi2, self.bias_rmse_smoothed, self.bias_spread_smoothed]
    }
}

impl From<&MethodScores> for ExpectedScores {
    fn from(scores: &MethodScores) -> Self {
        let smoothed = scores.smoothed.clone().unwrap_or_default();
        Self {
            rmse_background: scores.rmse_background.clone(),
            rmse_analysis: scores.rmse_analysis.clone(),
            spread_analysis: scores.spread_analysis.clone().unwrap_or_default(),
            bias_rmse: scores.bias_rmse,
            bias_spread: scores.bias_spread,
            innovation_chi2: scores.innovation_chi2,
            rmse_smoothed: smoothed.rmse,
            spread_smoothed: smoothed.spread.unwrap_or_default(),
            bias_rmse_smoothed: smoothed.bias_rmse,
            bias_spread_smoothed: smoothed.bias_spread,
        }
    }
}

impl Expected {
    /// The scores of a run, to be accepted with the tolerance that stands.
    pub fn from_summary(summary: &Summary, relative_tolerance: f64) -> Self {
        let methods = summary.methods.iter().map(|(name, scores)| (name.clone(), scores.into())).collect();
        Self { relative_tolerance, methods }
    }

    /// The section as a scenario holds it. Scores have five digits.
    pub fn to_toml(&self) -> String {
        let mut text = String::from("[expected]\n# Written by `isobar regress --accept`.\n");
        writeln!(text, "{TOLERANCE_KEY} = {}", self.relative_tolerance).expect("a String takes any text");
        for (method, scores) in &self.methods {
            write!(text, "\n[expected.{method}]\n").expect("a String takes any text");
            for (name, table) in PER_VARIABLE.iter().zip(scores.tables()).filter(|(_, table)| !table.is_empty()) {
                let entries: Vec<String> =
                    table.iter().map(|(key, &score)| format!("{key} = {}", digits(score))).collect();
                writeln!(text, "{name} = {{ {} }}", entries.join(", ")).expect("a String takes any text");
            }
            for (name, score) in SINGLE.iter().zip(scores.single()) {
                if let Some(score) = score {
                    writeln!(text, "{name} = {}", digits(score)).expect("a String takes any text");
                }
            }
        }
        text
    }
}

/// A number of five significant digits, as TOML writes it.
fn digits(score: f64) -> String {
    let rounded: f64 = format!("{score:.4e}").parse().unwrap_or(score);
    format!("{rounded:?}")
}

/// Reads `[expected]`.
pub(super) fn read(root: &Section<'_>, methods: &IndexMap<String, Method>, model: &ModelSettings) -> Read<Expected> {
    let mut expected = Expected { relative_tolerance: DEFAULT_TOLERANCE, methods: IndexMap::new() };
    let Some(field) = root.optional("expected") else { return Ok(expected) };
    let keys: Vec<&str> = std::iter::once(TOLERANCE_KEY).chain(methods.keys().map(String::as_str)).collect();
    let section = field.section(&keys)?;
    let variables: Vec<&str> = model.variables().iter().map(|variable| variable.0).collect();
    for (name, field) in section.fields() {
        if name == TOLERANCE_KEY {
            expected.relative_tolerance = field.number(Limits::Between(1e-12, 1.0))?;
            continue;
        }
        let section = field.section(&[&PER_VARIABLE[..], &SINGLE].concat())?;
        let table = |key: &str| -> Read<PerVariable> {
            let Some(field) = section.optional(key) else { return Ok(PerVariable::new()) };
            let scores = field.section(&variables)?;
            scores.fields().map(|(name, field)| Ok((name.to_string(), field.number(Limits::NonNegative)?))).collect()
        };
        let single = |key: &str| section.optional(key).map(|field| field.number(Limits::NonNegative)).transpose();
        let scores = ExpectedScores {
            rmse_background: table("rmse_background")?,
            rmse_analysis: table("rmse_analysis")?,
            spread_analysis: table("spread_analysis")?,
            bias_rmse: single("bias_rmse")?,
            bias_spread: single("bias_spread")?,
            innovation_chi2: single("innovation_chi2")?,
            rmse_smoothed: table("rmse_smoothed")?,
            spread_smoothed: table("spread_smoothed")?,
            bias_rmse_smoothed: single("bias_rmse_smoothed")?,
            bias_spread_smoothed: single("bias_spread_smoothed")?,
        };
        expected.methods.insert(name.to_string(), scores);
    }
    Ok(expected)
}
