//! Why a run ends early.

use super::divided::Undivided;
use super::experiment::ExperimentError;
use super::truth::TruthError;
use crate::output::SinkError;
use crate::text::shown_path;
use isobar_model::communicator::RankFailure;
use std::io;
use std::path::PathBuf;

/// Why a run ended early.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The scenario cannot become an experiment.
    #[error(transparent)]
    Experiment(ExperimentError),
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
    /// Methods that ranks cannot compute together.
    #[error(transparent)]
    Undivided(#[from] Undivided),
    /// Something failed on a rank of the run.
    #[error("rank {}: {}", .0.rank, .0.reason)]
    Rank(#[from] RankFailure),
    /// A rank has come to other results than rank 0.
    #[error(
        "after cycle {cycle} rank {rank} has other results than rank 0: all must have processors of one kind, and the same libraries"
    )]
    Disagreement {
        /// The last cycle that all have done.
        cycle: usize,
        /// The rank.
        rank: usize,
    },
    /// A method panicked on a rank of the run, while the others wait for it.
    #[error("cycle {cycle}, method {method}: {fault}")]
    Panic {
        /// The cycle.
        cycle: usize,
        /// The method's name.
        method: String,
        /// What it says.
        fault: String,
    },
    /// The memory of a method of which rank 0 writes a checkpoint or the final state.
    #[error("a method cannot be saved: {0}")]
    Unsaved(io::Error),
}

impl From<ExperimentError> for RunError {
    fn from(error: ExperimentError) -> Self {
        match error {
            ExperimentError::Rank(failure) => Self::Rank(failure),
            error => Self::Experiment(error),
        }
    }
}

impl RunError {
    /// Whether the checkpoint from which the run was to go on cannot be used.
    pub fn cannot_resume(&self) -> bool {
        matches!(self, Self::Resume { .. })
    }

    /// Whether it may have ended one rank of the run alone, for which the others wait.
    pub fn is_of_one_rank(&self) -> bool {
        match self {
            Self::Sink(_) | Self::Panic { .. } | Self::Unsaved(_) => true,
            Self::Truth { error, .. } => matches!(error, TruthError::Series(_)),
            _ => false,
        }
    }

    /// Whether the same run could be completed another time: it failed for want of space, threads or the like, and not for
    /// what it computes.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Interrupted { .. } | Self::Resume { .. } | Self::Place(_) | Self::Sink(_) | Self::Threads(_) => true,
            Self::Rank(_) | Self::Disagreement { .. } => true,
            Self::Experiment(error) => matches!(error, ExperimentError::Sensors(_)),
            Self::Truth { .. } | Self::Earlier { .. } => false,
            Self::Undivided(_) | Self::Panic { .. } | Self::Unsaved(_) => false,
        }
    }
}
