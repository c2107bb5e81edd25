//! How to run a method of your own with those of a scenario. Here it is the deterministic ensemble Kalman filter (DEnKF) of
//! Sakov and Oke (2008, Tellus A 60, 361–371), without localisation.
//!
//! ```sh
//! cargo run --release --example own_method
//! ```

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use isobar::options::RunOptions;
use isobar::output::Sink;
use isobar::progress::Progress;
use isobar::run::RunError;
use isobar::run::experiment::Experiment;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar::tables;
use isobar_assim::{Analysis, Assimilator, Background, Error, Estimate, Problem, covariance};
use isobar_model::random::stream;
use isobar_model::vector::{add, difference};
use isobar_model::{Duration, State, forecast};
use isobar_obs::ObservationWindow;
use std::path::Path;

/// The DEnKF for a perfect model and unbiased observations.
#[derive(Clone)]
struct DeterministicEnkf {
    problem: Problem,
    /// The factor on deviations from the mean after each analysis.
    inflation: f64,
    members: Vec<State>,
}

impl DeterministicEnkf {
    /// Members drawn about the background, with deviations from N(0, B).
    fn new(problem: Problem, members: usize, inflation: f64) -> Self {
        let mut random = stream(1, "own method/members");
        let draw = |_| {
            let mut member = problem.background.clone();
            add(member.values_mut(), &covariance::randomize(&*problem.background_error, &mut random));
            member
        };
        Self { members: (0..members).map(draw).collect(), inflation, problem }
    }

    /// The mean, and the members' deviations from it, `[m, N]`.
    fn moments(&self) -> (State, Mat<f64>) {
        let count = self.members.len();
        let values: Vec<&[f64]> = self.members.iter().map(State::values).collect();
        let mean: Vec<f64> =
            (0..values[0].len()).map(|i| values.iter().map(|member| member[i]).sum::<f64>() / count as f64).collect();
        let deviations = Mat::from_fn(mean.len(), count, |i, j| values[j][i] - mean[i]);
        (State::from_values(self.problem.background.layout(), mean), deviations)
    }

    fn estimate(&self) -> Estimate {
        let (state, deviations) = self.moments();
        let degrees = (self.members.len() - 1) as f64;
        let spread = deviations.row_iter().map(|row| (row * row.transpose() / degrees).sqrt()).collect();
        let calibration = vec![0.0; self.problem.calibration.len()];
        Estimate { state, calibration, state_spread: Some(spread), calibration_spread: None }
    }
}

impl Assimilator for DeterministicEnkf {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        let model = &*self.problem.model;
        let steps = window.steps_of(model.time_step()).ok_or_else(|| Error::Setting("part of a time step".into()))?;
        self.members.iter_mut().try_for_each(|member| forecast::forecast(model, member, steps))?;
        Ok(Background { estimate: self.estimate(), window })
    }

    /// The mean is updated with the gain K = P Hᵀ (H P Hᵀ + R)⁻¹ and the deviations A with K/2, which gives them the right
    /// covariance where the observations are weak, without perturbing observations. With S = R^-½ H A and z = R^-½ d,
    ///
    /// ```text
    /// K d = A w,      w = ((N − 1) I + Sᵀ S)⁻¹ Sᵀ z
    /// K H A = A W,    W = ((N − 1) I + Sᵀ S)⁻¹ Sᵀ S
    /// ```
    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let count = self.members.len();
        let calibration = &from.estimate.calibration;
        let (mean, deviations) = self.moments();
        let simulated = observed.operator.simulate(&mean, calibration);
        let background_departures = difference(&observed.values, &simulated);
        let of_members: Vec<Vec<f64>> =
            self.members.iter().map(|member| observed.operator.simulate(member, calibration)).collect();
        let s = Mat::from_fn(observed.len(), count, |i, j| (of_members[j][i] - simulated[i]) / observed.sigma[i]);
        let z = Mat::from_fn(observed.len(), 1, |i, _| background_departures[i] / observed.sigma[i]);
        let products = s.transpose() * &s;
        let system = Mat::<f64>::identity(count, count) * ((count - 1) as f64) + &products;
        let cholesky = system.llt(Side::Lower).map_err(|_| Error::NotFinite { what: "the ensemble".into() })?;
        let mean_weights = cholesky.solve(s.transpose() * &z);
        let weights = cholesky.solve(&products);
        let innovation_chi2 = (z.transpose() * (&z - &s * &mean_weights))[(0, 0)];
        let transform = Mat::from_fn(count, count, |i, j| {
            let kept = if i == j { 1.0 } else { 0.0 };
            mean_weights[(i, 0)] + self.inflation * (kept - 0.5 * weights[(i, j)])
        });
        let increments = deviations * transform;
        for (j, member) in self.members.iter_mut().enumerate() {
            *member = mean.clone();
            add(member.values_mut(), increments.col_as_slice(j));
        }
        let estimate = self.estimate();
        let analysed = observed.operator.simulate(&estimate.state, calibration);
        Ok(Analysis {
            analysis_departures: difference(&observed.values, &analysed),
            estimate,
            background_departures,
            innovation_chi2: Some(innovation_chi2),
            partition: None,
            warnings: Vec::new(),
        })
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn memory(&self) -> Result<Vec<u8>, Error> {
        postcard::to_stdvec(&self.members).map_err(|error| Error::Memory { reason: error.to_string() })
    }

    fn recall(&mut self, memory: &[u8]) -> Result<(), Error> {
        let members: Vec<State> =
            postcard::from_bytes(memory).map_err(|error| Error::Memory { reason: error.to_string() })?;
        let layout = self.problem.background.layout();
        if members.len() != self.members.len() || members.iter().any(|member| member.layout() != layout) {
            return Err(Error::Memory { reason: "the members do not fit the experiment".into() });
        }
        self.members = members;
        Ok(())
    }
}

