//! A method that isobar does not have: the deterministic ensemble Kalman filter (DEnKF) of Sakov and Oke (2008, Tellus A 60,
//! 361–371), beside a free run and the library's ETKF.
//!
//! `cargo run --release --example own_method`

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Scale, Side};
use isobar::options::RunOptions;
use isobar::progress::Progress;
use isobar::run::experiment::{Experiment, ExperimentBuilder};
use isobar::scenario::Scenario;
use isobar::tables;
use isobar_assim::Error;
use isobar_assim::ensemble::{EnsembleFilter, EnsembleSettings, EnsembleTransform, EnsembleWeights};
use std::path::Path;

/// The mean is updated with the gain K = P Hᵀ (H P Hᵀ + R)⁻¹ and the perturbations with K/2, which gives them the right
/// covariance where observations are weak, without perturbing these. Any method can be added as an `Assimilator`; for an
/// analysis in the space of the ensemble the library has the rest.
#[derive(Clone)]
pub struct DeterministicEnkf;

impl EnsembleTransform for DeterministicEnkf {
    /// w = (I + Ỹᵀ Ỹ)⁻¹ Ỹᵀ d̃ and W = I − ½ (I + Ỹᵀ Ỹ)⁻¹ Ỹᵀ Ỹ.
    fn weights(&self, y: MatRef<'_, f64>, d: MatRef<'_, f64>) -> Result<EnsembleWeights, Error> {
        let products = y.transpose() * y;
        let identity = Mat::<f64>::identity(y.ncols(), y.ncols());
        let system = (&identity + &products).llt(Side::Lower);
        let system = system.map_err(|_| Error::NotFinite { what: "the ensemble".into() })?;
        let mean = system.solve(y.transpose() * d);
        Ok(EnsembleWeights { mean, perturbations: identity - Scale(0.5) * system.solve(products) })
    }
}

const SCENARIO: &str = r#"
title = "A method that is not in the list"
phenomenon = "A jet seen by a few radiosondes without bias"
source = "Sakov and Oke (2008)"
seed = 1
start = "2026-01-15T00:00:00Z"
grid = { nx = 12, ny = 8, dx_km = 200, boundary = "channel" }
model = { kind = "shallow_water", time_step_s = 1200, coriolis_per_s = 1e-4 }
initial = { kind = "jet", mean_depth_m = 1000, speed_m_per_s = 20, width_km = 400 }
background_error = { components = [{ kind = "balanced", sigma_height_m = 20, length_km = 600 }] }
cycle = { count = 20, window_hours = 6, score_from_cycle = 5 }
networks.sondes = { kind = "radiosonde", stations = { regular = [4, 3] }, sigma_height_m = 12, sigma_wind_m_per_s = 2.2 }
methods.free = { kind = "free" }
methods.etkf = { kind = "etkf", members = 40 }
"#;

/// The experiment without the method.
pub fn scenario() -> Scenario {
    Scenario::parse(Path::new("own_method.toml"), SCENARIO).expect("a valid scenario")
}

/// The experiment with it.
pub fn experiment(scenario: &Scenario) -> ExperimentBuilder<'_> {
    Experiment::builder(scenario).method("denkf", "deterministic ensemble Kalman filter with 40 members", |problem| {
        EnsembleFilter::by(DeterministicEnkf, problem, EnsembleSettings::new(40, 1.03))
    })
}

#[allow(dead_code)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (directory, scenario) = (tempfile::tempdir()?, scenario());
    let options = RunOptions::new(directory.path().join("own_method"));
    let summary = experiment(&scenario).run(&options, &mut Progress::new(true))?;
    println!("{}", tables::scores::on_terminal(&summary, scenario.model.variables(), tables::WIDTH));
    Ok(())
}
