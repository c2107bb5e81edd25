//! `[initial]` as a state.

use super::forecast_model::shallow_water;
use crate::scenario::{Dynamics, Initial, ModelSettings};
use isobar_model::initial::{
    CosineWave, GaussianHill, HeightPerturbation, JetConfig, RandomConfig, Vortex, cosine_wave, gaussian_hills,
    geostrophic_jet, random_balanced, rest, vortices,
};
use isobar_model::random::stream;
use isobar_model::{Grid, ModelError, ShallowWater, State, advection};
use rand::RngExt;

pub(super) fn build(initial: &Initial, model: &ModelSettings, grid: &Grid, seed: u64) -> Result<State, ModelError> {
    if let Initial::File(values) = initial {
        let layout = match model.is_shallow_water() {
            true => isobar_model::shallow_water::layout(grid.clone()),
            false => advection::layout(grid.clone()),
        };
        return Ok(State::from_values(&layout, values.clone()));
    }
    match &model.dynamics {
        Dynamics::ShallowWater(settings) => balanced(initial, &shallow_water(settings, grid)?, seed),
        Dynamics::LinearShallowWater { settings, mean_flow_m_per_s, mean_flow_y_m_per_s, .. } => {
            // The initial state deviates from the flow about which the model is linearised.
            let mut state = balanced(initial, &shallow_water(settings, grid)?, seed)?;
            if let Some(u) = state.layout().variable("u") {
                state.field_mut(u).iter_mut().for_each(|u| *u += mean_flow_m_per_s);
            }
            if let Some(v) = state.layout().variable("v") {
                state.field_mut(v).iter_mut().for_each(|v| *v += mean_flow_y_m_per_s);
            }
            Ok(state)
        }
        Dynamics::Advection { .. } | Dynamics::ExactShift { .. } => tracer(initial, grid),
    }
}

fn balanced(initial: &Initial, model: &ShallowWater, seed: u64) -> Result<State, ModelError> {
    use isobar_model::Tendency;
    let grid = &model.layout().grid;
    let random = &mut stream(seed, "initial state");
    match *initial {
        Initial::Rest { mean_depth_m } => rest(model, mean_depth_m),
        Initial::Jet {
            mean_depth_m,
            speed_m_per_s,
            width_m,
            center_y_fraction,
            perturbation_height_m,
            perturbation_width_m,
        } => {
            let center_y_m = center_y_fraction * grid.height_m();
            let bump = HeightPerturbation {
                amplitude_m: perturbation_height_m,
                center_x_m: 0.5 * grid.width_m(),
                center_y_m,
                width_x_m: perturbation_width_m,
                width_y_m: perturbation_width_m,
            };
            let perturbation = (perturbation_height_m != 0.0).then_some(bump);
            geostrophic_jet(model, &JetConfig { mean_depth_m, speed_m_per_s, center_y_m, width_m, perturbation })
        }
        Initial::Vortices { mean_depth_m, count, height_m, radius_m } => {
            let all: Vec<Vortex> = (0..count)
                .map(|number| Vortex {
                    center_x_m: random.random::<f64>() * grid.width_m(),
                    center_y_m: random.random::<f64>() * grid.height_m(),
                    amplitude_m: if number % 2 == 0 { height_m } else { -height_m },
                    radius_m,
                })
                .collect();
            vortices(model, mean_depth_m, &all)
        }
        Initial::RandomBalanced { mean_depth_m, sigma_height_m, length_m } => {
            let config =
                RandomConfig { mean_depth_m, height_standard_deviation_m: sigma_height_m, length_scale_m: length_m };
            random_balanced(model, &config, random)
        }
        Initial::GaussianHill { .. } | Initial::CosineWave { .. } | Initial::File(_) => {
            unreachable!("the scenario's reader refuses tracers for shallow water, and files are read before")
        }
    }
}

fn tracer(initial: &Initial, grid: &Grid) -> Result<State, ModelError> {
    let layout = advection::layout(grid.clone());
    match *initial {
        Initial::GaussianHill { amplitude, width_m, center_x_fraction, center_y_fraction } => {
            let hill = GaussianHill {
                center_x_m: center_x_fraction * grid.width_m(),
                center_y_m: center_y_fraction * grid.height_m(),
                amplitude,
                radius_m: width_m,
            };
            gaussian_hills(&layout, 0.0, &[hill])
        }
        Initial::CosineWave { mean, amplitude, waves_x, waves_y, phase_deg } => {
            let wave = CosineWave { mean, amplitude, waves_x, waves_y, phase: phase_deg.to_radians() };
            cosine_wave(&layout, &wave)
        }
        Initial::Rest { .. }
        | Initial::Jet { .. }
        | Initial::Vortices { .. }
        | Initial::RandomBalanced { .. }
        | Initial::File(_) => {
            unreachable!(
                "the scenario's reader refuses states of shallow water for a tracer, and files are read before"
            )
        }
    }
}