const SCENARIO: &str = r#"
title = "A method of one's own"
phenomenon = "A jet seen by a few radiosondes without bias"
source = "Sakov and Oke (2008)"
seed = 1
start = "2026-01-15T00:00:00Z"

[grid]
nx = 12
ny = 8
dx_km = 200
boundary = "channel"

[model]
kind = "shallow_water"
time_step_s = 1200
coriolis_per_s = 1e-4

[initial]
kind = "jet"
mean_depth_m = 1000
speed_m_per_s = 20
width_km = 400

[background_error]
components = [{ kind = "balanced", sigma_height_m = 20, length_km = 600 }]

[cycle]
count = 20
window_hours = 6
score_from_cycle = 5

[networks.sondes]
kind = "radiosonde"
stations = { regular = [4, 3] }
sigma_height_m = 12
sigma_wind_m_per_s = 2.2

[methods.free]
kind = "free"

[methods.etkf]
kind = "etkf"
members = 40
"#;

fn scenario() -> Scenario {
    Scenario::parse(Path::new("own_method.toml"), SCENARIO).expect("a valid scenario")
}

/// Runs the methods of the scenario and the DEnKF.
fn run(options: &RunOptions, listener: &mut dyn Sink) -> Result<Summary, RunError> {
    Experiment::builder(&scenario())
        .method("denkf", "deterministic ensemble Kalman filter with 40 members", |problem| {
            Ok(Box::new(DeterministicEnkf::new(problem, 40, 1.03)))
        })
        .run(options, listener)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let directory = tempfile::tempdir()?;
    let options = RunOptions::new(directory.path().join("own_method"));
    let summary = run(&options, &mut Progress::new(true))?;
    println!("{}", tables::scores::on_terminal(&summary, scenario().model.variables()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar::event::Event;
    use isobar::options::CheckpointPolicy;
    use isobar::output::SinkError;

    /// A listener that ends the run in cycle 10.
    struct EndEarly;

    impl Sink for EndEarly {
        fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
            match event {
                Event::Observed { window, .. } if window.cycle == 10 => {
                    Err(SinkError { path: "nothing".into(), reason: "this is the end".into() })
                }
                _ => Ok(()),
            }
        }
    }

    /// All scores of the DEnKF but those of cost.
    fn scores(summary: &Summary) -> Vec<(&str, f64)> {
        let values = summary.methods["denkf"].values.iter().map(|(key, value)| (key.as_str(), *value));
        values.filter(|(key, _)| ["rmse", "spread", "innovation"].iter().any(|it| key.starts_with(it))).collect()
    }

    #[test]
    fn the_filter_beats_the_free_run_and_goes_on_after_an_interruption() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| RunOptions { threads: Some(2), ..RunOptions::new(directory.path().join(name)) };
        let summary = run(&at("whole"), &mut Progress::new(true)).unwrap();
        assert_eq!(summary.methods.keys().collect::<Vec<_>>(), ["free", "etkf", "denkf"]);
        let score = |method: &str, key: &str| summary.methods[method].values[key];
        for variable in ["h", "u", "v"] {
            let key = format!("rmse_analysis.{variable}");
            let (free, denkf) = (score("free", &key), score("denkf", &key));
            assert!(denkf.is_finite() && denkf < 0.5 * free, "{key}: {denkf} against {free}");
        }
        let chi2 = score("denkf", "innovation_chi2");
        assert!((0.7..1.3).contains(&chi2), "{chi2}");

        let checkpoints = Some(CheckpointPolicy { minutes: None, cycles: Some(4) });
        let options = RunOptions { checkpoints, ..at("interrupted") };
        run(&options, &mut EndEarly).unwrap_err();
        let options = RunOptions { resume: true, ..options };
        let without = isobar::run::run(&scenario(), &options, &mut Progress::new(true)).unwrap_err().to_string();
        assert!(without.contains("other methods were added"), "{without}");
        let resumed = run(&options, &mut Progress::new(true)).unwrap();
        assert!(scores(&summary).len() > 6);
        assert_eq!(scores(&resumed), scores(&summary));
    }

    #[test]
    fn a_name_that_is_taken_or_not_valid_is_refused() {
        let scenario = scenario();
        for (name, reason) in [("etkf", "two methods"), ("ETKF", "in case only"), ("my method", "cannot be the name")] {
            let builder = Experiment::builder(&scenario)
                .method(name, "", |problem| Ok(Box::new(DeterministicEnkf::new(problem, 4, 1.0))));
            let error = builder.build(&RunOptions::new("nowhere")).err().unwrap().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}
