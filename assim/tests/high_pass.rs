//! Lange's High-pass Filter: equal to the dense solution without prior, honest about what it knows, and it names the rest.

use crate::common::{WINDOW, flat, parameters, relative_difference};
use faer::Mat;
use isobar_assim::Initialised;
use isobar_assim::block_angular::{Block, BorderRows, RegressionRows, solve};
use isobar_assim::covariance::{Sum, Univariate};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter};
use isobar_assim::high_pass::{HighPassFilter, HighPassSettings, HighPassSolution, in_words};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, BiasTreatment, Covariance, Problem};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, ExactShift, Grid, Model, State, Time};
use isobar_obs::{
    BiasProcess, BiasScope, Network, ObservationWindow, ObservedVariable, ObservingSystem, RadiosondeSettings,
    SensorComparison, StationBias, StationSource,
};
use std::sync::Arc;

fn blocks(seed: u64, p: usize, null: Option<&[f64]>) -> Vec<Block> {
    let random = &mut stream(seed, "blocks");
    let mut normal = |rows: usize, columns: usize| {
        let values = standard_normals(random, rows * columns);
        Mat::from_fn(rows, columns, |i, j| values[j * rows + i])
    };
    (0..90)
        .map(|k| {
            let (n, m) = (3 + k % 4, 1 + k % 2);
            let (x, mut g) = (normal(n, m), normal(n, p));
            if let Some(null) = null {
                // Takes the direction out of every row.
                let length: f64 = null.iter().map(|it| it * it).sum();
                for i in 0..n {
                    let along: f64 = (0..p).map(|j| g[(i, j)] * null[j]).sum();
                    (0..p).for_each(|j| g[(i, j)] -= along * null[j] / length);
                }
            }
            let root = normal(n, n + 2);
            let v = &root * root.transpose();
            let y = flat(&normal(n, 1));
            Block::Regression(RegressionRows { x, g, y, v })
        })
        .collect()
}

#[test]
fn without_a_prior_it_is_the_block_angular_solution() {
    let blocks = blocks(1, 5, None);
    let mut rows = BorderRows::new(5);
    // In two batches, as cycles come.
    rows.add(&blocks[..70]).unwrap();
    rows.add(&blocks[70..]).unwrap();
    let found = rows.solve(&[1.0, 10.0, 0.1, 3.0, 1.0]);
    let exact = solve(&blocks, 5, None).unwrap();
    assert!(relative_difference(&found.estimate, &exact.border) < 1e-11);
    assert!(relative_difference(&flat(&found.covariance), &flat(&exact.border_covariance)) < 1e-11);
    assert!((found.residual_chi2 / exact.residual_chi2 - 1.0).abs() < 1e-11);
    assert!(found.undetermined.is_empty());
}

#[test]
fn what_the_rows_do_not_determine_is_found_and_keeps_its_scale() {
    let null = [1.0, 0.0, -2.0, 1.0];
    let blocks = blocks(2, 4, Some(&null));
    let mut rows = BorderRows::new(4);
    rows.add(&blocks).unwrap();
    let found = rows.solve(&[2.0; 4]);
    let [combination] = found.undetermined.as_slice() else { panic!("{:?}", found.undetermined) };
    assert!(relative_difference(combination, &[-0.5, 0.0, 1.0, -0.5]) < 1e-9, "{combination:?}");
    let length: f64 = null.iter().map(|it| it * it).sum();
    let along: f64 = found.estimate.iter().zip(&null).map(|(c, null)| c * null).sum();
    assert!(along.abs() < 1e-9);
    let covariance = |i: usize, j: usize| null[i] * found.covariance[(i, j)] * null[j];
    let variance: f64 = (0..16).map(|n| covariance(n / 4, n % 4)).sum::<f64>() / length;
    assert!((variance - 4.0).abs() < 1e-9, "the scale squared, not {variance}");
    // What is determined is that of the rows with the combination held at zero: one unknown less, eliminated exactly.
    let basis = Mat::from_fn(4, 3, |i, j| [[2.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -1.0]][j][i]);
    let reduced: Vec<Block> = (blocks.iter())
        .map(|block| {
            let Block::Regression(rows) = block else { unreachable!() };
            Block::Regression(RegressionRows { g: &rows.g * &basis, ..rows.clone() })
        })
        .collect();
    let exact = solve(&reduced, 3, None).unwrap();
    let expected = &basis * Mat::from_fn(3, 1, |i, _| exact.border[i]);
    assert!(relative_difference(&found.estimate, expected.col_as_slice(0)) < 1e-9);
}

