//! Why a model, a time step or an initial state cannot be had.

use crate::readable::{Readable, at_most};

/// What is wrong with a model's configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// A parameter is outside of its range.
    #[error("{name} = {} must be {requirement}", Readable(*value))]
    Parameter {
        /// The parameter, with its unit: `mean_depth_m`.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be, in words.
        requirement: &'static str,
    },
    /// The grid has too few cells for the stencils.
    #[error("the grid of {nx} x {ny} cells is too small: at least {least} x {least} are needed")]
    GridTooSmall {
        /// Cells in x.
        nx: usize,
        /// Cells in y.
        ny: usize,
        /// The least number in either direction.
        least: usize,
    },
    /// The time step is beyond the stability limit.
    #[error("time step {time_step_s} s exceeds the largest stable one, {} s", at_most(*largest_s))]
    TimeStepTooLong {
        /// The model's time step \[s\].
        time_step_s: i64,
        /// The largest stable one at the given state \[s\].
        largest_s: f64,
    },
    /// A thickness is not positive.
    #[error("the thickness at row {row}, column {column} is {} m: it must be positive", Readable(*thickness_m))]
    Thickness {
        /// Row.
        row: usize,
        /// Column.
        column: usize,
        /// The thickness there \[m\].
        thickness_m: f64,
    },
    /// A value of a state is not finite.
    #[error("{place} is {}: it must be finite", Readable(*value))]
    NotFinite {
        /// Variable, row and column.
        place: String,
        /// The value there.
        value: f64,
    },
    /// A state has no valid time, and the model is not autonomous.
    #[error("the state has no valid time, from which a model with a forcing could go on: State::valid_at says it")]
    NoTime,
    /// A source of a forcing does not fit the model.
    #[error("{reason}")]
    Source {
        /// What is wrong.
        reason: String,
    },
    /// The model cannot be integrated by several ranks.
    #[error("{reason}")]
    Bands {
        /// Why.
        reason: String,
    },
    /// No thickness balances the wind between two rows.
    #[error("no thickness balances the zonal wind {} m/s at row {row}", Readable(*wind_m_per_s))]
    NoBalance {
        /// The row that could not be balanced with the one south of it.
        row: usize,
        /// The wind there \[m/s\].
        wind_m_per_s: f64,
    },
    /// The basic state of a linear model is not steady.
    #[error(
        "the basic state is not steady: {place} changes by {tendency:e} per second, more than the largest term of \
         its budget times {tolerance:e}"
    )]
    NotSteady {
        /// Variable, row and column.
        place: String,
        /// Its tendency \[unit of the variable per second\].
        tendency: f64,
        /// The relative tolerance.
        tolerance: f64,
    },
}

/// Fails unless `holds`.
pub(crate) fn require(
    holds: bool,
    name: &'static str,
    value: f64,
    requirement: &'static str,
) -> Result<(), ModelError> {
    if holds { Ok(()) } else { Err(ModelError::Parameter { name, value, requirement }) }
}

/// Fails unless the value is finite and above zero.
pub(crate) fn require_positive(name: &'static str, value: f64) -> Result<(), ModelError> {
    require(value.is_finite() && value > 0.0, name, value, "finite and positive")
}

/// Fails unless the value is finite and not below zero.
pub(crate) fn require_non_negative(name: &'static str, value: f64) -> Result<(), ModelError> {
    require(value.is_finite() && value >= 0.0, name, value, "finite and not negative")
}

/// Fails unless the value is finite.
pub(crate) fn require_finite(name: &'static str, value: f64) -> Result<(), ModelError> {
    require(value.is_finite(), name, value, "finite")
}
