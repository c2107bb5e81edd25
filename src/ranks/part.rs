//! What a process is to do, and what it computes with.

use crate::batch::JobError;
use crate::options::RunOptions;
use crate::output::Sink;
use crate::scenario::Scenario;
use crate::scores::Summary;

/// What computes a run in this process.
pub type Compute = fn(&Scenario, &RunOptions, &mut dyn Sink) -> Result<Summary, JobError>;

/// What this process is to do.
pub enum Part {
    /// To obey the command line.
    Command,
    /// Nothing more: it has computed what it was given, until there was nothing left.
    #[cfg(feature = "mpi")]
    Done,
}