/// A tracer that is carried along, stations in groups with a bias each, perhaps one of them without.
struct World {
    problem: Problem,
    observing: ObservingSystem,
    truth: State,
    model: ExactShift,
}

fn world(seed: u64, reference: bool) -> World {
    let grid = Grid { nx: 12, ny: 10, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    let model = ExactShift::new(grid, 1, 0, WINDOW).unwrap();
    let layout = model.layout().clone();
    let groups = ["A", "B", "C"].map(String::from).to_vec();
    let mut network = RadiosondeSettings::new(StationSource::Random { count: 90, groups });
    network.variables = vec![ObservedVariable::new("tracer", 0.5)];
    network.biases = vec![StationBias {
        variable: "tracer".into(),
        scope: BiasScope::EachGroup,
        process: BiasProcess::constant(2.0),
    }];
    if reference {
        network.reference_groups = vec!["A".into()];
    }
    let configs = [Network::new("net", network)];
    let observing = ObservingSystem::new(&layout, None, &configs, seed, WINDOW, Time::from_seconds(0)).unwrap();
    let terms: Vec<Box<dyn Covariance>> = vec![Box::new(Univariate::new(&layout, 0, 1.5, 3e5).unwrap())];
    let background_error: Arc<dyn Covariance> = Arc::new(Sum::new(layout.len(), terms));
    let background = State::zeros(&layout);
    let deviation = isobar_assim::covariance::randomize(&*background_error, &mut stream(seed, "deviation"));
    let truth = State::from_values(&layout, deviation);
    let problem: Problem = Problem {
        model: Arc::new(model.clone()),
        background,
        background_error,
        model_error: None,
        calibration: observing.calibration().clone(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    };
    World { problem, observing, truth, model }
}

const SETTINGS: HighPassSettings = HighPassSettings { cycles: 4, box_m: 3e5, covariance_scale: 2.0 };

/// With a covariance scale of 1 the mean square is 1.24: the field that the boxes leave over is carried on by one cell in
/// a cycle, so that its errors come again.
#[test]
fn a_reference_determines_all_biases_within_what_is_claimed() {
    let (mut beyond, mut count, mut square) = (0, 0, 0.0);
    for seed in 0..200 {
        let World { problem, mut observing, mut truth, model } = world(seed, true);
        let mut filter = HighPassFilter::new(problem.calibration.clone(), problem.background_error.clone(), SETTINGS);
        for _ in 0..3 {
            model.step(&mut truth);
            filter.observe(&observing.observe(&truth), &problem.background).unwrap();
        }
        let found = filter.solve();
        assert!(found.undetermined.is_empty());
        for (i, (estimate, truth)) in found.estimate.iter().zip(observing.true_calibration()).enumerate() {
            let z = (estimate - truth.unwrap()) / found.covariance[(i, i)].sqrt();
            (count, square) = (count + 1, square + z * z);
            beyond += usize::from(z.abs() > 3.0);
            assert!(found.covariance[(i, i)].sqrt() < 0.5, "much less than the prior's 2");
        }
    }
    assert!(beyond * 100 <= count, "{beyond} of {count} beyond three standard deviations");
    let mean_square = square / count as f64;
    assert!((0.6..1.2).contains(&mean_square), "{mean_square}");
}

#[test]
fn without_a_reference_the_common_bias_is_named() {
    let World { problem, mut observing, truth, .. } = world(3, false);
    let mut filter = HighPassFilter::new(problem.calibration.clone(), problem.background_error.clone(), SETTINGS);
    filter.observe(&observing.observe(&truth), &problem.background).unwrap();
    let found = filter.solve();
    let [combination] = found.undetermined.as_slice() else { panic!("{:?}", found.undetermined) };
    assert_eq!(in_words(combination), "net/tracer/A + net/tracer/B + net/tracer/C");
    assert_eq!(in_words(&[(-1.0, "a".into()), (0.25, "b".into()), (-0.5, "c".into())]), "−a + 0.25 b − 0.50 c");
}

/// A test point of one sensor is among the rows, and with the differences within boxes it determines all.
#[test]
fn a_test_point_determines_the_common_bias() {
    let World { problem, mut observing, truth, .. } = world(3, false);
    let solve = |comparisons: Vec<SensorComparison>, observed: &ObservationWindow| {
        let mut filter = HighPassFilter::new(problem.calibration.clone(), problem.background_error.clone(), SETTINGS);
        let observed = ObservationWindow { comparisons, ..observed.clone() };
        let grid = &problem.background.layout().grid;
        filter.observe(&observed.with_comparisons_below(grid), &problem.background).unwrap();
        filter.solve()
    };
    let observed = observing.observe(&truth);
    let without = solve(vec![], &observed);
    let test_point = |value, sigma| SensorComparison { parameter: 1, other: None, value, sigma };
    let found = solve(vec![test_point(1.5, 0.25)], &observed);
    assert!(found.undetermined.is_empty() && without.undetermined.len() == 1);
    // The test point is all that is known of the common bias, and says nothing of the differences.
    assert!((found.estimate[1] - 1.5).abs() < 1e-9 && (found.covariance[(1, 1)].sqrt() - 0.25).abs() < 1e-9);
    for other in [0, 2] {
        let [own, before] = [&found, &without].map(|it| it.estimate[other] - it.estimate[1]);
        assert!((own - before).abs() < 1e-9, "{own} {before}");
    }
    // A comparison adds its information to that of the boxes on the difference: 1/σ² of both.
    let variance = |it: &HighPassSolution| it.covariance[(0, 0)] - 2.0 * it.covariance[(0, 1)] + it.covariance[(1, 1)];
    let comparison = SensorComparison { parameter: 0, other: Some(1), value: 0.0, sigma: 0.3 };
    let compared = solve(vec![test_point(1.5, 0.25), comparison], &observed);
    let expected = 1.0 / (1.0 / variance(&found) + 1.0 / 0.09);
    assert!((variance(&compared) / expected - 1.0).abs() < 1e-9, "{} {expected}", variance(&compared));
}

/// The method starts from the batch as it would from a prior of the same mean and covariance, and both filters agree.
#[test]
fn methods_start_from_the_batch() {
    let World { problem, mut observing, mut truth, model } = world(5, true);
    let settings = crate::common::settings(BlockShape::Domain, BiasCoupling::Carry);
    let mut methods: Vec<Initialised> = vec![
        Initialised::new(Box::new(KalmanFilter::new(problem.clone()).unwrap()), problem.clone(), SETTINGS).unwrap(),
        Initialised::new(
            Box::new(FastKalmanFilter::new(problem.clone(), settings).unwrap()),
            problem.clone(),
            SETTINGS,
        )
        .unwrap(),
    ];
    let mut expected = HighPassFilter::new(problem.calibration.clone(), problem.background_error.clone(), SETTINGS);
    for cycle in 1..=7 {
        model.step(&mut truth);
        let observed = observing.observe(&truth);
        if cycle < SETTINGS.cycles {
            expected.observe(&observed, &problem.background).unwrap();
        }
        let mut results = Vec::new();
        for method in &mut methods {
            let from = method.forecast(WINDOW).unwrap();
            // A checkpoint in the middle changes nothing.
            let saved = method.memory().unwrap();
            method.recall(&mut &saved[..]).unwrap();
            results.push(method.analyse(&from, &observed).unwrap());
            assert_eq!(parameters(&*method).len(), if cycle == SETTINGS.cycles { 2 } else { 0 });
        }
        if cycle < SETTINGS.cycles {
            assert_eq!(results[0].estimate.calibration, [0.0, 0.0]);
            continue;
        }
        let (kf, fkf) = (&results[0].estimate, &results[1].estimate);
        assert!(relative_difference(kf.state.values(), fkf.state.values()) < 1e-9);
        assert!(relative_difference(&kf.calibration, &fkf.calibration) < 1e-9);
        let (kf, fkf) = (kf.calibration_spread.as_ref().unwrap(), fkf.calibration_spread.as_ref().unwrap());
        assert!(relative_difference(kf, fkf) < 1e-9);
    }
    let (found, expected) = (methods[0].solution().unwrap(), expected.solve());
    assert_eq!(found.estimate, expected.estimate);
}

#[test]
fn what_cannot_be_initialised_says_so() {
    let World { problem, .. } = world(5, true);
    let filter = || Box::new(KalmanFilter::new(problem.clone()).unwrap());
    let short = HighPassSettings { cycles: 1, ..SETTINGS };
    assert!(Initialised::new(filter(), problem.clone(), short).is_err_and(|it| it.to_string().contains("two cycles")));
    let ignoring = Problem { bias: BiasTreatment::Ignore, ..problem.clone() };
    let error = Initialised::new(filter(), ignoring, SETTINGS).err().unwrap();
    assert!(error.to_string().contains("no calibration parameter"));
}
