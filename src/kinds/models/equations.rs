//! What the equations of every model can do.

use super::parameter::{BasicState, Parameter};
use super::water::Water;
use isobar_model::{Adjoint, Duration, Forcing, Grid, Layout, ModelError, State, advection, shallow_water};
use std::fmt::Debug;
use std::sync::Arc;

/// The equations of a model, with their parameters.
pub trait Equations: Debug + Send + Sync {
    /// The prognostic variables: name and unit, in the order in which a state holds them.
    fn variables(&self) -> &[(&'static str, &'static str)];

    /// Grid and variables of a state on a grid.
    fn layout(&self, grid: &Grid) -> Arc<Layout> {
        let layout = if self.water().is_some() { shallow_water::layout } else { advection::layout };
        layout(grid.clone())
    }

    /// The model on a grid, for cycles of this length, with a forcing.
    ///
    /// # Errors
    /// If the grid, the parameters, the time step or the forcing do not fit.
    fn build(
        &self,
        grid: &Grid,
        time_step: Duration,
        cycle: Duration,
        forcing: &Arc<Forcing>,
    ) -> Result<Arc<dyn Adjoint>, ModelError>;

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

    /// The flow of a state, averaged over the domain, eastward and northward \[m/s\]; zero where states have no wind.
    fn mean_flow(&self, _: &Grid, state: &State) -> [f64; 2] {
        ["u", "v"].map(|name| {
            let wind = state.layout().variable(name).and_then(|number| state.field(number).mean());
            wind.unwrap_or(0.0)
        })
    }

    /// How fast anything travels at most from a state \[m/s\]: with the wind, and gravity waves beside it. Zero where that is not
    /// known.
    fn fastest_m_per_s(&self, _: &Grid, state: &State) -> f64 {
        let largest = |name: &str| {
            let number = state.layout().variable(name);
            number.map_or(0.0, |number| {
                state.field(number).iter().fold(0.0, |largest: f64, value| largest.max(value.abs()))
            })
        };
        let waves = self.water().map_or(0.0, |water| (water.parameters.gravity_m_per_s2 * largest("h")).sqrt());
        largest("u").hypot(largest("v")) + waves
    }

    /// A parameter that an assimilation may correct, at each cell, `[y, x]`; `None` if there is no such parameter.
    fn parameter_field(&self, grid: &Grid, name: &str) -> Option<Vec<f64>> {
        let mut own = self.boxed_clone();
        let (_, value) = own.parameters(grid).into_iter().find(|(parameter, _)| parameter.name == name)?;
        Some(vec![*value; grid.cells()])
    }

    /// The parameters that an assimilation may correct, each with its place in the equations.
    fn parameters(&mut self, _: &Grid) -> Vec<(Parameter, &mut f64)> {
        Vec::new()
    }
}
