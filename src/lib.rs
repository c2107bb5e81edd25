//! isobar: a 2-D data-assimilation testbed with Lange's Fast Kalman Filter.
//!
//! ```text
//! scenario ─► experiment ─► truth ─► observations ─► cycle { forecast ─► analyse } ─► scores ─► sinks
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
//! | [`scores`] | the list of all scores; the only place where truth and estimate meet |
//! | [`checkpoint`], [`interrupt`] | how a run is interrupted and resumed |
//! | [`event`], [`sink`] | the events of a run, and the files that they are written to |
//! | [`tables`] | tables of scores, for terminal, page and viewer |
//! | [`plot`] | curves and maps, as these files hold them |
//! | [`sensors`] | what is known of each sensor, from run to run |
//! | [`mod@exact`] | the exact performance of linear methods in a linear world |
//! | [`seeds`], [`sweep`] | the same experiment over several seeds, and over several settings |
//! | [`saved`], [`comparison`] | complete runs, read back and compared |
//! | [`cli`], [`progress`] | the command line |
//! | [`calendar`], [`memory`] | times as text, and how much memory work takes |

pub mod calendar;
pub mod checkpoint;
pub mod cli;
pub mod comparison;
pub mod correlations;
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
pub mod scores;
pub mod seeds;
pub mod sensors;
pub mod sink;
pub mod sweep;
pub mod tables;
mod text;

/// The version, as files say it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
