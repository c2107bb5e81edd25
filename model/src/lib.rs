//! Forecast models: x(t + Δt) = M(x(t)), with tangent-linear and adjoint.
//!
//! Contents: [`time`], [`grid`], [`state`], [`increment`], [`forecast`] (the traits), [`random`].

pub mod forecast;
pub mod grid;
pub mod increment;
pub mod random;
pub mod state;
pub mod time;

pub use forecast::{Adjoint, ForecastError, Model, TangentLinear};
pub use grid::{Boundary, Grid, Location};
pub use increment::Increment;
pub use state::{Layout, State, Variable};
pub use time::{Duration, Time};
