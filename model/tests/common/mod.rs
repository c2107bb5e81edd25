//! What several tests set up alike.

use isobar_model::initial::{self, HeightPerturbation, JetConfig, RandomConfig};
use isobar_model::random::stream;
use isobar_model::{
    Boundary, Duration, Grid, ShallowWater, ShallowWaterParameters, State, Stepped, TimeScheme, VectorInvariant,
};

pub const BOUNDARIES: [Boundary; 2] = [Boundary::Periodic, Boundary::Channel];
pub const FORMS: [VectorInvariant; 2] = [VectorInvariant::PotentialEnstrophy, VectorInvariant::Energy];
pub const SCHEMES: [TimeScheme; 2] = [TimeScheme::Rk4, TimeScheme::SspRk3];

pub fn grid(nx: usize, ny: usize, boundary: Boundary) -> Grid {
    Grid { nx, ny, dx_m: 100e3, dy_m: 80e3, boundary }
}

pub fn parameters(boundary: Boundary) -> ShallowWaterParameters {
    ShallowWaterParameters {
        gravity_m_per_s2: 9.81,
        coriolis_per_s: 1e-4,
        beta_per_m_per_s: if boundary == Boundary::Channel { 1.6e-11 } else { 0.0 },
        ..Default::default()
    }
}

pub fn shallow_water(nx: usize, ny: usize, boundary: Boundary, form: VectorInvariant) -> ShallowWater {
    ShallowWater::new(grid(nx, ny, boundary), parameters(boundary), form).unwrap()
}

pub fn jet(model: &ShallowWater) -> JetConfig {
    let height_m = isobar_model::Tendency::layout(model).grid.height_m();
    JetConfig {
        mean_depth_m: 1000.0,
        speed_m_per_s: 30.0,
        center_y_m: 0.5 * height_m,
        width_m: 0.12 * height_m,
        perturbation: None,
    }
}

pub fn perturbed_jet(model: &ShallowWater) -> State {
    let grid = &isobar_model::Tendency::layout(model).grid;
    let perturbation = Some(HeightPerturbation {
        amplitude_m: 40.0,
        center_x_m: 0.3 * grid.width_m(),
        center_y_m: 0.45 * grid.height_m(),
        width_x_m: 0.1 * grid.width_m(),
        width_y_m: 0.1 * grid.height_m(),
    });
    initial::geostrophic_jet(model, &JetConfig { perturbation, ..jet(model) }).unwrap()
}

pub fn turbulence(model: &ShallowWater) -> State {
    let config = RandomConfig { mean_depth_m: 1000.0, height_standard_deviation_m: 25.0, length_scale_m: 300e3 };
    initial::random_balanced(model, &config, &mut stream(7, "test/turbulence")).unwrap()
}

pub fn stepped<T: isobar_model::Tendency>(tendency: T, step_s: i64, scheme: TimeScheme) -> Stepped<T> {
    Stepped::new(tendency, Duration::from_seconds(step_s), scheme).unwrap()
}

/// Root of the sum of squares.
pub fn norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

pub fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

pub fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |largest, value| value.abs().max(largest))
}
