//! Components too large to be merged: separators that join the border, and nested elimination.

use crate::common::*;
use faer::Mat;
use isobar_assim::block_angular::PartitionReport;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Analysis, Assimilator, Background, Problem};

fn filter(problem: &Problem, settings: FastKalmanSettings) -> FastKalmanFilter {
    FastKalmanFilter::new(problem.clone(), settings).unwrap()
}

fn cells(factors: usize, largest_component: usize, separator_factors: usize) -> FastKalmanSettings {
    let merged = settings(BlockShape::Cell, BiasCoupling::Carry);
    FastKalmanSettings { factors, largest_component, separator_factors, ..merged }
}

/// Largest relative differences of estimates, claimed spread and χ² after an analysis.
fn difference(analysis: &Analysis, expected: &Analysis) -> f64 {
    let spread = |analysis: &Analysis| analysis.estimate.state_spread.clone().unwrap();
    let mut largest = relative_difference(analysis.estimate.state.values(), expected.estimate.state.values())
        .max(relative_difference(&spread(analysis), &spread(expected)))
        .max((analysis.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs());
    if !expected.estimate.calibration.is_empty() {
        let (found, wanted) = (&analysis.estimate, &expected.estimate);
        largest = largest.max(relative_difference(&found.calibration, &wanted.calibration)).max(relative_difference(
            found.calibration_spread.as_ref().unwrap(),
            wanted.calibration_spread.as_ref().unwrap(),
        ));
    }
    largest
}

/// One analysis of observations that link all blocks, from a background without covariance between them, by the filter
/// and by the Kalman filter: covariances and reports.
fn analyse(problem: &Problem, settings: FastKalmanSettings) -> (f64, Mat<f64>, Mat<f64>, PartitionReport) {
    let (mut fast, mut reference) = (filter(problem, settings), KalmanFilter::new(problem.clone()).unwrap());
    let from = (fast.forecast(WINDOW).unwrap(), reference.forecast(WINDOW).unwrap());
    analysed(problem, fast, reference, from)
}

/// The same without a forecast before, in which a filter whose blocks persist would differ.
fn analyse_at_start(problem: &Problem, settings: FastKalmanSettings) -> (f64, Mat<f64>, Mat<f64>, PartitionReport) {
    let (fast, reference) = (filter(problem, settings), KalmanFilter::new(problem.clone()).unwrap());
    analysed(problem, fast, reference, (start(problem), start(problem)))
}

fn analysed(
    problem: &Problem,
    mut fast: FastKalmanFilter,
    mut reference: KalmanFilter,
    (from_fast, from_reference): (Background, Background),
) -> (f64, Mat<f64>, Mat<f64>, PartitionReport) {
    let observed = window(problem, 40, false, 1, 5);
    let (analysis, expected) =
        (fast.analyse(&from_fast, &observed).unwrap(), reference.analyse(&from_reference, &observed).unwrap());
    let found = difference(&analysis, &expected);
    (found, fast.dense_covariance(), reference.covariance().to_owned(), analysis.partition.unwrap())
}

#[test]
fn with_separators_in_the_border_the_analysis_and_all_of_its_covariance_are_exact() {
    for (shared, local) in [(0, 0), (2, 0), (2, 3)] {
        let problem = problem(false, calibration(shared, local, 0.0), 3);
        let merged = analyse(&problem, cells(0, usize::MAX, 0)).3;
        assert!(merged.largest_component_variables > 20 && merged.separators == 0, "{merged:?}");
        for largest in [1, 4, 10, 20] {
            let (found, covariance, expected, report) = analyse(&problem, cells(0, largest, 1000));
            assert!(found < 1e-10, "{shared} shared, {local} local, at most {largest}: {found:e}");
            assert!(relative_difference(&flat(&covariance), &flat(&expected)) < 1e-10);
            assert!(report.separators > 0 && !report.nested, "{report:?}");
            assert!(report.largest_component_variables <= largest.max(5), "{report:?}");
            assert_eq!(report.border, shared + report.separator_unknowns);
        }
    }
}

#[test]
fn nested_elimination_is_exact_and_between_blocks_too_where_the_forecast_is() {
    for (shared, local) in [(0, 0), (2, 0), (2, 3)] {
        let problem = problem(false, calibration(shared, local, 0.0), 3);
        let (found, covariance, expected, report) = analyse(&problem, cells(0, 10, 0));
        assert!(found < 1e-10, "{shared} shared, {local} local: {found:e}");
        assert!(report.nested && report.border == shared, "{report:?}");
        assert!(relative_difference(&flat(&covariance), &flat(&expected)) < 1e-10);
        let persisting = FastKalmanSettings { residual: Residual::Persist, ..cells(0, 10, 0) };
        let (found, covariance, expected, report) = analyse_at_start(&problem, persisting);
        assert!(found < 1e-10 && report.nested, "{shared} shared, {local} local: {found:e}");
        let (m, cells, scale) = (40, 20, expected.norm_max());
        for (i, j) in (0..m).flat_map(|i| [(i, i % cells), (i, i % cells + cells)]) {
            let (found, expected) = (covariance[(i, j)], expected[(i, j)]);
            assert!((found - expected).abs() < 1e-10 * scale, "({i}, {j}): {found}, {expected}");
        }
    }
}

#[test]
fn with_factors_from_the_start_separators_and_nested_elimination_agree_with_merging() {
    let problem = problem(true, calibration(2, 2, 0.4), 2);
    let run = |residual, settings: FastKalmanSettings| {
        let mut fast = filter(&problem, FastKalmanSettings { residual, ..settings });
        let from_fast = fast.forecast(WINDOW).unwrap();
        let analysis = fast.analyse(&from_fast, &window(&problem, 40, false, 1, 5)).unwrap();
        (analysis, flat(&fast.dense_covariance()))
    };
    for residual in [Residual::Exact, Residual::Persist] {
        let (merged, covariance) = run(residual, cells(9, usize::MAX, 0));
        let (separated, with_separators) = run(residual, cells(9, 8, 1000));
        let (nested, with_nested) = run(residual, cells(9, 8, 0));
        assert!(difference(&separated, &merged) < 1e-10);
        assert!(difference(&nested, &merged) < 1e-10);
        // What observations link beyond the blocks, merged components keep only for a forecast that has a use for it.
        if residual == Residual::Exact {
            for cut in [&with_separators, &with_nested] {
                let found = relative_difference(cut, &covariance);
                assert!(found < 1e-10, "{found:e}");
            }
        }
        let report = (separated.partition.unwrap(), nested.partition.unwrap());
        assert!(report.0.separators > 0 && !report.0.nested && report.1.nested, "{report:?}");
    }
}

#[test]
fn as_many_factors_as_variables_are_the_kalman_filter_with_separators_too() {
    let problem = problem(true, calibration(2, 3, 0.4), 2);
    let variables = problem.background.values().len() + 3;
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let persisting = FastKalmanSettings { residual: Residual::Persist, ..cells(variables, 6, 1000) };
    let mut fast = filter(&problem, persisting);
    for cycle in 1..=6 {
        let observed = window(&problem, 14, false, cycle, 5);
        let from_fast = fast.forecast(WINDOW).unwrap();
        let from_reference = reference.forecast(WINDOW).unwrap();
        let (analysis, expected) =
            (fast.analyse(&from_fast, &observed).unwrap(), reference.analyse(&from_reference, &observed).unwrap());
        let found = difference(&analysis, &expected);
        assert!(found < 1e-8, "cycle {cycle}: {found:e}");
    }
}

#[test]
fn separators_keep_what_merging_loses_in_the_forecast() {
    // Without coupling in the model, and all that the factors can hold, the Kalman filter is reached only if what
    // observations brought between blocks is kept.
    let problem = problem(false, calibration(1, 0, 0.0), 3);
    let run = |settings: FastKalmanSettings| {
        let (mut fast, mut reference) = (filter(&problem, settings), KalmanFilter::new(problem.clone()).unwrap());
        for cycle in 1..=4 {
            let from_fast = fast.forecast(WINDOW).unwrap();
            let from_reference = reference.forecast(WINDOW).unwrap();
            let observed = window(&problem, 40, false, cycle, 5);
            fast.analyse(&from_fast, &observed).unwrap();
            reference.analyse(&from_reference, &observed).unwrap();
        }
        relative_difference(&flat(&fast.dense_covariance()), &flat(&reference.covariance().to_owned()))
    };
    let with =
        |largest_component| FastKalmanSettings { residual: Residual::Persist, ..cells(20, largest_component, 1000) };
    let (merged, separated) = (run(with(usize::MAX)), run(with(4)));
    assert!(separated < 0.8 * merged, "{separated} with separators, {merged} merged");
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let problem = problem(true, calibration(2, 3, 0.2), 8);
    for separator_factors in [0, 1000] {
        let run = |threads: usize| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
                let mut fast = filter(&problem, cells(5, 6, separator_factors));
                let mut bits = Vec::new();
                for cycle in 1..=4 {
                    let from_fast = fast.forecast(WINDOW).unwrap();
                    let analysis = fast.analyse(&from_fast, &window(&problem, 30, false, cycle, 6)).unwrap();
                    bits.extend(analysis.estimate.state.values().iter().map(|value| value.to_bits()));
                    bits.extend(analysis.estimate.state_spread.unwrap().iter().map(|value| value.to_bits()));
                }
                bits
            })
        };
        assert_eq!(run(1), run(2));
        assert_eq!(run(1), run(8));
    }
}
