//! State-transition corrections of tiles against the dense least-squares solution of all cycles at once.

use super::whole::Whole;
use crate::common::{WINDOW, calibration, constant, factor, model, parameters, problem, volume_settings, window};
use isobar_assim::time_volume::{
    Candidate, CorrectionPattern, Corrections, Target, TimeShape, TimeVolume, TimeVolumeSettings, tile_patterns,
};
use isobar_assim::{Assimilator, Error, Problem};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Adjoint, Duration, Layout, Model, State, TangentLinear};
use isobar_obs::ObservationWindow;
use std::sync::Arc;

/// A model with a source, x(t + 6 h) = A x(t) + θ f, so that M does not depend on the state.
struct WithSource {
    base: Arc<dyn Adjoint>,
    /// θ f.
    source: Vec<f64>,
}

impl Model for WithSource {
    fn layout(&self) -> &Arc<Layout> {
        self.base.layout()
    }
    fn time_step(&self) -> Duration {
        self.base.time_step()
    }
    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.base.largest_time_step_s(x)
    }
    fn step(&self, x: &mut State) {
        self.base.step(x);
        x.values_mut().iter_mut().zip(&self.source).for_each(|(value, source)| *value += source);
    }
}

impl TangentLinear for WithSource {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        self.base.step_tl(at, columns);
    }
}

/// Errors of θ.
struct Sources {
    base: Arc<dyn Adjoint>,
    source: Vec<f64>,
    candidates: Vec<Candidate>,
    /// By which patterns move that move with the flow.
    mean_flow: [f64; 2],
}

impl Corrections for Sources {
    fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        let source = self.source.iter().map(|value| corrections[0] * value).collect();
        Ok(Arc::new(WithSource { base: Arc::clone(&self.base), source }))
    }

    fn mean_flow(&self, _: &State) -> [f64; 2] {
        self.mean_flow
    }
}

/// A source of 2 ± 0.4 in h, and nothing in the other variable.
fn source(problem: &Problem) -> Vec<f64> {
    let layout = problem.background.layout();
    let cells = layout.grid.cells();
    let varied = standard_normals(&mut stream(1, "source"), cells).into_iter().map(|value| 2.0 + 0.4 * value);
    varied.chain(std::iter::repeat_n(0.0, layout.len() - cells)).collect()
}

/// Observations of a truth without any error but that of the source, with errors. The patterns move eastward by an even number of
/// columns in each window, within which they are where they are in its middle.
fn windows(
    problem: &Problem,
    patterns: &[CorrectionPattern],
    r: &[f64],
    count: usize,
    columns: usize,
) -> Vec<ObservationWindow> {
    let (source, grid) = (source(problem), problem.background.layout().grid.clone());
    let mut truth = problem.background.clone();
    let of_cycle = |cycle: usize| {
        problem.model.step(&mut truth);
        let moved = columns * cycle - columns / 2;
        for (i, value) in truth.values_mut().iter_mut().enumerate() {
            let (row, column) = (i % grid.cells() / grid.nx, i % grid.nx);
            let from = row * grid.nx + (column + grid.nx * moved - moved) % grid.nx;
            *value += patterns.iter().zip(r).map(|(pattern, r)| r * pattern.weights[from]).sum::<f64>() * source[i];
        }
        let mut observed = window(problem, 30, false, cycle, 17);
        let jacobian = observed.operator.linearize(&truth, &vec![0.0; problem.calibration.len()]).state;
        for (row, value) in observed.values.iter_mut().enumerate() {
            *value =
                0.2 * *value + jacobian.row(row).iter().map(|&(i, weight)| weight * truth.values()[i]).sum::<f64>();
        }
        observed
    };
    (1..=count).map(of_cycle).collect()
}

/// True amplitudes of four tiles.
const R: [f64; 4] = [1.0, -0.8, 0.9, -1.2];

fn volume(problem: &Problem, threshold: f64, moves_with_flow: bool, mean_flow: [f64; 2]) -> TimeVolume {
    let layout = problem.background.layout();
    let (name, unit, patterns) = ("source".to_string(), "1".to_string(), tile_patterns(&layout.grid, [2, 2]));
    let candidates = vec![Candidate { name, unit, step: 1.0, sigma_prior: None, patterns, moves_with_flow }];
    let base = Arc::new(model(layout, true, 3));
    let family = Arc::new(Sources { base, source: source(problem), candidates, mean_flow });
    let settings = TimeVolumeSettings { selection_threshold: threshold, ..volume_settings(20, Vec::new()) };
    TimeVolume::new(problem.clone(), settings, Some(family)).unwrap()
}

