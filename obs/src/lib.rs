//! Synthetic observing systems: networks, satellites, their biases, and their observation operators.
//!
//! What a method sees:
//! - [`window`]: [`ObservationWindow`], the observations of one cycle
//! - [`report`]: [`Report`], where, what and by whom each observation is
//! - [`operator`]: [`ObservationOperator`], y = h(x, c)
//! - [`jacobian`], [`sparse`]: its Jacobians X and G
//! - [`quality`]: [`QualityControl`], which observations no method sees
//! - [`calibration`]: the parameters c, and what is known of them
//!
//! What an experiment describes:
//! - [`system`]: [`ObservingSystem`], all instruments together
//! - [`instrument`]: [`InstrumentConfig`], [`Schedule`]; [`instrument::radiosonde`], [`instrument::satellite`]
//! - [`network`], [`stations`]: where stations come from, and station files
//! - [`observation_file`], [`instrument::recorded`]: observations that somebody else made
//! - [`bias`]: how biases truly behave, and what methods may assume; [`air_mass`]: those that depend on the state
//! - [`faults`]: [`Faults`], reports that must not be believed
//! - [`footprint`](mod@footprint): what a satellite averages over
//! - [`projection`]: the plane's place on the Earth
//! - [`error`]: [`ObservationError`], all that can be wrong with it
//!
//! `testing` (feature `testing`): the contract battery that any operator must pass.

pub mod air_mass;
pub mod bias;
mod biases;
pub mod calibration;
pub mod error;
pub mod faults;
pub mod footprint;
pub mod instrument;
pub mod jacobian;
pub mod network;
pub mod observation_file;
pub mod operator;
pub mod projection;
pub mod quality;
pub mod report;
pub mod sparse;
pub mod stations;
pub mod system;
pub mod table;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod times;
pub mod window;

pub use air_mass::AirMassBias;
pub use bias::{BiasProcess, Evolution, InitialBias};
pub use calibration::{ByPlacement, Calibration, Parameter, Placement};
pub use error::ObservationError;
pub use faults::Faults;
pub use footprint::footprint;
pub use instrument::radiosonde::{BiasScope, RadiosondeConfig, StationBias};
pub use instrument::recorded::{RecordedConfig, RecordedUse, WindAxes};
pub use instrument::satellite::{Heading, SatelliteConfig, ScanBias, ScanTerm};
pub use instrument::{InstrumentConfig, ObservedVariable, Schedule};
pub use jacobian::Jacobian;
pub use network::{LeftOutStation, Station, StationSource};
pub use observation_file::{ObservationFile, ObservationPlace, ObservationRecord, ValidTime};
pub use operator::{LinearOperator, ObservationOperator};
pub use projection::Projection;
pub use quality::{QualityControl, RejectedObservation, Rejection};
pub use report::{ObservationType, Report};
pub use sparse::SparseRows;
pub use stations::{Position, StationRecord, Stations};
pub use system::{ObservingSystem, SavedSystem};
pub use window::{ObservationTypes, ObservationWindow};
