//! A method that several ranks compute together is the same as on one: estimates, claims and χ².

use crate::common::*;
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, EnsembleTransformKalmanFilter, Inflation, InitialMembers,
    LocalEnsembleTransformKalmanFilter, LocalSettings, ModelErrorTreatment,
};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Precision, Residual};
use isobar_assim::free::FreeRun;
use isobar_assim::{Analysis, Assimilator, CovarianceColumn, Error, Problem, Unknown};
use isobar_model::testing::{ThreadRank, on_ranks};
use isobar_model::{Adjoint, BandedModel, Location};
use isobar_obs::ObservationWindow;
use std::sync::Arc;

type Build = dyn Fn(Problem) -> Result<Box<dyn Assimilator>, Error> + Sync;

const CYCLES: usize = 4;

/// Observations with the places of what they see first.
fn observed(problem: &Problem, cycle: usize) -> ObservationWindow {
    let mut observed = around(problem, cycle);
    let (jacobian, grid) =
        (observed.operator.linearize(&problem.background, &[0.0; 5]), &problem.background.layout().grid);
    for (row, report) in observed.reports.iter_mut().enumerate() {
        let cell = jacobian.state.row(row)[0].0 % grid.cells();
        (report.x_m, report.y_m) =
            (grid.x_m(Location::Center, cell % grid.nx), grid.y_m(Location::Center, cell / grid.nx));
    }
    observed
}

fn run(method: &mut dyn Assimilator, problem: &Problem, cycles: std::ops::RangeInclusive<usize>) -> Vec<Analysis> {
    let cycle = |cycle: usize| {
        let from = method.forecast(WINDOW).unwrap();
        let analysis = method.analyse(&from, &observed(problem, cycle)).unwrap();
        if let Some(calibration) = method.can().calibration {
            // As it is asked after each cycle.
            calibration.calibration_accuracy();
        }
        if let Some(blocks) = method.can().blocks {
            blocks.structure(&observed(problem, cycle), 2);
        }
        analysis
    };
    cycles.map(cycle).collect()
}

fn difference(found: &[Analysis], expected: &[Analysis]) -> f64 {
    let of_cycle = |(found, expected): (&Analysis, &Analysis)| {
        let chi2 = match (found.innovation_chi2, expected.innovation_chi2) {
            (Some(found), Some(expected)) => (found / expected - 1.0).abs(),
            (found, expected) => {
                if found == expected {
                    0.0
                } else {
                    f64::INFINITY
                }
            }
        };
        estimate_difference(&found.estimate, &expected.estimate).max(chi2)
    };
    found.iter().zip(expected).map(of_cycle).fold(0.0, f64::max)
}

/// Covariances of a value in the first row, of one in the last, and of a parameter, of a method that has them.
fn columns(method: &dyn Assimilator) -> Vec<f64> {
    let asked = [Unknown::Value(5), Unknown::Value(3 * 144 - 2), Unknown::Parameter(1)];
    let columns = asked.into_iter().filter_map(|unknown| column(method, unknown));
    columns.flat_map(|CovarianceColumn { state, calibration, .. }| [state, calibration].concat()).collect()
}

/// The problem as a rank has it.
fn shared(problem: &Problem, communicator: ThreadRank) -> Problem {
    let model: Arc<dyn Adjoint> =
        Arc::new(BandedModel::new(Arc::clone(&problem.model), Arc::new(communicator)).unwrap());
    problem.clone().with_model(model)
}

/// On 1 to 4 ranks, and interrupted on one number of them and continued on another.
fn check(name: &str, build: &Build, tolerance: f64) {
    let problem = jet_problem(12);
    let mut alone = build(problem.clone()).unwrap();
    let first = run(&mut *alone, &problem, 1..=2);
    let saved = alone.memory().unwrap();
    let second = run(&mut *alone, &problem, 3..=CYCLES);
    let expected = [first, second].concat();
    for ranks in 1..=4 {
        let found = on_ranks(ranks, |communicator| {
            let shared = shared(&problem, communicator);
            let mut method = build(shared.clone()).unwrap();
            let analyses = run(&mut *method, &problem, 1..=CYCLES);
            let mut resumed = build(shared).unwrap();
            resumed.recall(&mut &saved[..]).unwrap();
            let columns = columns(&*method);
            (analyses, run(&mut *resumed, &problem, 3..=CYCLES), method.memory().unwrap(), columns)
        });
        for (rank, (analyses, resumed, _, of_rank)) in found.iter().enumerate() {
            assert_eq!(analyses, &found[0].0, "{name}: rank {rank} of {ranks} decides as rank 0 does");
            let (whole, after) = (difference(analyses, &expected), difference(resumed, &expected[2..]));
            println!("{name}, rank {rank} of {ranks}: {whole:e}, resumed {after:e}");
            assert!(whole <= tolerance && after <= tolerance, "{name}, {rank} of {ranks}: {whole:e}, {after:e}");
            let apart = relative_difference(of_rank, &columns(&*alone));
            assert!(apart <= tolerance || of_rank.is_empty(), "{name}, {rank} of {ranks}: columns {apart:e}");
        }
        // What rank 0 saves is the memory of the whole.
        let mut continued = build(problem.clone()).unwrap();
        continued.recall(&mut &found[0].2[..]).unwrap();
        let [next, expected] = [&mut continued, &mut alone].map(|method| {
            let mut copy = method.boxed_clone();
            run(&mut *copy, &problem, CYCLES + 1..=CYCLES + 1)
        });
        let after = difference(&next, &expected);
        assert!(after <= tolerance, "{name}, saved by {ranks} ranks: {after:e}");
    }
}

