//! Synthetic observing systems: networks, satellites, their biases, and their observation operators.
//!
//! What a method sees:
//! - [`window`]: [`ObservationWindow`], the observations of one cycle
//! - [`report`]: [`Report`], where, what and by whom each observation is
//! - [`aside`]: [`Aside`], passive and rejected observations, which no method sees
//! - [`operator`]: [`ObservationOperator`], y = h(x, c); [`within_window`]: of observations before the end of the window
//! - [`jacobian`], [`sparse`]: its Jacobians X and G
//! - [`error_regression`]: [`ErrorRegression`], R of correlated errors
//! - [`calibration`]: the parameters c, and what is known of them
//!
//! What an experiment describes:
//! - [`system`]: [`ObservingSystem`], all networks together
//! - [`network`]: [`Network`], an instrument, its [`Schedule`] and its [`Faults`]
//! - [`bias`]: how biases truly behave, and what methods may assume; [`air_mass`]: biases that depend on the state
//! - [`error_correlation`]: [`ErrorCorrelation`], how random errors are correlated within reports
//! - [`station`]: where stations come from; [`station_file`], [`observation_file`]: files of stations and observations
//! - [`table`](mod@table), [`times`]: how all tables and times are read
//! - [`projection`]: the plane's place on the Earth
//! - [`recorded_use`]: [`RecordedUse`], how many observations of a file can be used
//! - [`withheld`]: [`Withheld`], stations that no method sees
//! - [`quality`]: [`QualityControl`], which values are rejected; [`rejection`]: why; [`value_check`]: what was expected
//! - [`error`]: [`ObservationError`], everything that can be wrong with it
//!
//! What makes observations:
//! - [`instrument`]: [`InstrumentSettings`] and [`Instrument`], the traits of every instrument; an addition is one file
//! - [`instrument::radiosonde`], [`instrument::satellite`], [`instrument::recorded`], [`instrument::recorded_bias`]
//! - [`window_states`]: the states through a window that are observed
//! - [`instrument::steady`]: [`Steady`], any instrument that sees the same in every cycle
//! - [`site`]: where and when an instrument is to observe
//! - [`observation`], [`predictor`]: one observation as an instrument makes it
//! - [`state_operator`]: [`StateOperator`], what it sees of the state
//! - [`footprint`](mod@footprint): what a satellite averages over
//!
//! `testing` (feature `testing`): the contract batteries that any operator and any instrument must pass.

pub mod air_mass;
pub mod aside;
pub mod bias;
mod biases;
pub mod calibration;
pub mod comparison;
pub mod error;
pub mod error_correlation;
pub mod error_regression;
pub mod faults;
pub mod footprint;
mod general_operator;
pub mod instrument;
pub mod jacobian;
pub mod network;
pub mod observation;
pub mod observation_file;
pub mod operator;
pub mod predictor;
pub mod projection;
pub mod quality;
pub mod recorded_use;
pub mod rejection;
pub mod report;
pub mod site;
pub mod sparse;
pub mod state_operator;
pub mod station;
pub mod station_file;
pub mod system;
pub mod table;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod times;
pub mod value_check;
pub mod window;
pub mod window_states;
pub mod withheld;
pub mod within_window;

pub use air_mass::AirMassBias;
pub use aside::{Aside, Unused, UnusedObservation};
pub use bias::{AssumedDrift, BiasProcess, Evolution, InitialBias};
pub use calibration::{ByPlacement, Calibration, Drift, Parameter, Placement};
pub use comparison::SensorComparison;
pub use error::ObservationError;
pub use error_correlation::{ErrorCorrelation, ErrorCorrelationKind};
pub use error_regression::ErrorRegression;
pub use faults::Faults;
pub use footprint::footprint;
pub use instrument::radiosonde::{BiasScope, RadiosondeSettings, StationBias};
pub use instrument::recorded::{RecordedSettings, RecordedTimes, WindAxes};
pub use instrument::recorded_bias::{ColumnPredictor, RecordedBias, RecordedScope};
pub use instrument::satellite::{Heading, SatelliteSettings, ScanBias, ScanTerm};
pub use instrument::steady::Steady;
pub use instrument::{Instrument, InstrumentSettings, ObservedVariable};
pub use jacobian::Jacobian;
pub use network::{Network, Schedule};
pub use observation::{Observation, Reading, ScanLine};
pub use observation_file::{FurtherColumns, ObservationFile, ObservationPlace, ObservationRecord, ValidTime};
pub use operator::{LinearOperator, ObservationOperator, TimedObservations};
pub use predictor::Predictor;
pub use projection::Projection;
pub use quality::QualityControl;
pub use recorded_use::{BiasUse, RecordedUse};
pub use rejection::Rejection;
pub use report::{ObservationType, Report};
pub use site::Site;
pub use sparse::SparseRows;
pub use state_operator::{NonlinearOperator, StateOperator};
pub use station::{LeftOutStation, Station, StationSource};
pub use station_file::{Position, StationFile, StationRecord};
pub use system::{ObservingSystem, SavedSystem};
pub use value_check::ValueCheck;
pub use window::{ObservationTypes, ObservationWindow};
pub use window_states::WindowStates;
pub use withheld::{Platform, Withheld};
pub use within_window::WithinWindow;
