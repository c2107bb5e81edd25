//! Sinks hear the events of a run and write files. None of them changes the run.
//!
//! Contents: [`directory`] (where outputs go, with [`working`], [`destination`], [`kept_runs`] and [`contents`]), [`OUTPUTS`] (the outputs that
//! can be switched off), [`netcdf`], [`forecasts`], [`parameters`], [`verdicts`] (both with `late_csv`), [`readings`], [`report`],
//! [`scores`], [`summary`], [`warnings`], and [`viewer_data`], of which an isobar with the cargo feature `rerun` makes the recording
//! for the rerun viewer. Report and recording show what [`history`] holds of the run and of the Earth (`earth`), with errors of biases (`bias_errors`), a method's
//! blocks ([`structure`]), what is known of its spread ([`reliability`]), and biases that depend on the scan position ([`scans`]).

mod bias_errors;
pub mod contents;
pub mod destination;
pub mod directory;
mod earth;
pub mod forecasts;
pub mod history;
pub mod kept_runs;
mod late_csv;
pub mod netcdf;
mod outputs;
pub mod parameters;
pub mod readings;
pub mod recorded;
pub mod reliability;
pub mod report;
#[cfg(feature = "rerun")]
pub mod rerun;
pub mod scans;
pub mod scores;
mod sink;
pub mod structure;
pub mod summary;
pub mod verdicts;
pub mod viewer_data;
pub mod warnings;
pub mod working;

pub use directory::{Existing, OutputDirectory};
pub use outputs::{OUTPUTS, Open, Output, Outputs, STATE, STATE_FILE, open_all};
pub use sink::{Sink, SinkError};