/// Errors that move with the flow are found by patterns that do, also after an interruption, and not by patterns that stay.
#[test]
fn patterns_that_move_with_the_flow_find_errors_that_do() {
    let problem = problem(true, calibration(2, 0, 0.0), 3);
    let grid = problem.background.layout().grid.clone();
    let flow = [2.0 * grid.dx_m / WINDOW.seconds() as f64, 0.0];
    let windows = windows(&problem, &tile_patterns(&grid, [2, 2]), &R, 12, 2);
    let found = |moves_with_flow: bool| {
        let with = || volume(&problem, 4.0, moves_with_flow, flow);
        let mut volume = with();
        for (number, observed) in windows.iter().enumerate() {
            if number == 7 {
                let memory = volume.memory().unwrap();
                volume = with();
                volume.recall(&mut &memory[..]).unwrap();
            }
            let from = volume.forecast(WINDOW).unwrap();
            volume.analyse(&from, observed).unwrap();
        }
        parameters(&volume)
    };
    for (found, r) in found(true).iter().zip(&R) {
        let sigma = found.sigma.expect("it is estimated");
        assert!((found.value - r).abs() < 3.0 * sigma && sigma < 0.2, "{found:?} and not {r}");
    }
    let errors: Vec<f64> = found(false).iter().zip(&R).map(|(found, r)| (found.value - r).abs()).collect();
    assert!(errors.iter().any(|&error| error > 0.5), "{errors:?}");
}

#[test]
fn corrections_of_tiles_are_the_least_squares_solution_of_all_cycles() {
    const CYCLES: usize = 6;
    let problem = problem(true, calibration(2, 0, 0.0), 3);
    let layout = problem.background.layout().clone();
    let (patterns, source) = (tile_patterns(&layout.grid, [2, 2]), source(&problem));
    let windows = windows(&problem, &patterns, &R, CYCLES, 0);
    // The same as factors of the model, each with the pattern w f.
    let of_tile = |tile: &CorrectionPattern| {
        let mut own = factor(&tile.name, Target::Forecast(0), TimeShape::Constant, constant(None));
        own.patterns = vec![tile.weights.iter().zip(&source).map(|(weight, value)| weight * value).collect()];
        own
    };
    let factors: Vec<_> = patterns.iter().map(of_tile).collect();
    let whole = Whole::new(&problem, &factors, &windows);
    let (exact, covariance) = whole.dense.solve();
    let with_threshold = |threshold: f64| volume(&problem, threshold, false, [0.0; 2]);
    // Nothing is chosen before the last cycle, and then everything, so far away that the cycles are run again.
    let mut volume = with_threshold(1e9);
    for observed in &windows[..CYCLES - 1] {
        let from = volume.forecast(WINDOW).unwrap();
        volume.analyse(&from, observed).unwrap();
    }
    let memory = volume.memory().unwrap();
    volume = with_threshold(0.1);
    volume.recall(&mut &memory[..]).unwrap();
    let from = volume.forecast(WINDOW).unwrap();
    let analysis = volume.analyse(&from, &windows[CYCLES - 1]).unwrap();
    for (k, found) in parameters(&volume).iter().enumerate() {
        let unknown = whole.amplitude(k);
        let (value, sigma) = (exact[(unknown, 0)], covariance[(unknown, unknown)].sqrt());
        assert_eq!(found.verdict, "determined", "{found:?}");
        assert!((found.value - value).abs() < 1e-8 * sigma, "{found:?} and not {value}");
        assert!((found.sigma.unwrap() / sigma - 1.0).abs() < 1e-8, "{found:?} and not ± {sigma}");
    }
    let spread = analysis.estimate.state_spread.as_ref().unwrap();
    for (i, value) in analysis.estimate.state.values().iter().enumerate() {
        let unknown = whole.state(CYCLES, i);
        let (expected, sigma) = (exact[(unknown, 0)], covariance[(unknown, unknown)].sqrt());
        assert!((value - expected).abs() < 1e-8 * sigma, "{i}: {value} and not {expected}");
        assert!((spread[i] / sigma - 1.0).abs() < 1e-8, "{i}: {} and not {sigma}", spread[i]);
    }
}
