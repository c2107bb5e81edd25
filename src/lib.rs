//! isobar: a 2-D data-assimilation testbed with Lange's Fast Kalman Filter.
//!
//! ```text
//! scenario ─► experiment ─► truth ─► observations ─► cycle { forecast ─► analyse } ─► verify ─► sinks
//! ```
//!
//! | module | what it does |
//! |---|---|
//! | [`scenario`] | reads and checks an experiment's file |
//! | [`kinds`] | what a scenario chooses by name: methods, models, initial states, covariances |
//! | [`experiment`] | builds model, truth, observing system and methods from it |
//! | [`options`] | what the user changes in a run |
//! | [`run`] | the loop over cycles: the true world, its observations, each method, the scores |
//! | [`outcome`] | the result of one cycle of one method |
//! | [`verify`] | the only place where truth and estimate meet |
//! | [`checkpoint`], [`interrupt`] | how a run is interrupted and resumed |
//! | [`event`], [`sink`] | the events of a run, and the files that they are written to |
//! | [`plot`] | curves and maps, as these files hold them |
//! | [`diagnostics`] | what a run shows beyond errors: claimed distributions, assumed covariances, worth of observations |
//! | [`sensors`] | what is known of each sensor, from run to run |
//! | [`stability`] | which bias estimates can be relied on, and what would help the others |
//! | [`statistics`] | how well a score is known |
//! | [`mod@exact`] | the exact performance of linear methods in a linear world |
//! | [`seeds`], [`sweep`] | the same experiment over several seeds, and over several settings |
//! | [`saved`], [`comparison`] | complete runs, read back and compared |
//! | [`cli`], [`progress`], [`table`] | the command line |
//! | [`calendar`], [`memory`] | times as text, and how much memory work takes |

pub mod calendar;
pub mod checkpoint;
pub mod cli;
pub mod comparison;
pub mod correlations;
pub mod diagnostics;
pub mod event;
pub mod exact;
pub mod experiment;
pub mod interrupt;
pub mod kinds;
pub mod memory;
pub mod options;
pub mod outcome;
pub mod plot;
pub mod progress;
mod reader;
pub mod run;
pub mod saved;
pub mod scenario;
pub mod seeds;
pub mod sensors;
pub mod sink;
pub mod smoothed;
pub mod stability;
pub mod statistics;
pub mod summary;
pub mod sweep;
pub mod table;
mod text;
pub mod verify;

/// The version, as files say it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
