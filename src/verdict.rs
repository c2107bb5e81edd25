//! The verdict on a bias in a cycle.

use serde::{Deserialize, Serialize};

/// The verdict on a bias parameter in a cycle, by the rule of the verdict at the end: of what the observations so far leave of
/// the variance that it would have without them, which for an evolving parameter tends to its stationary variance, and of
/// its innovations so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Number of the parameter in the calibration.
    pub parameter: usize,
    /// Whether it has a stable update.
    pub stable: bool,
    /// Whether it is adjusted no more.
    pub frozen: bool,
    /// The share of its prior variance that it still has; of one that is frozen while it is unstable, that an update would leave.
    pub variance_ratio: f64,
    /// Why it is not stable; empty if it is.
    pub why: Vec<String>,
}

impl Verdict {
    /// The verdict, in words.
    pub fn in_words(&self) -> &'static str {
        in_words(self.stable, self.frozen)
    }
}

/// A verdict in words.
pub(crate) fn in_words(stable: bool, frozen: bool) -> &'static str {
    match (stable, frozen) {
        (true, false) => "stable, adjusted",
        (true, true) => "stable, but frozen",
        (false, true) => "not stable, frozen",
        (false, false) => "not stable, adjusted all the same",
    }
}
