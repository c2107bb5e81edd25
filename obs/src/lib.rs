//! Synthetic observing systems: networks, satellites, their biases, and their observation operators.

pub mod block_angular;
pub mod calibration;
pub mod operator;
pub mod projection;
pub mod sparse;
pub mod window;

pub use block_angular::BlockAngular;
pub use calibration::{Calibration, Parameter, Placement};
pub use operator::{LinearOperator, ObservationOperator};
pub use projection::Projection;
pub use sparse::SparseRows;
pub use window::{ObservationWindow, Report};
