//! Instruments: what an observing system asks of each of them.

pub mod radiosonde;
pub mod recorded;
pub mod recorded_bias;
mod recorded_held;
mod recorded_names;
mod recorded_winds;
pub mod satellite;
pub mod steady;

use crate::error::{ObservationError, require};
use crate::observation::Observation;
use crate::recorded_use::RecordedUse;
use crate::site::Site;
use crate::station::{LeftOutStation, Station};
use crate::withheld::Platform;
use isobar_model::Layout;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// The settings of an instrument, and how it is built from them.
pub trait InstrumentSettings: fmt::Debug + Send + Sync {
    /// The instrument at a site, before its first cycle. Its biases are added to those of the site.
    ///
    /// # Errors
    /// Settings that are not what they must be.
    fn build(&self, site: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError>;

    /// Whether its observations were made elsewhere.
    fn is_recorded(&self) -> bool {
        false
    }

    /// Whether its observations have a place in a scan line.
    fn has_scan_lines(&self) -> bool {
        false
    }

    /// Whether its observations have times within the window, and are used at these.
    fn is_within_window(&self) -> bool {
        false
    }

    /// Whether a bias that methods must estimate depends on the state.
    fn has_air_mass_bias(&self) -> bool {
        false
    }
}

/// An instrument in operation.
pub trait Instrument: Send + Sync {
    /// Its observations in a cycle in which it reports, those of a platform one after another; to be called for one cycle
    /// after the other. `cycle` is counted from 1, `pass` says how often it reported before.
    fn observe(&mut self, cycle: usize, pass: usize) -> Vec<Observation>;

    /// The most observations that it may report in a cycle in which it reports.
    fn most_observations(&self, cycle: usize) -> usize;

    /// An upper bound for the observations of one variable with the same [report number](Observation::report_number) in a
    /// cycle.
    fn most_in_report(&self) -> usize {
        self.most_observations(1)
    }

    /// Its platforms that can be withheld: stations, or the identifiers in a file; none for an instrument whose observations are
    /// all at different places.
    fn platforms(&self) -> Vec<Platform> {
        Vec::new()
    }

    /// About how many weights the rows of X and the predictors have that it holds, or makes in a cycle.
    fn weights(&self) -> usize;

    /// Its random streams, always in the same order, for checkpoints.
    fn streams(&mut self) -> Vec<&mut ChaCha8Rng>;

    /// Its stations in the domain, for an instrument with stations.
    fn stations(&self) -> &[Station] {
        &[]
    }

    /// Its stations outside of the domain, or too near to its edges.
    fn left_out(&self) -> &[LeftOutStation] {
        &[]
    }

    /// What becomes of its observations in these cycles; `None` for an instrument that makes its observations itself.
    fn recorded_use(&self, _cycles: &RangeInclusive<usize>) -> Option<RecordedUse> {
        None
    }
}

/// The platforms of some observations, each with the numbers of its biases, sorted by name with all their biases.
fn platforms_of<'a, B: Iterator<Item = usize>>(observations: impl Iterator<Item = (&'a Arc<str>, B)>) -> Vec<Platform> {
    let mut biases: BTreeMap<Arc<str>, BTreeSet<usize>> = BTreeMap::new();
    for (platform, parameters) in observations {
        biases.entry(Arc::clone(platform)).or_default().extend(parameters);
    }
    biases.into_iter().map(|(name, biases)| Platform { name, biases }).collect()
}

/// A variable of the state that an instrument reports.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservedVariable {
    /// The variable's name in the state's layout.
    pub name: String,
    /// Standard deviation of the random error, in the variable's unit; above 0.
    pub sigma: f64,
}

impl ObservedVariable {
    /// The variable of this name, with errors of this standard deviation.
    pub fn new(name: &str, sigma: f64) -> Self {
        Self { name: name.to_owned(), sigma }
    }

    /// Its number in the layout; `settings` are those of its name and its sigma.
    pub(crate) fn find(
        &self,
        layout: &Layout,
        network: &str,
        settings: [&'static str; 2],
    ) -> Result<usize, ObservationError> {
        require(self.sigma > 0.0, network, settings[1], self.sigma, "above 0")?;
        layout.variable(&self.name).ok_or_else(|| {
            let valid = layout.variables.iter().map(|variable| variable.name);
            ObservationError::unknown_name(network, settings[0], &self.name, valid)
        })
    }
}
