//! An instrument that isobar does not have: anemometers that see the speed √(u² + v²) of the wind, which is not linear in the
//! state, and have one bias in common, which a Fast Kalman Filter estimates with the state.
//!
//! `cargo run --release --example own_instrument`

use isobar::options::RunOptions;
use isobar::output::Sink;
use isobar::progress::Progress;
use isobar::run::experiment::Experiment;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar::tables;
use isobar_model::State;
use isobar_obs::{
    BiasProcess, Instrument, InstrumentSettings, Network, NonlinearOperator, Observation, ObservationError, Placement,
    Site, StateOperator, Steady,
};
use std::{error::Error, path::Path};

/// h(x) = √(u² + v²) at a point, with u and v interpolated to it: weights of values of the state.
#[derive(Debug)]
struct WindSpeed {
    u: StateOperator,
    v: StateOperator,
}

impl NonlinearOperator for WindSpeed {
    fn value(&self, x: &State) -> f64 {
        self.u.value(x).hypot(self.v.value(x))
    }

    /// ∂h/∂x = (u ∂u/∂x + v ∂v/∂x)/h; the library transposes it.
    fn gradient(&self, x: &State) -> Vec<(usize, f64)> {
        let speed = self.value(x).max(f64::MIN_POSITIVE);
        let part = |component: &StateOperator| {
            let factor = component.value(x) / speed;
            component.gradient(x).iter().map(|&(index, weight)| (index, factor * weight)).collect::<Vec<_>>()
        };
        [part(&self.u), part(&self.v)].concat()
    }
}

/// Anemometers in rows and columns of equal number.
#[derive(Debug)]
pub struct Anemometers(pub usize);

impl InstrumentSettings for Anemometers {
    fn build(&self, site: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError> {
        let bias = site.add_bias("speed", "m/s", Placement::Shared, &BiasProcess::constant(2.0))?;
        let (layout, places) = (site.layout, (0..self.0 * self.0).map(|number| (number % self.0, number / self.0)));
        let fraction = |place: usize| (place as f64 + 0.5) / self.0 as f64;
        let observation = |(column, row): (usize, usize)| {
            let (x_m, y_m) = (fraction(column) * layout.grid.width_m(), fraction(row) * layout.grid.height_m());
            let component =
                |variable| StateOperator::Linear(layout.interpolation(variable, x_m, y_m).unwrap_or_default());
            let speed = StateOperator::nonlinear(WindSpeed { u: component(1), v: component(2) });
            // Its unit and place in tables are those of u.
            let report = site.report(&format!("mast {column}/{row}"), 1, x_m, y_m);
            Observation::new(report, 1.0, speed).with_bias(bias.map(|number| (number, 1.0)))
        };
        Ok(Box::new(Steady::new(site, places.map(observation).collect())?))
    }
}

const SCENARIO: &str = r#"
title = "An instrument that is not in the list"
phenomenon = "A jet seen by anemometers with a bias"
source = "isobar"
seed = 1
start = "2026-01-15T00:00:00Z"
grid = { nx = 12, ny = 8, dx_km = 200, boundary = "channel" }
model = { kind = "shallow_water", time_step_s = 1200, coriolis_per_s = 1e-4 }
initial = { kind = "jet", mean_depth_m = 1000, speed_m_per_s = 20, width_km = 400 }
background_error = { components = [{ kind = "balanced", sigma_height_m = 20, length_km = 600 }] }
cycle = { count = 20, window_hours = 6, score_from_cycle = 5 }
methods.free = { kind = "free" }
methods.fkf = { kind = "fkf", factors = 60 }
"#;

/// Runs the experiment.
pub fn run(options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, Box<dyn Error>> {
    let scenario = Scenario::parse(Path::new("own_instrument.toml"), SCENARIO)?;
    Ok(Experiment::builder(&scenario).network(Network::new("masts", Anemometers(5))).run(options, listener)?)
}

#[allow(dead_code)]
fn main() -> Result<(), Box<dyn Error>> {
    let directory = tempfile::tempdir()?;
    let summary = run(&RunOptions::new(directory.path().join("own_instrument")), &mut Progress::new(true))?;
    println!("{}", tables::scores::on_terminal(&summary, &[("h", "m"), ("u", "m s-1"), ("v", "m s-1")], tables::WIDTH));
    Ok(())
}
