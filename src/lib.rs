//! isobar: a 2-D data-assimilation testbed with Lange's Fast Kalman Filter.
//!
//! ```text
//! scenario ─► experiment ─► truth ─► observations ─► cycle { forecast ─► analyse } ─► scores ─► sinks
//! ```
//!
//! | module | what it does |
//! |---|---|
//! | [`scenario`] | reads and checks an experiment's file |
//! | [`shipped`] | the scenarios that are inside the program |
//! | [`kinds`] | what a scenario chooses by name: methods, models, initial states, covariances |
//! | [`mod@reference`] | the reference of all keys of a scenario |
//! | [`lead_times`] | when forecasts ahead start, and how far they go |
//! | [`threshold_warning`] | values beyond a threshold, and how probable a forecast makes them |
//! | [`options`] | what the user changes in a run |
//! | [`run`] | builds an experiment and runs it: the true world, its observations, each method, the scores; checkpoints |
//! | [`outcome`] | the result of one cycle of one method |
//! | [`readings`] | observations without the biases that a method has found in them |
//! | [`scores`] | the list of all scores; the only place where truth and estimate meet |
//! | [`interrupt`] | how a signal ends a run |
//! | [`event`], [`output`] | the events of a run, the files that they are written to, and runs read back from them |
//! | [`verdict`] | whether a bias has a stable update |
//! | [`tables`] | tables of scores, for terminal, page and viewer |
//! | [`plot`] | curves and maps, as these files hold them |
//! | [`sensors`] | what is known of each sensor, from run to run |
//! | [`soundings`] | winds from the readings of sensors that track a balloon |
//! | [`mod@exact`] | the exact performance of linear methods in a linear world |
//! | [`batch`] | the same experiment over several seeds, and over several settings |
//! | [`advice`] | what to observe next |
//! | [`comparison`] | complete runs compared |
//! | [`cli`], [`progress`] | the command line |
//! | [`calendar`], [`memory`] | times as text, and how much memory work takes |

pub mod advice;
pub mod batch;
pub mod calendar;
pub mod cli;
pub mod comparison;
pub mod correlations;
pub mod event;
pub mod exact;
pub mod interrupt;
pub mod kinds;
pub mod lead_times;
pub mod memory;
pub mod options;
pub mod outcome;
pub mod output;
mod place;
pub mod plot;
pub mod progress;
mod ranks;
mod reader;
pub mod readings;
pub mod reference;
pub mod run;
mod safe_file;
pub mod scenario;
pub mod scores;
mod sealed;
pub mod sensors;
mod shell;
pub mod shipped;
pub mod soundings;
pub mod tables;
mod text;
pub mod threshold_warning;
pub mod verdict;

/// The version, as files say it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
