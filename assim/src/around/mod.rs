//! Decorators: what any method becomes with something added.
//!
//! | module | what it adds |
//! |---|---|
//! | [`sensors`] | earlier calibrations and recalibrations of sensors, comparisons between them, frozen biases |
//! | [`adaptive`] | factors on the errors of observations and forecasts, found from the innovations |
//! | [`whitened`] | correlated errors of observations |
//! | [`first_calibration`] | a calibration from the first observations, by Lange's High-pass Filter |

pub mod adaptive;
mod compared;
pub mod first_calibration;
mod likelihood;
pub mod sensors;
pub mod whitened;
