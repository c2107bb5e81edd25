//! Forecast models: x(t + Δt) = M(x(t)), each with its tangent-linear δx(t + Δt) = M'(x) δx(t) and its adjoint.
//!
//! # Contents
//!
//! | module | what it holds |
//! |---|---|
//! | [`time`], [`grid`], [`state`], [`increment`] | the nouns: when, where, x and δx |
//! | [`vector`] | y += a x, differences, inner products of plain slices |
//! | [`stored`] | increments in double or single precision |
//! | [`forecast`] | the traits [`Model`], [`TangentLinear`], [`Adjoint`], and the loops over time steps |
//! | [`forcing`], [`time_function`], [`forced`] | known sources B u(t), and a model with them |
//! | [`scheme`] | time schemes, once for all: [`Tendency`] + [`TimeScheme`] = [`Stepped`]; [`Leapfrog`]; sweeps over rows |
//! | [`shallow_water`] | rotating [`ShallowWater`], nonlinear, and [`LinearShallowWater`] about a zonal flow |
//! | [`advection`] | [`Advection`] of a tracer, and the [`ExactShift`] without any error |
//! | [`initial`] | rest, jets, vortices, balanced random states, hills and waves |
//! | [`invariants`] | mass, total energy, potential enstrophy |
//! | [`random`] | a seeded stream for each purpose |
//! | [`error`] | [`ModelError`]: why a configuration is refused |
//! | [`bands`] | [`Bands`] of rows, one for each rank, and the [`BandedModel`] that they integrate together |
//! | [`communicator`] | [`Communicator`]: the processes that compute one run together |
//! | `testing` | (feature `testing`) the contract every model must pass |
//!
//! # Equations
//!
//! Each with sources B u(t) of any variable, if there is a [`Forcing`].
//!
//! ```text
//! shallow water                                           advection
//!   ∂u/∂t =  q h v − ∂B/∂x − r u − ν ∇⁴u                     ∂c/∂t = −∂(u c)/∂x − ∂(v c)/∂y
//!   ∂v/∂t = −q h u − ∂B/∂y − r v − ν ∇⁴v
//!   ∂h/∂t = −∂(h u)/∂x − ∂(h v)/∂y − ν ∇⁴h
//!   q = (f + ∂v/∂x − ∂u/∂y)/h,   B = g h + (u² + v²)/2,   f = f0 + β (y − y_mid)
//! ```
//!
//! # The C grid (Arakawa & Lamb 1977)
//!
//! ```text
//!   q ---- v ---- q ---- v ---- q        j + 1      h, c  Center   ((i + ½) dx, (j + ½) dy)
//!   |             |             |                   u     XFace    ( i      dx, (j + ½) dy)
//!   u      h      u      h      u                   v     YFace    ((i + ½) dx,  j      dy)
//!   |             |             |                   q     Corner   ( i      dx,  j      dy)
//!   q ---- v ---- q ---- v ---- q        j
//!   i           i + 1         i + 2
//! ```
//!
//! Always periodic in x; in y either periodic or a channel whose southern wall is the row j = 0 of v, and whose northern
//! wall is not stored.
//!
//! # Example
//!
//! ```
//! use isobar_model::{initial, *};
//!
//! let grid = Grid { nx: 32, ny: 24, dx_m: 100e3, dy_m: 100e3, boundary: Boundary::Channel };
//! let parameters = ShallowWaterParameters {
//!     gravity_m_per_s2: 9.81,
//!     coriolis_per_s: 1e-4,
//!     beta_per_m_per_s: 1.6e-11,
//!     ..Default::default()
//! };
//! let equations = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy)?;
//! let jet = initial::JetConfig {
//!     mean_depth_m: 1000.0,
//!     speed_m_per_s: 30.0,
//!     center_y_m: 1.2e6,
//!     width_m: 3e5,
//!     perturbation: None,
//! };
//! let mut x = initial::geostrophic_jet(&equations, &jet)?;
//! let model = Stepped::new(equations, Duration::from_seconds(300), TimeScheme::Rk4)?;
//! check_time_step(&model, &x)?;
//! forecast::forecast(&model, &mut x, 12)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod advection;
mod arithmetic;
pub mod bands;
mod columns;
pub mod communicator;
pub mod error;
pub mod forced;
pub mod forcing;
pub mod forecast;
pub mod grid;
mod halo;
pub mod increment;
pub mod initial;
pub mod invariants;
mod places;
pub mod random;
mod readable;
pub mod scheme;
pub mod shallow_water;
pub mod state;
pub mod stored;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod time;
pub mod time_function;
pub mod vector;

pub use advection::{Advection, AdvectionScheme, ExactShift, Wind};
pub use bands::{BandedModel, Bands};
pub use communicator::Communicator;
pub use error::ModelError;
pub use forced::Forced;
pub use forcing::{Forcing, Source};
pub use forecast::{Adjoint, ForecastError, InBands, Model, TangentLinear};
pub use grid::{Boundary, Grid, Location};
pub use increment::Increment;
pub use scheme::{
    AdjointRowStream, Lanes, Leapfrog, RestartedLeapfrog, RowStream, SpectralBounds, Stepped, TangentRowStream,
    Tendency, TimeScheme, check_time_step,
};
pub use shallow_water::{LinearShallowWater, ShallowWater, ShallowWaterParameters, VectorInvariant};
pub use state::{Layout, State, Variable};
pub use stored::{ColumnsMut, Stored};
pub use time::{Duration, Time};
pub use time_function::TimeFunction;
