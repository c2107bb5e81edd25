//! `kind = "shallow_water"`.

use super::equations::Equations;
use super::integration;
use super::parameter::Parameter;
use super::water::{self, VARIABLES, Water};
use crate::kinds::Kind;
use isobar_model::{Adjoint, Duration, Forcing, Grid, ModelError};
use std::sync::Arc;

pub(super) const KIND: Kind<dyn Equations, Grid> = Kind::new(
    "shallow_water",
    "The nonlinear rotating shallow-water equations for h, u and v",
    &[water::KEYS, integration::KEYS],
    |section, grid| Ok(Box::new(water::read(section, grid)?)),
);

impl Equations for Water {
    fn variables(&self) -> &[(&'static str, &'static str)] {
        VARIABLES
    }

    fn build(
        &self,
        grid: &Grid,
        time_step: Duration,
        cycle: Duration,
        forcing: &Arc<Forcing>,
    ) -> Result<Arc<dyn Adjoint>, ModelError> {
        self.integration.of(self.tendency(grid)?, time_step, cycle, forcing)
    }

    fn boxed_clone(&self) -> Box<dyn Equations> {
        Box::new(self.clone())
    }

    fn is_linear(&self) -> bool {
        false
    }

    fn water(&self) -> Option<&Water> {
        Some(self)
    }

    fn parameters(&mut self, _: &Grid) -> Vec<(Parameter, &mut f64)> {
        self.parameters_mut()
    }
}
