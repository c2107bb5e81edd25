//! Data-assimilation methods.
//!
//! | module | method |
//! |---|---|
//! | [`block_angular`] | the regression of eqs. (28)/(29) of WO 93/22625, a solver of its own |
//! | [`filter`] | the recursion of a Kalman filter; [`errors`] the forms of its covariance: |
//! | [`kalman`] | the whole matrix: the reference |
//! | [`banded`] | a band: the Frobenius recursion |
//! | [`fast_kalman`] | blocks of the grid and common factors: Lange's Fast Kalman Filter |
//! | [`time_volume`] | unknowns that are constant over a moving window, about the Fast Kalman Filter's covariance |
//! | [`federated`] | a filter for each observing system, dense or a Fast Kalman Filter, and their fusion |
//! | [`variational`] | 3D-Var, also with an ensemble's covariance (hybrid), and 4D-Var; biases in the control vector |
//! | [`optimal_interpolation`] | the analysis with a static covariance, solved directly |
//! | [`ensemble`] | ensemble Kalman filters: transform (ETKF), local (LETKF), stochastic (EnKF) |
//! | [`high_pass`] | Lange's High-pass Filter |
//! | [`wind_finding`] | a balloon's positions and its trackers' calibration: the block-angular regression by itself |
//! | [`free`], [`climatology`] | no assimilation |
//! | [`around`] | decorators: a method with something added |
//! | [`appropriate_time`] | observations of a window, each seen from the background at its time |
//! | [`response`], [`actual_errors`] | the gain of any of them, found by asking, and what it is worth |
//! | [`observability`] | which biases the data determine |
//!
//! All of them are given a [`Problem`], see models and observations only through traits and Jacobians, and are an
//! [`Assimilator`]. [`covariance`] holds B and Q as operators; `testing` (feature `testing`) the contracts they must keep.

pub mod actual_errors;
mod advice;
pub mod appropriate_time;
pub mod around;
pub mod assimilator;
mod augmented;
pub mod block_angular;
mod calibrated_state;
pub mod calibration_accuracy;
mod calibration_drift;
pub mod climatology;
pub mod covariance;
pub mod covariance_column;
pub mod covariance_root;
pub mod ensemble;
pub mod error;
pub mod errors;
pub mod estimate;
pub mod estimated;
pub mod federated;
pub mod filter;
mod fixed_lag;
pub mod free;
pub mod high_pass;
mod innovation_covariance;
mod lanes;
mod leading_eigenvectors;
mod linalg;
mod memory;
mod needs;
pub mod observability;
pub mod optimal_interpolation;
pub mod problem;
mod propagator;
pub mod response;
mod spectral_cut;
mod spread;
pub mod structure;
mod tall_matrix;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
mod ties;
pub mod time_volume;
pub mod variational;
pub mod wind_finding;

pub use advice::Advice;
pub use around::adaptive::{AdaptedCovariance, Adaptive, AdaptiveSettings};
pub use around::first_calibration::Initialised;
pub use around::sensors::{Calibrated, Recalibration, SensorKnowledge};
pub use around::whitened::Whitened;
pub use assimilator::{
    Adjustments, Assimilator, CalibrationAdjustment, ReplaceCalibration, Smoother, Views, WidenCalibration,
};
pub use calibration_accuracy::{CalibrationAccuracy, CalibrationErrors};
pub use calibration_drift::drift;
pub use covariance::Covariance;
pub use covariance_column::{CovarianceColumn, JointErrors, Unknown, correlation};
pub use covariance_root::{CovarianceRoot, RootKind};
pub use error::Error;
pub use errors::{banded, blocks as fast_kalman, dense as kalman, local as local_factors};
pub use estimate::{Analysis, Background, Estimate};
pub use estimated::{EstimatedParameter, EstimatesParameters};
pub use linalg::reserve_workspace;
pub use needs::{NeededComparison, Needs};
pub use observability::{Combination, Inseparable, Observability};
pub use problem::{BiasTreatment, Problem};
pub use structure::{BlockStructure, CommonFactor, Structure};
