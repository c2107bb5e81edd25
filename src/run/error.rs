//! Why a run ends early.

use super::experiment::ExperimentError;
use super::truth::TruthError;
use crate::output::SinkError;
use crate::text::shown_path;
use std::path::PathBuf;

/// Why a run ended early.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The scenario cannot become an experiment.
    #[error(transparent)]
    Experiment(#[from] ExperimentError),
    /// The truth cannot go on.
    #[error("cycle {cycle}, truth: {error}")]
    Truth {
        /// The cycle.
        cycle: usize,
        /// Why.
        error: TruthError,
    },
    /// A signal ended the run after a cycle.
    #[error("ended by a signal after cycle {cycle} of {cycles}")]
    Interrupted {
        /// The last complete cycle.
        cycle: usize,
        /// The run's number of cycles.
        cycles: usize,
    },
    /// The run cannot be resumed.
    #[error("{} cannot be resumed: {reason}", shown_path(directory))]
    Resume {
        /// The working directory.
        directory: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The run cannot go on from an earlier one.
    #[error("it cannot go on from {}: {reason}", shown_path(directory))]
    Earlier {
        /// The earlier run's directory.
        directory: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The output directory cannot be created or is in use.
    #[error(transparent)]
    Place(SinkError),
    /// An output could not be written.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// No threads could be started.
    #[error("cannot start the threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

impl RunError {
    /// Whether the checkpoint from which the run was to go on cannot be used.
    pub fn cannot_resume(&self) -> bool {
        matches!(self, Self::Resume { .. })
    }

    /// Whether the same run could be completed another time: it failed for want of space, threads or the like, and not for
    /// what it computes.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Interrupted { .. } | Self::Resume { .. } | Self::Place(_) | Self::Sink(_) | Self::Threads(_) => true,
            Self::Experiment(error) => matches!(error, ExperimentError::Sensors(_)),
            Self::Truth { .. } | Self::Earlier { .. } => false,
        }
    }
}
