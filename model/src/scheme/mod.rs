//! Time schemes, once for all models, and the sweeps over rows in which they advance states and increments.
//!
//! | module | contents |
//! |---|---|
//! | [`tendency`] | [`Tendency`]: the right-hand side dx/dt = f(x), its derivative and transpose; [`SpectralBounds`] |
//! | [`runge_kutta`] | [`Stepped`]: a tendency with a [`TimeScheme`] and a time step; the stability limit |
//! | [`leapfrog`] | [`Leapfrog`] with Robert's filter, a model whose state holds two time levels |
//! | [`restarted`] | [`RestartedLeapfrog`]: leapfrog restarted after every analysis, with one time level |
//! | [`rows`] | [`RowStream`] and [`TangentRowStream`]: f and f' row by row |
//! | `sweep`, `bands` | a step of the state as one pass over memory, in parallel bands of rows |
//! | `tangent_sweep`, `strips`, `interleaving` | the same for eight increments at once |
//! | `update` | how the slopes of a row make its next state |

mod bands;
mod interleaving;
pub mod leapfrog;
pub mod restarted;
pub mod rows;
pub mod runge_kutta;
mod strips;
pub(crate) mod sweep;
mod tangent_sweep;
pub mod tendency;
mod update;

pub use leapfrog::Leapfrog;
pub use restarted::RestartedLeapfrog;
pub use rows::{Pushed, RowStream, TangentRowStream};
pub use runge_kutta::{Stepped, TimeScheme, check_time_step};
pub use strips::MOST_PLACES;
pub use tendency::{SpectralBounds, Tendency};
