//! Where and when an instrument is to observe.

use crate::bias::BiasProcess;
use crate::biases::Biases;
use crate::calibration::Placement;
use crate::error::ObservationError;
use crate::projection::Projection;
use crate::report::Report;
use isobar_model::{Duration, Layout, Time, random};
use rand_chacha::ChaCha8Rng;

/// Where and when an instrument is to observe, and the biases of all instruments so far.
pub struct Site<'a> {
    /// Name of the network: in messages, in reports, and the first part of the names of parameters and random streams.
    pub network: &'a str,
    /// Grid and variables.
    pub layout: &'a Layout,
    /// The plane's place on the Earth, if it has one.
    pub projection: Option<&'a Projection>,
    /// The seed of all random streams.
    pub seed: u64,
    /// Length of a cycle.
    pub window: Duration,
    /// Cycle n ends `n × window` after this time.
    pub start: Time,
    pub(crate) biases: &'a mut Biases,
}

impl Site<'_> {
    /// The network's random stream for a `purpose`: `observations/europe`.
    pub fn stream(&self, purpose: &str) -> ChaCha8Rng {
        random::stream(self.seed, &format!("{purpose}/{}", self.network))
    }

    /// The report of a platform on a variable of this number, at a point of the plane.
    pub fn report(&self, platform: &str, variable: usize, x_m: f64, y_m: f64) -> Report {
        Report { network: self.network.into(), platform: platform.into(), variable, x_m, y_m, scan: None }
    }

    /// Adds the bias parameter `network/name`; its number in the calibration, or `None` if it is known and methods need
    /// not estimate it.
    ///
    /// # Errors
    /// Numbers of the process that are not what they must be; a name that exists already.
    pub fn add_bias(
        &mut self,
        name: &str,
        unit: &str,
        placement: Placement,
        process: &BiasProcess,
    ) -> Result<Option<usize>, ObservationError> {
        self.biases.add(self.network, format!("{}/{name}", self.network), unit, placement, process)
    }

    /// Adds the bias parameter `network/name` of observations that were made elsewhere; its number in the calibration.
    ///
    /// # Errors
    /// As [`Site::add_bias`].
    pub fn add_recorded_bias(
        &mut self,
        name: &str,
        unit: &str,
        placement: Placement,
        process: &BiasProcess,
    ) -> Result<usize, ObservationError> {
        self.biases.add_recorded(self.network, format!("{}/{name}", self.network), unit, placement, process)
    }
}
