//! Forecast models: x(t + Δt) = M(x(t)), with tangent-linear and adjoint.
pub mod advection;
pub mod error;
pub mod forecast;
pub mod grid;
mod halo;
pub mod increment;
pub mod initial;
pub mod invariants;
pub mod random;
pub mod scheme;
pub mod shallow_water;
pub mod state;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod time;

pub use advection::{Advection, AdvectionScheme, ExactShift, Wind};
pub use error::ModelError;
pub use forecast::{Adjoint, ForecastError, Model, TangentLinear};
pub use grid::{Boundary, Grid, Location};
pub use increment::Increment;
pub use scheme::{SpectralBounds, Stepped, Tendency, TimeScheme, check_time_step};
pub use shallow_water::{LinearShallowWater, ShallowWater, ShallowWaterParameters, VectorInvariant};
pub use state::{Layout, State, Variable};
pub use time::{Duration, Time};
