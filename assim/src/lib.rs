//! Data-assimilation methods.
//!
//! | module | method |
//! |---|---|
//! | [`block_angular`] | the regression of eqs. (28)/(29) of WO 93/22625, a solver of its own |
//! | [`fast_kalman`] | Lange's Fast Kalman Filter on the blocks of a grid |
//! | [`kalman`] | the dense (extended) Kalman filter: the reference |
//! | [`serial_kalman`] | the same, one observation at a time; [`dense_filter`] is what both share |
//! | [`banded`] | the Kalman filter with a banded covariance: the Frobenius recursion |
//! | [`federated`] | a Kalman filter for each observing system, and their fusion |
//! | [`variational`] | 3D-Var, also with an ensemble's covariance (hybrid), and 4D-Var; biases in the control vector |
//! | [`optimal_interpolation`] | the analysis with a static covariance, solved directly |
//! | [`ensemble`] | ensemble Kalman filters: transform (ETKF), local (LETKF), stochastic (EnKF) |
//! | [`high_pass`], [`initialised`] | Lange's High-pass Filter, and a method that starts from it |
//! | [`wind_finding`] | a balloon's positions and its trackers' calibration: the block-angular regression by itself |
//! | [`free`], [`climatology`] | no assimilation |
//! | [`response`], [`actual_errors`] | the gain of any of them, found by asking, and what it is worth |
//!
//! [`calibrated`] is what any of them makes of what is known of its sensors: earlier calibrations, recalibrations, biases
//! that are not to be adjusted; [`adaptive`] one that finds out how large errors are; [`observability`] says which
//! biases the data determine.
//!
//! All of them are given a [`Problem`], see models and observations only through traits and Jacobians, and are an
//! [`Assimilator`]. [`covariance`] holds B and Q as operators; `testing` (feature `testing`) the contract they must keep.

pub mod actual_errors;
pub mod adaptive;
pub mod assimilator;
mod augmented;
pub mod banded;
pub mod block_angular;
pub mod calibrated;
mod calibrated_state;
pub mod calibration_accuracy;
pub mod climatology;
pub mod covariance;
pub mod covariance_column;
pub mod dense_filter;
pub mod ensemble;
pub mod error;
pub mod estimated;
pub mod fast_kalman;
pub mod federated;
mod fixed_lag;
pub mod free;
pub mod high_pass;
pub mod initialised;
pub mod kalman;
mod likelihood;
mod linalg;
pub mod observability;
pub mod optimal_interpolation;
pub mod problem;
mod propagator;
pub mod response;
mod saved;
pub mod serial_kalman;
mod spread;
pub mod structure;
mod tall_matrix;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod variational;
pub mod wind_finding;

pub use adaptive::{AdaptedCovariance, Adaptive, AdaptiveSettings};
pub use assimilator::{Analysis, Assimilator, BiasTreatment, Estimate};
pub use calibrated::{Calibrated, Recalibration, SensorKnowledge};
pub use calibration_accuracy::CalibrationAccuracy;
pub use covariance::Covariance;
pub use covariance_column::{CovarianceColumn, Unknown, correlation};
pub use error::Error;
pub use estimated::EstimatedParameter;
pub use linalg::reserve_workspace;
pub use observability::{Combination, Inseparable, Observability};
pub use problem::Problem;
pub use structure::{CommonFactor, Structure};
