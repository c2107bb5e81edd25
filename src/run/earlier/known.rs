//! What a run must know of those from which it goes on.

use isobar_assim::Recalibration;
use isobar_model::Time;
use isobar_obs::Calibration;
use serde::{Deserialize, Serialize};

/// What a run must know of those before it to be set up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Earlier {
    /// Valid time of the state before cycle 1.
    pub start: Time,
    /// The number of cycles that they have done.
    pub cycles: usize,
    /// What was known of the sensors at that start, where there is a database of them: it may know more by now.
    pub sensors: Option<(Calibration, Vec<Recalibration>)>,
    /// Checksum of the state in which they ended.
    pub checksum: u32,
}
