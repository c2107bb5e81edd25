//! Scores: what is measured of a method once estimates meet the truth or observations, and what becomes of it over a run.
//!
//! | module | what it holds |
//! |---|---|
//! | [`against`] | with what a score compares estimates |
//! | [`kinds`] | the list of all scores, over which every file, table and figure goes |
//! | [`measures`] | what is measured in one cycle; the only place where truth and estimate meet |
//! | [`scorecard`] | the measures of a run, and their averages |
//! | [`forecast`] | the errors of forecasts ahead, by lead time |
//! | [`warnings`] | how right the probabilities of warnings were |
//! | [`truths`] | the truth of this cycle and of earlier ones |
//! | [`diagnostics`] | beyond errors: claimed distributions, assumed covariances, worth of observations |
//! | [`stability`] | which bias estimates can be relied on, and what would help the others |
//! | [`statistics`] | how well an average is known, and whether two methods differ |
//! | [`summary`] | the scores of a run, as `summary.json` holds them |
//! | [`expected`] | the accepted scores of a scenario, and how a run compares with them |

pub mod against;
pub mod diagnostics;
pub mod expected;
pub mod forecast;
pub mod kinds;
pub mod measures;
mod score;
pub mod scorecard;
pub mod stability;
pub mod statistics;
pub mod summary;
pub mod truths;
pub mod warnings;

pub use against::Against;
pub use expected::{Expected, Regression};
pub use forecast::{ForecastScores, VerifiedBy};
pub use kinds::{Better, Line, Part, SCORES, ScoreKind, Unit, kind};
pub use score::Score;
pub use scorecard::{RunScores, Scorecard};
pub use summary::{Exchanged, Failure, MethodScores, ObservationCounts, RejectedObservation, Summary, TypeCounts};
pub use truths::{EarlierTruths, TrueValues};
pub use warnings::{Outlook, WarningCase, WarningScores};

use indexmap::IndexMap;

/// Scores by key: the name of the kind, and after a dot that of the variable where it has one: `rmse_analysis.h`,
/// `bias_rmse`. A score that a method does not have is absent.
pub type Values = IndexMap<String, f64>;

/// A figure for each variable, by name.
pub type PerVariable = IndexMap<String, f64>;
