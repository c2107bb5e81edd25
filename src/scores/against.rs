//! With what a score compares estimates.

/// With what a score compares estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Against {
    /// The truth, in the worlds that have one.
    Truth,
    /// The observations that are used, where there is no truth.
    Used,
    /// Passive observations, which are independent of the estimates.
    Passive,
    /// Nothing: what a method says of itself, or costs.
    Nothing,
}

impl Against {
    /// Whether there are such scores in a world with or without a truth and passive observations.
    pub fn exists(self, has_truth: bool, has_passive: bool) -> bool {
        match self {
            Against::Truth => has_truth,
            Against::Used => !has_truth,
            Against::Passive => has_passive,
            Against::Nothing => true,
        }
    }
}
