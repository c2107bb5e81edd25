//! The list of all scores. Files, tables, figures, `regress`, `compare`, `--seeds` and `sweep` go over it: a score is added
//! by an entry here, and a function in [`super::measures`] unless one of those serves.

use super::against::Against;
use super::forecast;
use super::measures::{
    Stage, Sum, Verified, bias_error, bias_spread, chi2, departures, error, passive_departures, spread,
};
use crate::scores::diagnostics::StateDiagnostics;

/// A kind of score.
#[derive(Debug)]
pub struct ScoreKind {
    /// Its name in files: `rmse_analysis`.
    pub name: &'static str,
    /// Its name in tables, beside that of the variable if it has one: `analysis`.
    pub title: &'static str,
    /// What it is, as the caption of a figure.
    pub about: &'static str,
    /// Whether it is of each variable of the state, or of the method as a whole.
    pub per_variable: bool,
    /// The unit of its values.
    pub unit: Unit,
    /// Which values are good.
    pub better: Better,
    /// With what estimates are compared.
    pub against: Against,
    /// The part of tables and files to which it belongs.
    pub part: Part,
    /// Whether it has a column in the tables of a run and of several seeds; files hold it in any case.
    pub tabulated: bool,
    /// Whether `[expected]` holds it, and `regress` compares it.
    pub regressed: bool,
    /// Whether `compare` pairs it cycle by cycle, and the page over seeds draws it.
    pub compared: bool,
    /// Whether it has a column in the tables of a sweep.
    pub swept: bool,
    /// How it is drawn over time; `None`: not at all.
    pub line: Option<Line>,
    /// How it is found.
    pub measure: Measure,
}

/// The unit of a score.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// That of the variable.
    Variable,
    /// That of each bias parameter: errors in different units are averaged as they are.
    Parameters,
    /// None.
    One,
    /// Seconds per cycle.
    SecondsPerCycle,
    /// Bytes; tables show megabytes.
    Bytes,
}

/// Which values of a score are good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// Less is better: an error, or a cost.
    Less,
    /// A claim: it should be as large as the error.
    AsTheError,
    /// It should be 1.
    One,
}

/// The part of tables and files to which a score belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The state before the analysis.
    Background,
    /// The state after it.
    Analysis,
    /// The biases, and whether the innovations are as the method claims.
    Biases,
    /// State and biases once later observations have revised them.
    Smoothed,
    /// Forecasts ahead, at their longest lead time.
    Forecast,
    /// Time and memory.
    Cost,
}

/// The line of a score that is drawn over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Line {
    /// For errors.
    Solid,
    /// For claims.
    Dashed,
    /// For errors of smoothed estimates.
    Dotted,
}

