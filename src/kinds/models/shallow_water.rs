//! `kind = "shallow_water"`.

use super::equations::Equations;
use super::parameter::Parameter;
use super::water::{self, VARIABLES, Water};
use crate::kinds::Kind;
use crate::reader::{AnyKey, Read, Section};
use isobar_model::{Adjoint, Duration, Grid, ModelError};
use std::sync::Arc;

pub(super) struct ShallowWaterKind;

impl Kind<dyn Equations, Grid> for ShallowWaterKind {
    fn name(&self) -> &'static str {
        "shallow_water"
    }

    fn about(&self) -> &'static str {
        "The nonlinear rotating shallow-water equations for h, u and v"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        water::keys()
    }

    fn read(&self, section: &Section<'_>, grid: &Grid) -> Read<Box<dyn Equations>> {
        Ok(Box::new(water::read(section, grid)?))
    }
}

impl Equations for Water {
    fn variables(&self) -> &[(&'static str, &'static str)] {
        VARIABLES
    }

    fn build(&self, grid: &Grid, time_step: Duration, cycle: Duration) -> Result<Arc<dyn Adjoint>, ModelError> {
        self.integration.of(self.tendency(grid)?, time_step, cycle)
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
