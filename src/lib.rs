//! isobar: a 2-D data-assimilation testbed with Lange's Fast Kalman Filter.
//!
//! ```text
//! scenario ─► experiment ─► truth ─► observations ─► cycle { forecast ─► analyse } ─► scores ─► sinks
//! ```
//!
//! | module | what it does |
//! |---|---|
//! | [`scenario`] | reads and checks an experiment's file |
//! | [`experiment`] | builds model, truth, observing system and methods from it |
//! | [`truth`] | the true world |
//! | [`mod@reference`] | what quality control compares observations with |
//! | [`cycle`] | one cycle of one method |
//! | [`monitor`] | whether its result can be believed in |
//! | [`scores`] | the only place where truth and estimate meet; the list of all scores, and what they come to |
//! | [`run`] | the loop over cycles |
//! | [`checkpoint`], [`interrupt`] | how a run ends before its time, and goes on |
//! | [`event`], [`sink`] | what happens, and the files that it is written to |
//! | [`plot`] | curves and maps, as these files hold them |
//! | [`sensors`] | what is known of each sensor, from run to run |
//! | [`mod@exact`] | the exact performance of linear methods in a linear world |
//! | [`seeds`], [`sweep`] | the same experiment over several seeds, and over several settings |
//! | [`saved`], [`comparison`] | complete runs, read back and compared |
//! | [`tables`] | tables of all this, for terminal, page and viewer |
//! | [`cli`], [`progress`] | the command line |

pub mod checkpoint;
pub mod cli;
pub mod comparison;
pub mod correlations;
pub mod cycle;
pub mod event;
pub mod exact;
pub mod experiment;
pub mod interrupt;
pub mod monitor;
pub mod plot;
pub mod progress;
pub mod reference;
pub mod run;
pub mod saved;
pub mod scenario;
pub mod scores;
pub mod seeds;
pub mod sensors;
pub mod sink;
pub mod sweep;
pub mod tables;
pub mod truth;

/// The version, as files say it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
