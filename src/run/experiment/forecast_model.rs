//! `[model]` as a model.

use crate::scenario::{
    AdvectionScheme, Conserved, Dynamics, ModelSettings, Scenario, ShallowWaterSettings, TimeScheme, Wind,
};
use isobar_model::{
    Adjoint, Advection, Duration, ExactShift, Grid, Leapfrog, LinearShallowWater, ModelError, RestartedLeapfrog,
    ShallowWater, ShallowWaterParameters, Stepped, Tendency, VectorInvariant,
};
use std::sync::Arc;

/// The model, for cycles of so long a window.
pub(super) fn build(settings: &ModelSettings, grid: &Grid, window: Duration) -> Result<Arc<dyn Adjoint>, ModelError> {
    let time_step = settings.time_step;
    Ok(match &settings.dynamics {
        Dynamics::ShallowWater(own) => stepped(shallow_water(own, grid)?, own.time_scheme, time_step, window)?,
        &Dynamics::LinearShallowWater {
            settings: ref own,
            mean_depth_m,
            mean_flow_m_per_s: u,
            mean_flow_y_m_per_s: v,
        } => {
            let linear = LinearShallowWater::about_uniform_wind(shallow_water(own, grid)?, mean_depth_m, u, v)?;
            stepped(linear, own.time_scheme, time_step, window)?
        }
        Dynamics::Advection { wind, scheme: own, time_scheme } => {
            let wind = match *wind {
                Wind::Uniform { u_m_per_s, v_m_per_s } => isobar_model::Wind::Uniform { u_m_per_s, v_m_per_s },
                Wind::Vortex { speed_m_per_s } => isobar_model::Wind::Vortex { speed_m_per_s },
            };
            let own = match own {
                AdvectionScheme::FirstOrderUpwind => isobar_model::AdvectionScheme::FirstOrderUpwind,
                AdvectionScheme::ThirdOrderUpwind => isobar_model::AdvectionScheme::ThirdOrderUpwind,
                AdvectionScheme::FourthOrderCentred => isobar_model::AdvectionScheme::FourthOrderCentred,
            };
            let advection = Advection::new(grid.clone(), &wind, own)?;
            stepped(advection, *time_scheme, time_step, window)?
        }
        Dynamics::ExactShift { columns_per_step, rows_per_step } => {
            Arc::new(ExactShift::new(grid.clone(), *columns_per_step, *rows_per_step, time_step)?)
        }
    })
}

/// The scenario's model with cells so many times as wide, and the longest time step that divides the window and is not
/// longer in proportion.
pub(super) fn build_coarser(scenario: &Scenario, factor: usize) -> Result<Arc<dyn Adjoint>, isobar_assim::Error> {
    let fault =
        |reason: &dyn std::fmt::Display| isobar_assim::Error::Setting(format!("factor_grid = {factor}: {reason}"));
    if matches!(scenario.model.dynamics, Dynamics::ExactShift { .. }) {
        return Err(fault(&"an exact shift by whole cells has none on a coarser grid"));
    }
    let Grid { nx, ny, dx_m, dy_m, boundary } = scenario.grid.grid;
    let width = factor as f64;
    let grid = Grid { nx: nx / factor, ny: ny / factor, dx_m: width * dx_m, dy_m: width * dy_m, boundary };
    let (window, step) = (scenario.cycle.window.seconds(), scenario.model.time_step.seconds());
    let least = window / step;
    let steps = (least.div_euclid(factor as i64).max(1)..=least)
        .find(|&steps| steps * factor as i64 >= least && window % steps == 0)
        .expect("the window holds whole steps of the model");
    let settings = ModelSettings { time_step: Duration::from_seconds(window / steps), ..scenario.model.clone() };
    build(&settings, &grid, scenario.cycle.window).map_err(|error| fault(&error))
}

/// The nonlinear equations.
pub(super) fn shallow_water(settings: &ShallowWaterSettings, grid: &Grid) -> Result<ShallowWater, ModelError> {
    let parameters = ShallowWaterParameters {
        gravity_m_per_s2: settings.gravity_m_per_s2,
        coriolis_per_s: settings.coriolis_per_s,
        beta_per_m_per_s: settings.beta_per_m_per_s,
        drag_per_s: settings.drag_per_s,
        hyperdiffusion_m4_per_s: settings.hyperdiffusion_m4_per_s,
    };
    let form = match settings.conserves {
        Conserved::Enstrophy => VectorInvariant::PotentialEnstrophy,
        Conserved::Energy => VectorInvariant::Energy,
    };
    ShallowWater::new(grid.clone(), parameters, form)
}

/// A tendency with a time scheme; leapfrog begins anew in every window.
fn stepped<T: Tendency + 'static>(
    tendency: T,
    scheme: TimeScheme,
    time_step: Duration,
    window: Duration,
) -> Result<Arc<dyn Adjoint>, ModelError> {
    Ok(match scheme {
        TimeScheme::RungeKutta4 => Arc::new(Stepped::new(tendency, time_step, isobar_model::TimeScheme::Rk4)?),
        TimeScheme::SspRungeKutta3 => Arc::new(Stepped::new(tendency, time_step, isobar_model::TimeScheme::SspRk3)?),
        TimeScheme::Leapfrog { robert_filter } => {
            let steps = window.steps_of(time_step).expect("the scenario's window fits its steps");
            Arc::new(RestartedLeapfrog::new(Leapfrog::new(tendency, time_step, robert_filter)?, steps)?)
        }
    })
}
