//! isobar: a 2-D data-assimilation testbed with Lange's Fast Kalman Filter.

pub mod cli;
pub mod event;
pub mod progress;
pub mod scenario;
pub mod sink;
pub mod summary;
pub mod table;
