//! What is kept of a batch of runs that was interrupted.

use super::destination::{RUNS_DEPTH, complete_runs};
use super::working::{checkpoints, of_runs};
use std::fmt::{self, Display, Formatter};
use std::path::Path;

/// Numbers of runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KeptRuns {
    /// Those that are complete.
    pub complete: usize,
    /// Those that have a checkpoint.
    pub begun: usize,
}

impl KeptRuns {
    /// Those in the directory of a batch's outputs.
    pub fn of(outputs: &Path) -> Self {
        // What cannot be read cannot be continued.
        let begun = of_runs(outputs, RUNS_DEPTH).unwrap_or_default();
        let begun = begun.iter().filter(|run| !checkpoints(run).is_empty()).count();
        Self { complete: complete_runs(outputs), begun }
    }

    /// Whether nothing is kept.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// In words: `3 complete runs and the first cycles of 2 others`.
impl Display for KeptRuns {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        match (self.complete, self.begun) {
            (complete, 0) => write!(formatter, "{complete} complete runs"),
            (0, begun) => write!(formatter, "the first cycles of {begun} runs"),
            (complete, begun) => write!(formatter, "{complete} complete runs and the first cycles of {begun} others"),
        }
    }
}
