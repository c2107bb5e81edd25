//! A model that isobar does not have, seen by an instrument that it does not have: the 40 variables of Lorenz (1996) on a
//! ring, each observed with σ = 1 every six hours, and the library's ETKF with 24 members. The root-mean-square error of the
//! analysis is 0.18; for such filters 0.18 to 0.22 are usual (Sakov and Oke 2008, Tellus A 60, 361–371).
//!
//! `cargo run --release --example own_model`

use isobar::options::RunOptions;
use isobar::output::Sink;
use isobar::progress::Progress;
use isobar::run::experiment::Experiment;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar::tables;
use isobar_model::{Duration, Layout, SpectralBounds, State, Stepped, Tendency, TimeScheme, forecast};
use isobar_obs::{Instrument, InstrumentSettings, Network, Observation, ObservationError, Site, StateOperator, Steady};
use std::{error::Error, path::Path, sync::Arc};

const POINTS: usize = 40;
/// Five days, the unit of time, in seconds.
const UNIT_S: f64 = 5.0 * 86_400.0;

/// dx_i/dt = (x_{i+1} − x_{i−2}) x_{i−1} − x_i + 8. Time schemes, their tangent-linear and adjoint come with it.
pub struct Lorenz96(pub Arc<Layout>);

/// The points i − 2, i − 1, i, i + 1.
fn points() -> impl Iterator<Item = [usize; 4]> {
    (0..POINTS).map(|i| [i + POINTS - 2, i + POINTS - 1, i, i + 1].map(|j| j % POINTS))
}

impl Tendency for Lorenz96 {
    type Linearisation = Vec<f64>;

    fn layout(&self) -> &Arc<Layout> {
        &self.0
    }

    fn tendency(&self, x: &[f64], out: &mut [f64], _: &mut [f64]) {
        points().for_each(|[a, b, i, c]| out[i] = ((x[c] - x[a]) * x[b] - x[i] + 8.0) / UNIT_S);
    }

    fn linearise(&self, at: &[f64]) -> Vec<f64> {
        at.to_vec()
    }

    fn tendency_tl(&self, at: &Vec<f64>, dx: &[f64], out: &mut [f64], _: &mut [f64]) {
        points().for_each(|[a, b, i, c]| {
            out[i] = ((dx[c] - dx[a]) * at[b] + (at[c] - at[a]) * dx[b] - dx[i]) / UNIT_S;
        });
    }

    fn tendency_ad(&self, at: &Vec<f64>, dy: &[f64], out_add: &mut [f64], _: &mut [f64]) {
        for [a, b, i, c] in points() {
            let y = dy[i] / UNIT_S;
            out_add[c] += at[b] * y;
            out_add[a] -= at[b] * y;
            out_add[b] += (at[c] - at[a]) * y;
            out_add[i] -= y;
        }
    }

    fn spectral_bounds(&self, x: &[f64]) -> SpectralBounds {
        let rows = points().map(|[a, b, _, c]| 2.0 * x[b].abs() + (x[c] - x[a]).abs());
        SpectralBounds { oscillation_per_s: rows.fold(0.0, f64::max) / UNIT_S, damping_per_s: 1.0 / UNIT_S }
    }
}

/// Sees each value of the state with σ = 1.
#[derive(Debug)]
struct Everything;

impl InstrumentSettings for Everything {
    fn build(&self, site: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError> {
        let observation = |i: usize| {
            let report = site.report(&format!("point {i}"), 0, i as f64 + 0.5, 0.5);
            Observation::new(report, 1.0, StateOperator::Linear(vec![(i, 1.0)]))
        };
        Ok(Box::new(Steady::new(site, (0..POINTS).map(observation).collect())?))
    }
}

const SCENARIO: &str = r#"
title = "Lorenz (1996) with an ETKF"
phenomenon = "Chaos on a ring of 40 points"
source = "Lorenz (1996); Sakov and Oke (2008)"
seed = 1
start = "2026-01-01T00:00:00Z"
background_error = { components = [{ kind = "white", variable = "x", sigma = 1 }] }
cycle = { count = 1000, window_hours = 6, score_from_cycle = 201 }
methods.etkf = { kind = "etkf", members = 24, inflation = 1.02 }
"#;

/// Runs the experiment.
pub fn run(options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, Box<dyn Error>> {
    let (layout, step) = (Layout::ring(POINTS, "x", "1"), Duration::from_seconds(21_600));
    let mut background = State::from_values(&layout, (0..POINTS).map(|i| 8.0 + (i as f64).sin()).collect());
    let model = Stepped::new(Lorenz96(layout), step, TimeScheme::Rk4)?;
    forecast::forecast(&model, &mut background, 500)?;
    let scenario = Scenario::parse_with_model(Path::new("own_model.toml"), SCENARIO, model, background)?;
    Ok(Experiment::builder(&scenario).network(Network::new("everything", Everything)).run(options, listener)?)
}

#[allow(dead_code)]
fn main() -> Result<(), Box<dyn Error>> {
    let directory = tempfile::tempdir()?;
    let summary = run(&RunOptions::new(directory.path().join("own_model")), &mut Progress::new(true))?;
    println!("{}", tables::scores::on_terminal(&summary, &[("x", "1")], tables::WIDTH));
    Ok(())
}
