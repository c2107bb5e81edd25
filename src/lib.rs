//! isobar: a 2-D data-assimilation testbed with Lange's Fast Kalman Filter.

pub mod event;
pub mod sink;
pub mod summary;
