//! What would tell how much.

use super::candidates::Candidate;
use isobar_model::Time;

/// The candidates, and what they would tell of.
#[derive(Clone, Debug)]
pub struct Advised {
    /// The functional, in words.
    pub functional: String,
    /// Its unit, in UDUNITS spelling.
    pub unit: String,
    /// The time of the observations.
    pub time: Time,
    /// The standard deviation of the functional without any of them.
    pub sigma: f64,
    /// The candidates, those that tell the most first.
    pub candidates: Vec<Candidate>,
    /// What there is to know of them.
    pub notes: Vec<String>,
}
