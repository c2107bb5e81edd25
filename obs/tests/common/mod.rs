//! Domains, states and networks that several tests use.

use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, Duration, Grid, Layout, Location, State, Time, Variable};
use isobar_obs::{
    Network, ObservationError, ObservingSystem, Projection, RadiosondeSettings, SatelliteSettings, StationSource,
};
use std::sync::Arc;

/// Six hours.
pub const WINDOW: Duration = Duration::from_seconds(6 * 3600);

/// 2400 × 1440 km of h, u, v on the C grid, and a tracer at the centres.
pub fn layout(boundary: Boundary) -> Arc<Layout> {
    layout_of(Grid { nx: 24, ny: 18, dx_m: 1e5, dy_m: 8e4, boundary })
}

pub fn layout_of(grid: Grid) -> Arc<Layout> {
    let variable = |name, unit, location| Variable { name, long_name: name, standard_name: None, unit, location };
    let variables = vec![
        variable("h", "m", Location::Center),
        variable("u", "m s-1", Location::XFace),
        variable("v", "m s-1", Location::YFace),
        variable("tracer", "1", Location::Center),
    ];
    Arc::new(Layout { grid, variables })
}

/// Independent N(0, 1) values.
pub fn random_state(layout: &Arc<Layout>, seed: u64) -> State {
    State::from_values(layout, standard_normals(&mut stream(seed, "test state"), layout.len()))
}

/// Each variable is `field(variable, x, y)` at its points.
pub fn state_of(layout: &Arc<Layout>, field: impl Fn(usize, f64, f64) -> f64) -> State {
    let values = (0..layout.len()).map(|index| {
        let (variable, row, column) = layout.place(index);
        let location = layout.variables[variable].location;
        field(variable, layout.grid.x_m(location, column), layout.grid.y_m(location, row))
    });
    State::from_values(layout, values.collect())
}

pub fn random_stations(count: usize, groups: &[&str]) -> StationSource {
    StationSource::Random { count, groups: groups.iter().map(|&group| group.to_owned()).collect() }
}

pub fn radiosondes(count: usize) -> RadiosondeSettings {
    RadiosondeSettings::new(random_stations(count, &["a", "b", "c"]))
}

/// A satellite whose swath fits into the domain of [`layout`].
pub fn satellite() -> SatelliteSettings {
    SatelliteSettings {
        swath_width_m: 1_000e3,
        scan_positions: 11,
        footprint_sigma_m: 60e3,
        crossing_x_m: 1_200e3,
        shift_per_cycle_m: 700e3,
        ..SatelliteSettings::default()
    }
}

pub fn try_system(
    layout: &Arc<Layout>,
    projection: Option<&Projection>,
    networks: &[Network],
) -> Result<ObservingSystem, ObservationError> {
    ObservingSystem::new(layout, projection, networks, 20_190_103, WINDOW, Time::from_seconds(0))
}

pub fn system(layout: &Arc<Layout>, networks: &[Network]) -> ObservingSystem {
    try_system(layout, None, networks).unwrap()
}

/// The true biases, which are all known.
pub fn true_biases(system: &ObservingSystem) -> Vec<f64> {
    system.true_calibration().iter().map(|value| value.expect("the observations are made here")).collect()
}

/// Mean and variance about zero.
pub fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    (values.iter().sum::<f64>() / n, values.iter().map(|value| value * value).sum::<f64>() / n)
}

/// Fails unless `values` may be independent draws of N(0, 1): mean and variance within five standard errors, 1/√n and
/// √(2/n).
pub fn assert_standard_normal(values: &[f64], what: &str) {
    let (n, (mean, variance)) = (values.len() as f64, moments(values));
    assert!(mean.abs() < 5.0 / n.sqrt(), "{what}: the mean of {n} is {mean}");
    assert!((variance - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{what}: the variance of {n} is {variance}");
}
