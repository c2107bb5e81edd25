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
//! | [`truth`] | the true world |
//! | [`mod@reference`] | what quality control compares observations with |
//! | [`cycle`] | one cycle of one method |
//! | [`monitor`] | whether its result can be believed in |
//! | [`verify`] | the only place where truth and estimate meet |
//! | [`run`] | the loop over cycles |
//! | [`checkpoint`], [`interrupt`] | how a run ends before its time, and goes on |
//! | [`event`], [`sink`] | what happens, and the files that it is written to |
//! | [`plot`] | curves and maps, as these files hold them |
//! | [`diagnostics`] | what it tells beyond errors: claimed distributions, assumed covariances, worth of observations |
//! | [`sensors`] | what is known of each sensor, from run to run |
//! | [`stability`] | which bias estimates can be relied on, and what would help the others |
//! | [`units`] | whether observations can be in their unit |
//! | [`statistics`] | how well a score is known |
//! | [`mod@exact`] | the exact performance of linear methods in a linear world |
//! | [`seeds`], [`sweep`] | the same experiment over several seeds, and over several settings |
//! | [`saved`], [`comparison`] | complete runs, read back and compared |
//! | [`cli`], [`progress`], [`table`] | the command line |

pub mod checkpoint;
pub mod cli;
pub mod comparison;
pub mod correlations;
pub mod cycle;
pub mod diagnostics;
pub mod event;
pub mod exact;
pub mod experiment;
pub mod interrupt;
pub mod kinds;
pub mod monitor;
pub mod plot;
pub mod progress;
mod reader;
pub mod reference;
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
pub mod truth;
pub mod units;
pub mod verify;

/// The version, as files say it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
