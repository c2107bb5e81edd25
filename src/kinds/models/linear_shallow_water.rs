//! `kind = "linear_shallow_water"`.

use super::equations::Equations;
use super::integration;
use super::parameter::{BasicState, Parameter, flow, northward, speed_or_zero};
use super::water::{self, VARIABLES, Water};
use crate::kinds::Kind;
use crate::reader::{Key, Limits};
use isobar_model::{Adjoint, Duration, Forcing, Grid, LinearShallowWater, ModelError};
use std::sync::Arc;

const MEAN_DEPTH: Key<Limits> =
    Key::required("mean_depth_m", "m", Limits::Positive, "depth at which the equations are linearised");

const MEAN_FLOW_X: Key<Limits> =
    speed_or_zero("mean_flow_m_per_s", "eastward flow at which the equations are linearised");

const MEAN_FLOW_Y: Key<Limits> =
    speed_or_zero("mean_flow_y_m_per_s", "northward flow at which they are linearised; 0 in a channel");

#[derive(Clone, Debug)]
struct LinearWater {
    water: Water,
    about: BasicState,
}

pub(super) const KIND: Kind<dyn Equations, Grid> = Kind::new(
    "linear_shallow_water",
    "The rotating shallow-water equations, linearised at a uniform depth and flow",
    &[water::KEYS, integration::KEYS, &[&MEAN_DEPTH, &MEAN_FLOW_X, &MEAN_FLOW_Y]],
    |section, grid| {
        let water = water::read(section, grid)?;
        let about = BasicState {
            mean_depth_m: section.get(&MEAN_DEPTH)?,
            u_m_per_s: section.get(&MEAN_FLOW_X)?,
            v_m_per_s: northward(section, &MEAN_FLOW_Y, grid)?,
        };
        Ok(Box::new(LinearWater { water, about }))
    },
);

impl Equations for LinearWater {
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
        let BasicState { mean_depth_m, u_m_per_s, v_m_per_s } = self.about;
        let linear =
            LinearShallowWater::about_uniform_wind(self.water.tendency(grid)?, mean_depth_m, u_m_per_s, v_m_per_s)?;
        self.water.integration.of(linear, time_step, cycle, forcing)
    }

    fn boxed_clone(&self) -> Box<dyn Equations> {
        Box::new(self.clone())
    }

    fn is_linear(&self) -> bool {
        true
    }

    fn water(&self) -> Option<&Water> {
        Some(&self.water)
    }

    fn basic_state(&self) -> Option<BasicState> {
        Some(self.about)
    }

    fn parameters(&mut self, grid: &Grid) -> Vec<(Parameter, &mut f64)> {
        let BasicState { mean_depth_m, u_m_per_s, v_m_per_s } = &mut self.about;
        let mut parameters = flow(u_m_per_s, v_m_per_s, grid);
        parameters.push((Parameter { name: MEAN_DEPTH.name, unit: "m", step: 1.0 }, mean_depth_m));
        parameters.extend(self.water.parameters_mut());
        parameters
    }
}
