//! The experiment on which all methods are measured: linear shallow water on a doubly periodic plane of square cells of
//! 200 km, cycles of 3 hours in 18 steps, as in the scenario `fkf_linear`, and point observations at random places: every
//! second one is of a sonde, of h, u and v in turn, the others are soundings of h. The observations of h have biases in common.

use crate::common::covariance;
use isobar_assim::{BiasTreatment, Problem};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Boundary, Duration, Grid, Layout, LinearShallowWater, Location, ShallowWater, ShallowWaterParameters, State,
    Stepped, Time, TimeScheme, VectorInvariant,
};
use isobar_obs::{
    Calibration, Drift, Jacobian, LinearOperator, ObservationWindow, Parameter, Placement, Report, SparseRows,
};
use rand::RngExt;
use std::sync::Arc;

const SPACING_M: f64 = 2e5;
pub const WINDOW: Duration = Duration::from_seconds(3 * 3600);
const TIME_STEP: Duration = Duration::from_seconds(600);
pub const STEPS: usize = 18;

/// The observing systems; the names of their biases begin with these.
pub const SYSTEMS: [&str; 2] = ["sondes", "polar"];

/// With `side` × `side` cells.
pub fn problem(side: usize, observations: usize) -> Problem {
    let grid = Grid { nx: side, ny: side, dx_m: SPACING_M, dy_m: SPACING_M, boundary: Boundary::Periodic };
    let parameters =
        ShallowWaterParameters { gravity_m_per_s2: 9.8, coriolis_per_s: 1e-4, ..ShallowWaterParameters::default() };
    let equations = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).expect("a model");
    let equations = LinearShallowWater::about_uniform_flow(equations, 1000.0, 20.0).expect("a flow");
    let model = Stepped::new(equations, TIME_STEP, TimeScheme::Rk4).expect("a scheme");
    let layout = isobar_model::Model::layout(&model).clone();
    Problem {
        model: Arc::new(model),
        background: State::zeros(&layout),
        background_error: covariance(&layout, 20.0, 8e5, 3.0),
        model_error: Some(covariance(&layout, 2.0, 5e5, 0.3)),
        calibration: calibration(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 16 << 30,
        most_observations: observations,
    }
}

fn calibration() -> Calibration {
    let parameter = |name: &str| Parameter {
        name: name.into(),
        unit: "m".into(),
        placement: Placement::Shared,
        sigma_prior: 8.0,
        drift: Drift::RandomWalk { sigma_per_sqrt_day: 0.09 },
    };
    Calibration { parameters: ["sondes/h", "polar/offset"].map(parameter).to_vec(), ..Calibration::default() }
}

/// The observations of a cycle. Their values have no influence on the cost.
pub fn observations(layout: &Layout, count: usize, cycle: usize) -> ObservationWindow {
    let (random, cells) = (&mut stream(1, &format!("places {cycle}")), layout.grid.cells());
    let (mut state, mut calibration, mut reports) = (SparseRows::new(), SparseRows::new(), Vec::new());
    for number in 0..count {
        let system = number % 2;
        let variable = if system == 0 { number / 2 % 3 } else { 0 };
        let location = [Location::Center, Location::XFace, Location::YFace][variable];
        let (x_m, y_m) =
            (random.random::<f64>() * layout.grid.width_m(), random.random::<f64>() * layout.grid.height_m());
        let stencil = layout.grid.stencil(location, x_m, y_m).expect("a point of the domain");
        state.push_row(stencil.entries.into_iter().map(|(cell, weight)| (variable * cells + cell, weight)));
        calibration.push_row((variable == 0).then_some((system, 1.0)));
        let (network, platform) = (SYSTEMS[system].into(), "point".into());
        reports.push(Report { network, platform, variable, x_m, y_m, scan: None });
    }
    let sigma: Vec<f64> = reports.iter().map(|report| if report.variable == 0 { 5.0 } else { 2.0 }).collect();
    let time = Time::from_seconds(cycle as i64 * WINDOW.seconds());
    ObservationWindow {
        time,
        cycle,
        reports,
        times: vec![time; count],
        values: standard_normals(random, count)
            .iter()
            .zip(&sigma)
            .map(|(normal, sigma)| 3.0 * sigma * normal)
            .collect(),
        sigma,
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
    }
}
