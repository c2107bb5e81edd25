//! State-transition corrections: a tracer that the truth carries faster than the model does.

use crate::common::{WINDOW, parameters, settings};
use isobar_assim::covariance::{Sum, Univariate, White, randomize};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::time_volume::{Candidate, Corrections, TimeVolume, TimeVolumeSettings, tile_patterns};
use isobar_assim::{Assimilator, BiasTreatment, Covariance, Error, Problem};
use isobar_model::random::stream;
use isobar_model::{
    Advection, AdvectionScheme, Boundary, Duration, Grid, Layout, Model, State, Stepped, TangentLinear, Time,
    TimeScheme, Wind, advection, forecast,
};
use isobar_obs::{
    BiasProcess, BiasScope, Network, ObservedVariable, ObservingSystem, RadiosondeSettings, StationBias, StationSource,
};
use std::sync::Arc;

const STEP: Duration = Duration::from_seconds(3600);

fn model(u_m_per_s: f64, v_m_per_s: f64) -> Stepped<Advection> {
    let grid = Grid { nx: 16, ny: 12, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    let scheme = AdvectionScheme::FourthOrderCentred;
    let tendency = Advection::new(grid, &Wind::Uniform { u_m_per_s, v_m_per_s }, scheme).unwrap();
    Stepped::new(tendency, STEP, TimeScheme::Rk4).unwrap()
}

/// Errors of either component of the wind, (5, 0) m/s of which the model has.
struct Winds([Candidate; 2]);

impl Winds {
    /// The same everywhere, or of tiles.
    fn new(tiles: Option<[usize; 2]>) -> Self {
        let grid = &model(5.0, 0.0).layout().grid.clone();
        let candidate = |name: &str| Candidate {
            name: name.into(),
            unit: "m s-1".into(),
            step: 0.05,
            sigma_prior: None,
            patterns: tiles.map_or(Vec::new(), |tiles| tile_patterns(grid, tiles)),
            moves_with_flow: false,
        };
        Self([candidate("u"), candidate("v")])
    }
}

impl Corrections for Winds {
    fn candidates(&self) -> &[Candidate] {
        &self.0
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        Ok(Arc::new(model(5.0 + corrections[0], corrections[1])))
    }
}

struct World {
    problem: Problem,
    observing: ObservingSystem,
    truth: State,
    model_error: Arc<dyn Covariance>,
    random: rand_chacha::ChaCha8Rng,
}

fn world(seed: u64) -> World {
    let own = model(5.0, 0.0);
    let layout: Arc<Layout> = own.layout().clone();
    assert_eq!(*layout, *advection::layout(layout.grid.clone()));
    let mut network =
        RadiosondeSettings::new(StationSource::Random { count: 40, groups: vec!["A".into(), "B".into()] });
    network.variables = vec![ObservedVariable::new("tracer", 0.3)];
    network.reference_groups = vec!["A".into()];
    network.biases = vec![StationBias {
        variable: "tracer".into(),
        scope: BiasScope::EachGroup,
        process: BiasProcess::constant(1.0),
    }];
    let configs = [Network::new("net", network)];
    let observing = ObservingSystem::new(&layout, None, &configs, seed, WINDOW, Time::from_seconds(0)).unwrap();
    let sum = |terms: Vec<Box<dyn Covariance>>| -> Arc<dyn Covariance> { Arc::new(Sum::new(layout.len(), terms)) };
    let background_error = sum(vec![Box::new(Univariate::new(&layout, 0, 2.0, 3e5).unwrap())]);
    let model_error =
        sum(vec![Box::new(Univariate::new(&layout, 0, 0.1, 3e5).unwrap()), Box::new(White::new(&layout, 0, 0.02))]);
    let mut random = stream(seed, "truth");
    let truth = State::from_values(&layout, randomize(&*background_error, &mut random));
    let problem: Problem = Problem {
        model: Arc::new(own),
        background: State::zeros(&layout),
        background_error,
        model_error: Some(model_error.clone()),
        calibration: observing.calibration().clone(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    };
    World { problem, observing, truth, model_error, random }
}

fn volume(problem: &Problem, tiles: Option<[usize; 2]>) -> TimeVolume {
    let settings = TimeVolumeSettings {
        filter: settings(BlockShape::Domain, BiasCoupling::Carry),
        cycles: 40,
        keep_before: false,
        factors: Vec::new(),
        start: Time::from_seconds(0),
        selection_threshold: 4.0,
    };
    TimeVolume::new(problem.clone(), settings, Some(Arc::new(Winds::new(tiles)))).unwrap()
}

/// Squared errors of the time volume with the wrong model and of the Kalman filter with the right one, and the parameters.
fn run(seed: u64, true_wind: (f64, f64)) -> (f64, f64, Vec<isobar_assim::EstimatedParameter>) {
    let World { problem, mut observing, mut truth, model_error, mut random } = world(seed);
    let right = model(true_wind.0, true_wind.1);
    let mut corrected = volume(&problem, None);
    let with_right: Problem = problem.clone().with_model(Arc::new(right.clone()));
    let mut reference = KalmanFilter::new(with_right).unwrap();
    let mut squares = [0.0; 2];
    for cycle in 1..=40 {
        forecast::forecast(&right, &mut truth, 6).unwrap();
        let error = randomize(&*model_error, &mut random);
        truth.values_mut().iter_mut().zip(error).for_each(|(value, error)| *value += error);
        let observed = observing.observe(&truth);
        let methods: [&mut dyn Assimilator; 2] = [&mut corrected, &mut reference];
        for (square, method) in squares.iter_mut().zip(methods) {
            let from = method.forecast(WINDOW).unwrap();
            let state = method.analyse(&from, &observed).unwrap().estimate.state;
            if cycle > 12 {
                *square += (&state - &truth).values().iter().map(|error| error * error).sum::<f64>();
            }
        }
        if cycle == 20 {
            // A checkpoint changes nothing, corrected model included.
            let saved = corrected.memory().unwrap();
            corrected = volume(&problem, None);
            corrected.recall(&mut &saved[..]).unwrap();
        }
    }
    (squares[0], squares[1], parameters(&corrected))
}

#[test]
fn a_wrong_wind_is_found_and_the_analysis_is_that_of_the_right_model() {
    let (mut squares, mut scores) = ([0.0; 2], Vec::new());
    for seed in 0..12 {
        let (corrected, right, found) = run(seed, (6.5, -1.0));
        squares[0] += corrected;
        squares[1] += right;
        for (parameter, truth) in found.iter().zip([1.5, -1.0]) {
            assert_eq!(parameter.verdict, "determined", "seed {seed}: {parameter:?}");
            scores.push((parameter.value - truth) / parameter.sigma.unwrap());
        }
    }
    let ratio = (squares[0] / squares[1]).sqrt();
    assert!(ratio < 1.05, "RMSE is {ratio} times that of the right model");
    assert!(scores.iter().all(|z| z.abs() < 3.5), "{scores:?}");
    let square = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    assert!(square < 2.0, "{square}: {scores:?}");
}

#[test]
fn of_a_right_model_nothing_is_corrected() {
    let chosen = |seed| run(seed, (5.0, 0.0)).2.iter().filter(|it| it.verdict == "determined").count();
    let chosen: usize = (0..8).map(chosen).sum();
    assert!(chosen <= 1, "{chosen} of 16 candidates");
}

/// Analyses and parameters of some cycles in which the truth goes faster.
fn short_run(tiles: Option<[usize; 2]>, cycles: usize) -> (Vec<f64>, Vec<isobar_assim::EstimatedParameter>) {
    let World { problem, mut observing, mut truth, .. } = world(1);
    let (right, mut method) = (model(6.5, -1.0), volume(&problem, tiles));
    let mut analyses = Vec::new();
    for _ in 0..cycles {
        forecast::forecast(&right, &mut truth, 6).unwrap();
        let from = method.forecast(WINDOW).unwrap();
        let analysis = method.analyse(&from, &observing.observe(&truth)).unwrap();
        analyses.extend_from_slice(analysis.estimate.state.values());
    }
    (analyses, parameters(&method))
}

#[test]
fn one_tile_is_the_whole_domain() {
    let ((of_tile, tile), (of_whole, whole)) = (short_run(Some([1, 1]), 12), short_run(None, 12));
    let largest = of_whole.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    assert!(of_tile.iter().zip(&of_whole).all(|(tile, whole)| (tile - whole).abs() < 1e-9 * largest));
    assert_eq!((tile.len(), whole.len()), (2, 2));
    for (tile, whole) in tile.iter().zip(&whole) {
        assert_eq!(tile.name, format!("{}/tile x1 y1", whole.name));
        assert_eq!((&tile.verdict, &*whole.verdict), (&whole.verdict, "determined"));
        assert!((tile.value - whole.value).abs() < 1e-9 * whole.value.abs());
        assert!((tile.sigma.unwrap() / whole.sigma.unwrap() - 1.0).abs() < 1e-9);
    }
}

#[test]
fn tiles_have_the_same_bits_on_any_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (analyses, found) = pool.install(|| short_run(Some([2, 2]), 6));
        assert!(found.iter().any(|it| it.verdict == "determined"), "{found:?}");
        let found = found.into_iter().map(|it| (it.value.to_bits(), it.sigma.map(f64::to_bits)));
        (analyses.into_iter().map(f64::to_bits).collect::<Vec<_>>(), found.collect::<Vec<_>>())
    };
    let one = on(1);
    assert!(one == on(2) && one == on(5));
}