fn fast(settings: FastKalmanSettings) -> impl Fn(Problem) -> Result<Box<dyn Assimilator>, Error> + Sync {
    move |problem| Ok(Box::new(FastKalmanFilter::new(problem, settings)?))
}

#[test]
fn the_fast_kalman_filter_is_the_same_on_several_ranks() {
    let settings = FastKalmanSettings {
        factors: 30,
        residual: Residual::Probe { count: 4 },
        ..settings(BlockShape::Cell, BiasCoupling::Carry)
    };
    check("fkf", &fast(settings), 1e-10);
    let separated = FastKalmanSettings { largest_component: 6, separator_factors: 500, ..settings };
    check("fkf with separators", &fast(separated), 1e-10);
    let nested = FastKalmanSettings { separator_factors: 0, ..separated };
    check("fkf with a nested elimination", &fast(nested), 1e-10);
    let energetic = FastKalmanSettings { retained_energy: 0.999, residual: Residual::Persist, ..settings };
    check("fkf with few factors", &fast(energetic), 1e-10);
    let coarse = move |problem: Problem| -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(FastKalmanFilter::new(problem, settings)?.with_factors_on(channel_jet(6, 1200).0)?))
    };
    check("fkf with factors on a coarser grid", &coarse, 1e-10);
    check(
        "fkf in single precision",
        &fast(FastKalmanSettings { factor_precision: Precision::Single, ..settings }),
        2e-5,
    );
}

#[test]
fn ensembles_are_the_same_on_several_ranks() {
    check("free", &|problem| Ok(Box::new(FreeRun::new(problem))), 0.0);
    let settings = EnsembleSettings { model_error: ModelErrorTreatment::Random, ..ensemble_settings(12) };
    for model_error in [ModelErrorTreatment::Random, ModelErrorTreatment::SquareRoot] {
        let settings = EnsembleSettings { model_error, ..settings };
        check("etkf", &move |problem| Ok(Box::new(EnsembleTransformKalmanFilter::new(problem, settings)?)), 1e-10);
    }
    let inflation = Inflation {
        background: BackgroundInflation::Adaptive { sigma: 0.1 },
        relaxation_to_prior_spread: 0.3,
        ..Inflation::NONE
    };
    for (initial_members, analysis_spacing_cells) in
        [(InitialMembers::Random, 1), (InitialMembers::Random, 5), (InitialMembers::SecondOrderExact, 2)]
    {
        let settings = EnsembleSettings { inflation, initial_members, ..settings };
        let local = LocalSettings { localization_radius_m: 6e5, analysis_spacing_cells };
        let build = move |problem: Problem| -> Result<Box<dyn Assimilator>, Error> {
            Ok(Box::new(LocalEnsembleTransformKalmanFilter::new(problem, settings, local)?))
        };
        check("letkf", &build, 1e-10);
    }
}

/// What has no form for several ranks says so.
#[test]
fn what_cannot_be_divided_is_refused() {
    let refusals = on_ranks(3, |communicator| {
        let problem = shared(&jet_problem(12), communicator);
        let reason = |settings: FastKalmanSettings| FastKalmanFilter::new(problem.clone(), settings).err().unwrap();
        let exact = FastKalmanSettings { residual: Residual::Exact, ..settings(BlockShape::Cell, BiasCoupling::Carry) };
        let tiles = settings(BlockShape::Tile { nx: 3, ny: 3 }, BiasCoupling::Carry);
        let tiles = FastKalmanSettings { residual: Residual::Persist, ..tiles };
        [reason(exact).to_string(), reason(tiles).to_string()]
    });
    let expected = [
        "an exact forecast of the blocks cannot be computed by several ranks together",
        "rank 1 begins with row 4 of the grid, within blocks of 3 rows: choose other blocks, or another number of ranks",
    ];
    assert!(refusals.iter().all(|it| *it == expected), "{refusals:?}");
}
