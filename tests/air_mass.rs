//! Biases that depend on the state, estimated with the predictors of each method's own background.

use isobar::event::Event;
use isobar::options::RunOptions;
use isobar::output::{Sink, SinkError};
use isobar::scenario::Scenario;
use std::path::Path;

const SEEDS: u64 = 8;
const CYCLES: usize = 24;

/// True β, and estimate and claimed spread of each method, in the last cycle.
#[derive(Default)]
struct Last {
    truth: f64,
    estimates: Vec<(f64, f64)>,
}

impl Sink for Last {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Truth { cycle: CYCLES, calibration, .. } => self.truth = calibration[2].unwrap(),
            Event::Analysed(it) if it.cycle == CYCLES => {
                let estimate = &it.analysis.estimate;
                self.estimates.push((estimate.calibration[2], estimate.calibration_spread.as_ref().unwrap()[2]));
            }
            _ => {}
        }
        Ok(())
    }
}

/// The Kalman filters to within what they claim, over all seeds together; 3D-Var, whose static covariance claims too much of
/// every bias, to within a third of the prior's standard deviation in each.
#[test]
fn the_coefficient_is_recovered() {
    let shipped = include_str!("../scenarios/air_mass_bias.toml").split("[methods.free]").next().unwrap();
    let smaller = shipped.replace("nx = 20", "nx = 13").replace("ny = 14", "ny = 10");
    let drawn = smaller.replace("value = 8\nassumed_sigma = 30", "sigma = 10");
    assert!(drawn.contains("nx = 13\nny = 10") && drawn.contains("sigma = 10\n"));
    let methods = "[methods]\nvar = { kind = \"3dvar\", covariance_scale = 0.08 }\nkf = { kind = \"kf\" }\n\
                   fkf = { kind = \"fkf\", factors = 60 }\n";
    let scenario = Scenario::parse(Path::new("air_mass.toml"), &(drawn + methods)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let mut squares = [0.0; 3];
    for seed in 0..SEEDS {
        let own = directory.path().join(seed.to_string());
        let options = RunOptions { seed: Some(seed), ..crate::runs::run_options(&own, CYCLES) };
        let mut last = Last::default();
        isobar::run::run(&scenario, &options, &mut last).unwrap();
        for (number, (estimate, spread)) in last.estimates.iter().enumerate() {
            let error = estimate - last.truth;
            println!("seed {seed}, method {number}: {error:.2} of {:.2} ± {spread:.2}", last.truth);
            assert!(*spread < 1.5, "the prior has 10 m: {spread}");
            assert!(error.abs() < 10.0 / 3.0, "seed {seed}, method {number}: {error}");
            squares[number] += (error / spread).powi(2) / SEEDS as f64;
        }
    }
    println!("mean squares of normalised errors: {squares:.2?}");
    // A χ² variable of eight degrees of freedom is above 3.27 times its mean in one of a thousand cases.
    assert!(squares[1] < 3.27 && squares[2] < 3.27, "{squares:?}");
}
