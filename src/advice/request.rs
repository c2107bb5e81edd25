//! A request for advice.

use super::functional::Functional;
use indexmap::IndexMap;

/// A request for advice.
#[derive(Clone, Debug)]
pub struct Request {
    /// The method whose covariance is used.
    pub method: String,
    /// What is to be known better.
    pub functional: Functional,
    /// How long after the next analysis \[h\].
    pub lead_hours: f64,
    /// Numbers of places in x and y at which a new radiosonde is tried.
    pub grid: [usize; 2],
    /// Standard deviations of a new radiosonde's errors, by variable; empty: the least that a station reports with.
    pub sigmas: IndexMap<String, f64>,
    /// Standard deviation of a comparison of two sensors, and of a test point of one, in the sensors' unit.
    pub comparison_sigma: f64,
}
