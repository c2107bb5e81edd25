//! What a viewer is shown of the Fast Kalman Filter: its parts, and its leading common factors.

use crate::common::*;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::{Assimilator, BlockStructure, Problem, Structure};
use isobar_obs::ObservationWindow;

fn persistent(blocks: BlockShape, factors: usize) -> FastKalmanSettings {
    FastKalmanSettings { factors, residual: Residual::Persist, ..settings(blocks, BiasCoupling::Carry) }
}

/// The filter after two cycles, the last window and the structure.
fn analysed(problem: &Problem, settings: FastKalmanSettings, count: usize) -> (FastKalmanFilter, Structure) {
    let mut filter = FastKalmanFilter::new(problem.clone(), settings).unwrap();
    let mut last: Option<ObservationWindow> = None;
    for cycle in 1..=2 {
        let observed = window(problem, 9, false, cycle, 3);
        let from_filter = filter.forecast(WINDOW).unwrap();
        filter.analyse(&from_filter, &observed).unwrap();
        last = Some(observed);
    }
    let structure = filter.structure(&last.unwrap(), count);
    (filter, structure)
}

#[test]
fn parts_are_what_observations_merge() {
    let problem = problem(true, calibration(2, 0, 0.4), 4);
    let (_, structure) = analysed(&problem, persistent(BlockShape::Cell, 5), 0);
    let cells = problem.background.layout().grid.cells();
    assert_eq!((structure.part_of_cell.len(), structure.factors.len()), (cells, 0));
    let observed = window(&problem, 9, false, 2, 3);
    let rows = observed.operator.linearize(&problem.background, &[0.0; 2]).state;
    let mut seen = vec![false; cells];
    for row in 0..rows.rows() {
        let parts: Vec<usize> =
            rows.row(row).iter().map(|&(variable, _)| structure.part_of_cell[variable % cells]).collect();
        assert!(parts.iter().all(|&part| part == parts[0] && structure.observed[part]), "row {row}: {parts:?}");
        rows.row(row).iter().for_each(|&(variable, _)| seen[variable % cells] = true);
    }
    assert!(seen.contains(&true) && seen.contains(&false));
    for (cell, seen) in seen.iter().enumerate() {
        let part = structure.part_of_cell[cell];
        assert_eq!(structure.observed[part], *seen, "cell {cell}");
        let alone = structure.part_of_cell.iter().filter(|&&other| other == part).count() == 1;
        assert!(*seen || alone, "cell {cell} was merged without an observation");
    }
}

#[test]
fn factors_are_the_covariance_between_parts_and_with_the_biases() {
    let problem = problem(true, calibration(2, 2, 0.4), 4);
    let (filter, structure) = analysed(&problem, persistent(BlockShape::Cell, 6), 1000);
    let (m, p) = (problem.background.values().len(), problem.calibration.len());
    assert_eq!(structure.factors.len(), 8, "those of two shared biases, and six");
    let cells = problem.background.layout().grid.cells();
    let dense = filter.dense_covariance();
    let value = |factor: &isobar_assim::CommonFactor, i: usize| {
        if i < m { factor.increment.values()[i] } else { factor.calibration[i - m] }
    };
    let (mut largest, mut error) = (0.0_f64, 0.0_f64);
    for i in 0..m {
        for j in 0..m + p {
            let of_one_part = j < m && structure.part_of_cell[i % cells] == structure.part_of_cell[j % cells];
            // A local bias may be in the part of its station's cell.
            let local = j >= m && problem.calibration.parameters[j - m].placement != isobar_obs::Placement::Shared;
            if of_one_part || local {
                continue;
            }
            let sum: f64 = structure.factors.iter().map(|factor| value(factor, i) * value(factor, j)).sum();
            largest = largest.max(dense[(i, j)].abs());
            error = error.max((dense[(i, j)] - sum).abs());
        }
    }
    assert!(largest > 0.01 && error < 1e-12, "error {error:e} beside {largest:e}");
}

#[test]
fn factors_come_by_their_share_and_without_blocks_they_have_all() {
    let problem = problem(true, calibration(0, 0, 0.0), 4);
    let m = problem.background.values().len();
    let (_, structure) = analysed(&problem, persistent(BlockShape::Cell, m), 1000);
    let shares: Vec<f64> = structure.factors.iter().map(|factor| factor.share).collect();
    assert_eq!(shares.len(), m);
    assert!(shares.windows(2).all(|pair| pair[0] >= pair[1] - 1e-15), "{shares:?}");
    // B and Q are nearly all in as many factors as there are variables.
    let sum: f64 = shares.iter().sum();
    assert!((sum - 1.0).abs() < 1e-6, "{sum}");
    let (_, fewer) = analysed(&problem, persistent(BlockShape::Cell, m), 3);
    assert_eq!(fewer.factors, structure.factors[..3]);
    let (_, some) = analysed(&problem, persistent(BlockShape::Cell, 4), 3);
    assert!(some.factors.iter().map(|factor| factor.share).sum::<f64>() < 1.0);
}
