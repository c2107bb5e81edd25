//! The result: ranked candidates.

use super::candidates::Candidate;
use isobar_model::Time;

/// The candidates, and the functional by which they are ranked.
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
    /// The candidates, those with the largest reduction of the variance first.
    pub candidates: Vec<Candidate>,
    /// Notes on them.
    pub notes: Vec<String>,
}
