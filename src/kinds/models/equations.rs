//! What the equations of every model can do.

use super::parameter::{BasicState, Parameter};
use super::water::Water;
use isobar_model::{Adjoint, Duration, Grid, ModelError};
use std::fmt::Debug;
use std::sync::Arc;

/// The equations of a model, with their parameters.
pub trait Equations: Debug + Send + Sync {
    /// The prognostic variables: name and unit, in the order in which a state holds them.
    fn variables(&self) -> &[(&'static str, &'static str)];

    /// The model on a grid, for cycles of this length.
    ///
    /// # Errors
    /// If the grid, the parameters or the time step do not fit.
    fn build(&self, grid: &Grid, time_step: Duration, cycle: Duration) -> Result<Arc<dyn Adjoint>, ModelError>;

    /// The same equations with the same parameters.
    fn boxed_clone(&self) -> Box<dyn Equations>;

    /// Whether forecasts are linear in the state.
    fn is_linear(&self) -> bool;

    /// Whether the equations can be solved on another grid than the scenario's.
    fn has_other_resolutions(&self) -> bool {
        true
    }

    /// The shallow-water equations that initial states and covariances are in balance with; `None` for a tracer.
    fn water(&self) -> Option<&Water> {
        None
    }

    /// The state about which shallow water is linearised, if it is.
    fn basic_state(&self) -> Option<BasicState> {
        None
    }

    /// The parameters that an assimilation may correct, each with its place in the equations.
    fn parameters(&mut self, _: &Grid) -> Vec<(Parameter, &mut f64)> {
        Vec::new()
    }
}
