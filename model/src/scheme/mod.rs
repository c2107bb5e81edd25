//! Time schemes, once for all models, and the sweeps over rows in which they advance states and increments.
//!
//! | module | contents |
//! |---|---|
//! | [`tendency`] | [`Tendency`]: the right-hand side dx/dt = f(x), its derivative and transpose; [`SpectralBounds`] |
//! | [`runge_kutta`] | [`Stepped`]: a tendency with a [`TimeScheme`] and a time step; the stability limit |
//! | [`leapfrog`] | [`Leapfrog`] with Robert's filter, a model whose state holds two time levels |
//! | [`restarted`] | [`RestartedLeapfrog`]: leapfrog restarted after every analysis, with one time level |
//! | [`rows`] | [`RowStream`], [`TangentRowStream`] and [`AdjointRowStream`]: f, f' and its transpose row by row |
//! | `sweep`, `bands`, `ends` | a step of the state as one pass over memory, in parallel bands of rows |
//! | `side_by_side` | states of a small grid advanced together |
//! | `tangent_sweep`, `adjoint_sweep` | the same for increments, forwards and back |
//! | `groups`, `held_groups`, `interleaving`, `strips`, `stages` | which increments together, how they lie, and rows in cache |
//! | `update` | how the slopes of a row make its next state |

mod adjoint_sweep;
mod bands;
mod ends;
mod groups;
mod held_groups;
mod interleaving;
pub mod leapfrog;
pub mod restarted;
pub mod rows;
pub mod runge_kutta;
mod side_by_side;
mod stages;
pub(crate) mod strips;
pub(crate) mod sweep;
mod tangent_sweep;
pub mod tendency;
mod update;

pub use leapfrog::Leapfrog;
pub use restarted::RestartedLeapfrog;
pub use rows::{AdjointRowStream, Pushed, RowStream, TangentRowStream};
pub use runge_kutta::{Stepped, TimeScheme, check_time_step};
pub use strips::{Lanes, MOST_PLACES};
pub use tendency::{SpectralBounds, Tendency};
