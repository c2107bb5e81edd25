//! The arguments that name a method in the state in which a run ended.

use clap::Args;
use std::ffi::OsString;
use std::path::PathBuf;

/// A method at the end of a run.
#[derive(Args, Debug)]
pub struct FinalStateArguments {
    /// The run's scenario file, or its name; or one that goes on from the run
    #[arg(value_name = "SCENARIO")]
    pub scenario: OsString,
    /// Directory of the run, with its final state
    #[arg(long, value_name = "OUT")]
    pub from: PathBuf,
    /// The method whose covariance is used
    #[arg(long, value_name = "NAME")]
    pub method: String,
}
