//! The earlier analyses of a smoother by common or local factors, as they are known now.

use crate::augmented::Augmented;
use crate::error::Error;
use crate::fixed_lag::PastAnalyses;
use crate::memory::require;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The estimates of the last analyses given all observations up to now; their rows Ψ of the factors are stored elsewhere.
#[derive(Clone, Serialize, Deserialize)]
pub(in crate::errors) struct FixedLag {
    pub lag: usize,
    /// The oldest first, at most `lag` and the last one.
    pub analyses: VecDeque<PastAnalysis>,
}

/// An earlier analysis, as it is known now.
#[derive(Clone, Serialize, Deserialize)]
pub(in crate::errors) struct PastAnalysis {
    /// ŝ given all observations so far.
    pub s: Augmented,
    /// The diagonal of its covariance, `[m + p]`.
    pub variances: Vec<f64>,
}

impl FixedLag {
    /// A smoother of the last `lag` analyses before the newest.
    pub fn new(lag: usize) -> Self {
        Self { lag, analyses: VecDeque::with_capacity(lag + 1) }
    }

    /// Drops the analyses that the next one will no longer revise; returns how many there were, all before the others.
    pub fn drop_past(&mut self) -> usize {
        let dropped = self.analyses.len().saturating_sub(self.lag);
        self.analyses.drain(..dropped);
        dropped
    }

    /// Fails unless it is a smoother of this lag, of estimates like `s` with `size` = m + p unknowns, with rows of the factors
    /// for `rows` analyses.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require(&self, lag: usize, s: &Augmented, size: usize, rows: usize) -> Result<(), Error> {
        let count = self.analyses.len();
        require(self.lag == lag && count <= lag + 1 && count == rows, "the number of earlier analyses")?;
        for past in &self.analyses {
            past.s.require_like(s)?;
            require(past.variances.len() == size, "an earlier analysis")?;
        }
        Ok(())
    }
}

impl PastAnalyses for FixedLag {
    fn lag(&self) -> usize {
        self.lag
    }

    fn estimate(&self, analyses_ago: usize) -> Option<(&Augmented, &[f64])> {
        let past = self.analyses.get(self.analyses.len().checked_sub(analyses_ago + 1)?)?;
        Some((&past.s, &past.variances))
    }
}