/// How a score is found.
#[derive(Clone, Copy, Debug)]
pub enum Measure {
    /// The root of a mean of squares over cycles. One sum for each variable, or one alone.
    RootMean(fn(&Verified<'_>) -> Option<Vec<Sum>>),
    /// A mean over cycles.
    Mean(fn(&Verified<'_>) -> Option<Vec<Sum>>),
    /// From the diagnostics of a variable over the run.
    Diagnostics(fn(&StateDiagnostics) -> f64),
    /// The score of this name of forecasts ahead at their longest lead time.
    LongestLead(&'static str),
    /// The Brier score of warnings over all lead times after the analysis, averaged over the warnings.
    Warnings,
    /// From the clock or the memory of the computer; the loop over cycles knows it.
    Cost,
}

/// The name of the time among the scores.
pub const SECONDS: &str = "seconds_per_cycle";

/// The name of the memory among the scores.
pub const MEMORY: &str = "peak_memory_bytes";

/// The name of the score of warnings.
pub const BRIER: &str = "brier_score";

/// Root-mean-square error of the state.
const ERROR: ScoreKind = ScoreKind {
    name: "",
    title: "",
    about: "",
    per_variable: true,
    unit: Unit::Variable,
    better: Better::Less,
    against: Against::Truth,
    part: Part::Analysis,
    tabulated: true,
    regressed: true,
    compared: false,
    swept: false,
    line: Some(Line::Solid),
    measure: Measure::Cost,
};

/// Root-mean-square claimed standard deviation of the state.
const SPREAD: ScoreKind = ScoreKind {
    better: Better::AsTheError,
    against: Against::Nothing,
    line: Some(Line::Dashed),
    title: "spread",
    ..ERROR
};

/// Error of forecasts ahead.
const FORECAST: ScoreKind = ScoreKind { part: Part::Forecast, tabulated: false, swept: true, line: None, ..ERROR };

/// Root-mean-square departure of observations.
const DEPARTURE: ScoreKind = ScoreKind { against: Against::Used, ..ERROR };

/// A single score of the biases.
const BIAS: ScoreKind =
    ScoreKind { per_variable: false, unit: Unit::Parameters, part: Part::Biases, line: None, ..ERROR };

/// Time or memory.
const COST: ScoreKind = ScoreKind { part: Part::Cost, against: Against::Nothing, regressed: false, ..BIAS };

/// All scores, in the order of files and tables.
pub const SCORES: &[ScoreKind] = &[
    ScoreKind {
        name: "rmse_background",
        title: "background",
        about: "Root-mean-square error of the background.",
        part: Part::Background,
        measure: Measure::RootMean(|it| error(it, it.background)),
        ..ERROR
    },
    ScoreKind {
        name: "rmse_analysis",
        title: "analysis",
        about: "Root-mean-square error of the analysis.",
        compared: true,
        swept: true,
        measure: Measure::RootMean(|it| error(it, it.analysis)),
        ..ERROR
    },
    ScoreKind {
        name: "departure_background",
        title: "O−B",
        about: "Root-mean-square departure of the observations from the background.",
        part: Part::Background,
        compared: true,
        swept: true,
        measure: Measure::RootMean(|it| departures(it, Stage::Background)),
        ..DEPARTURE
    },
    ScoreKind {
        name: "departure_analysis",
        title: "O−A",
        about: "Root-mean-square departure of the observations from the analysis that has used them.",
        measure: Measure::RootMean(|it| departures(it, Stage::Analysis)),
        ..DEPARTURE
    },
    ScoreKind {
        name: "passive_departure_background",
        title: "O−B passive",
        about: "Root-mean-square departure of passive observations from the background.",
        against: Against::Passive,
        part: Part::Background,
        line: None,
        measure: Measure::RootMean(|it| passive_departures(it, Stage::Background)),
        ..DEPARTURE
    },
    ScoreKind {
        name: "passive_departure_analysis",
        title: "O−A passive",
        about: "Root-mean-square departure of passive observations from the analysis, which has not used them.",
        against: Against::Passive,
        compared: true,
        swept: true,
        line: Some(Line::Dotted),
        measure: Measure::RootMean(|it| passive_departures(it, Stage::Analysis)),
        ..DEPARTURE
    },
    ScoreKind {
        name: "spread_background",
        about: "Root-mean-square claimed standard deviation of the background.",
        part: Part::Background,
        tabulated: false,
        regressed: false,
        measure: Measure::RootMean(|it| spread(it, it.background)),
        ..SPREAD
    },
    ScoreKind {
        name: "spread_analysis",
        about: "Root-mean-square claimed standard deviation of the analysis.",
        measure: Measure::RootMean(|it| spread(it, it.analysis)),
        ..SPREAD
    },
    ScoreKind {
        name: "crps",
        title: "CRPS",
        about: "Continuous ranked probability score of the analysis as a normal distribution.",
        tabulated: false,
        regressed: false,
        swept: true,
        line: None,
        measure: Measure::Diagnostics(|it| it.crps),
        ..ERROR
    },
    ScoreKind {
        name: "rmse_forecast",
        title: "forecast",
        about: "Root-mean-square error of forecasts ahead at their longest lead time.",
        measure: Measure::LongestLead(forecast::RMSE),
        ..FORECAST
    },
    ScoreKind {
        name: "departure_forecast",
        title: "O−forecast",
        about: "Root-mean-square departure of observations, passive ones if there are any, from forecasts ahead at their \
                longest lead time.",
        against: Against::Used,
        measure: Measure::LongestLead(forecast::DEPARTURE),
        ..FORECAST
    },
    ScoreKind {
        name: "spread_forecast",
        about: "Root-mean-square claimed standard deviation of forecasts ahead at their longest lead time.",
        part: Part::Forecast,
        tabulated: false,
        line: None,
        measure: Measure::LongestLead(forecast::SPREAD),
        ..SPREAD
    },
    ScoreKind {
        name: BRIER,
        title: "Brier",
        about: "Brier score of warnings over all lead times after the analysis, averaged over the warnings.",
        per_variable: false,
        unit: Unit::One,
        against: Against::Nothing,
        tabulated: true,
        measure: Measure::Warnings,
        ..FORECAST
    },
    ScoreKind {
        name: "rmse_smoothed",
        title: "smoothed",
        about: "Root-mean-square error of the estimate that later observations have revised.",
        part: Part::Smoothed,
        line: Some(Line::Dotted),
        measure: Measure::RootMean(|it| error(it, it.smoothed)),
        ..ERROR
    },
    ScoreKind {
        name: "spread_smoothed",
        about: "Root-mean-square claimed standard deviation of the estimate that later observations have revised.",
        part: Part::Smoothed,
        line: None,
        measure: Measure::RootMean(|it| spread(it, it.smoothed)),
        ..SPREAD
    },
    ScoreKind {
        name: "bias_rmse",
        title: "bias RMSE",
        about: "Root-mean-square error of the bias parameters whose truth is known, each in its own unit.",
        compared: true,
        swept: true,
        measure: Measure::RootMean(|it| bias_error(it, it.analysis)),
        ..BIAS
    },
    ScoreKind {
        name: "bias_spread",
        title: "bias spread",
        about: "Root-mean-square claimed standard deviation of the same bias parameters, of all where no truth is known.",
        better: Better::AsTheError,
        against: Against::Nothing,
        measure: Measure::RootMean(|it| bias_spread(it, it.analysis)),
        ..BIAS
    },
    ScoreKind {
        name: "innovation_chi2",
        title: "χ²/n",
        about: "Normalised innovation squared per observation: 1 if the claimed covariances are right.",
        unit: Unit::One,
        better: Better::One,
        against: Against::Nothing,
        swept: true,
        line: Some(Line::Solid),
        measure: Measure::Mean(chi2),
        ..BIAS
    },
    ScoreKind {
        name: "correction_chi2",
        title: "corrections",
        about: "Mean square of (estimate − truth)/σ of the corrections of the model that are estimated: 1 if their claimed \
                uncertainty is right.",
        unit: Unit::One,
        better: Better::One,
        regressed: false,
        measure: Measure::Mean(|it| it.corrections.map(|sum| vec![sum])),
        ..BIAS
    },
    ScoreKind {
        name: "bias_rmse_smoothed",
        title: "bias RMSE",
        about: "Root-mean-square error of the bias parameters that later observations have revised.",
        part: Part::Smoothed,
        measure: Measure::RootMean(|it| bias_error(it, it.smoothed)),
        ..BIAS
    },
    ScoreKind {
        name: "bias_spread_smoothed",
        title: "bias spread",
        about: "Root-mean-square claimed standard deviation of the bias parameters that later observations have revised.",
        part: Part::Smoothed,
        better: Better::AsTheError,
        against: Against::Nothing,
        measure: Measure::RootMean(|it| bias_spread(it, it.smoothed)),
        ..BIAS
    },
    ScoreKind {
        name: SECONDS,
        title: "time",
        about: "Wall-clock seconds per cycle, forecast and analysis.",
        unit: Unit::SecondsPerCycle,
        ..COST
    },
    ScoreKind {
        name: MEMORY,
        title: "memory",
        about: "The most memory that the method held at one time; unknown if other runs went on in the same process.",
        unit: Unit::Bytes,
        ..COST
    },
];

/// The kind of this name; `None` if there is no such score.
pub fn kind(name: &str) -> Option<&'static ScoreKind> {
    SCORES.iter().find(|kind| kind.name == name)
}

/// The kind of the score with this key in [`super::Values`].
pub fn kind_of(key: &str) -> Option<&'static ScoreKind> {
    kind(key.split('.').next().unwrap_or_default())
}

impl ScoreKind {
    /// The key of its value in [`super::Values`], for a variable if it has one of each.
    pub fn key(&self, variable: &str) -> String {
        if self.per_variable { format!("{}.{variable}", self.name) } else { self.name.to_string() }
    }

    /// What it measures, before "of" and a variable: for titles of figures and tables.
    pub fn measured(&self) -> &'static str {
        match self.against {
            Against::Truth => "analysis RMSE",
            Against::Used => "departure from the background",
            Against::Passive => "departure of passive observations from the analysis",
            Against::Nothing => self.title,
        }
    }

    /// Whether every cycle has a value of it, as `scores.csv` holds them.
    pub fn is_of_cycles(&self) -> bool {
        matches!(self.measure, Measure::RootMean(_) | Measure::Mean(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn names_are_unique_and_keys_lead_back_to_their_kinds() {
        let names: HashSet<&str> = SCORES.iter().map(|kind| kind.name).collect();
        assert_eq!(names.len(), SCORES.len());
        for kind in SCORES {
            let key = kind.key("h");
            assert!(super::kind(key.split('.').next().unwrap()).is_some_and(|found| found.name == kind.name), "{key}");
            assert!(!kind.title.is_empty() && kind.about.ends_with('.'), "{key}");
        }
    }
}
