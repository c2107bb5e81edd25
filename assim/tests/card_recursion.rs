//! The recursion (26)–(29) of WO 93/22625 as it is printed, against a dense solution of it.
//!
//! ```text
//! (27)  s~_k = A_k ŝ,  c~ = ĉ         V_0 = Cov(ĉ) + Q_c,    V_k = diag(R_k, P_k)
//! (28)  P_k = A_k Cov(ŝ) A_k' + Q_k   with all of Cov(ŝ); only the blocks k stay
//! (29)  Cov(ŝ) = blkdiag(C_k, 0) + Γ S Γ'
//! ```
//!
//! The dense solution forms the whole covariance, sets to zero what V does not have, and takes the analysis as generalised
//! least squares of all rows at once. Blocks that an observation links are one block of the regression, however the filter
//! cuts it.

use crate::common::*;
use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use isobar_assim::block_angular::PartitionReport;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings};
use isobar_assim::{Assimilator, Problem, covariance};
use isobar_obs::{ObservationWindow, Placement};

/// The recursion with whole matrices.
struct Card<'a> {
    problem: &'a Problem,
    shape: BlockShape,
    /// (x, c).
    estimate: Mat<f64>,
    covariance: Mat<f64>,
}

impl<'a> Card<'a> {
    fn new(problem: &'a Problem, shape: BlockShape) -> Self {
        let (m, p) = (problem.background.values().len(), problem.calibration.len());
        let b = covariance::dense(&*problem.background_error);
        let prior = |i: usize| problem.calibration.parameters[i].sigma_prior.powi(2);
        let covariance = Mat::from_fn(m + p, m + p, |i, j| match (i < m, j < m) {
            (true, true) => b[(i, j)],
            (false, false) if i == j => prior(i - m),
            _ => 0.0,
        });
        let mut card = Self { problem, shape, estimate: Mat::zeros(m + p, 1), covariance };
        card.drop_what_v_has_not();
        card
    }

    /// The block of an unknown; `None` for those of c.
    fn block(&self, unknown: usize) -> Option<usize> {
        let (m, grid) = (self.problem.background.values().len(), &self.problem.background.layout().grid);
        let cell = if unknown < m {
            unknown % grid.cells()
        } else {
            match self.problem.calibration.parameters[unknown - m].placement {
                Placement::Local { x_m, y_m } => grid.cell_at(x_m, y_m),
                Placement::Shared => return None,
            }
        };
        let (nx, ny) = self.shape.cells(grid);
        Some(cell / grid.nx / ny * grid.nx.div_ceil(nx) + cell % grid.nx / nx)
    }

    fn drop_what_v_has_not(&mut self) {
        let size = self.covariance.nrows();
        let blocks: Vec<Option<usize>> = (0..size).map(|unknown| self.block(unknown)).collect();
        self.covariance =
            Mat::from_fn(size, size, |i, j| if blocks[i] == blocks[j] { self.covariance[(i, j)] } else { 0.0 });
    }

    fn forecast(&mut self) {
        let (m, size) = (self.problem.background.values().len(), self.covariance.nrows());
        // Column by column from the model: it is linear.
        let column = |j: usize| {
            let mut unit = vec![0.0; m];
            unit[j] = 1.0;
            self.problem.model.step_tl(&self.problem.background, &mut unit);
            unit
        };
        let columns: Vec<Vec<f64>> = (0..m).map(column).collect();
        let kept = self.problem.calibration.kept(WINDOW);
        let a = Mat::from_fn(size, size, |i, j| match (i < m, j < m) {
            (true, true) => columns[j][i],
            (false, false) if i == j => kept[i - m],
            _ => 0.0,
        });
        let q = covariance::dense(self.problem.model_error.as_deref().unwrap());
        let drift = |i: usize| self.problem.calibration.parameters[i].drift.added_variance(WINDOW);
        let added = Mat::from_fn(size, size, |i, j| match (i < m, j < m) {
            (true, true) => q[(i, j)],
            (false, false) if i == j => drift(i - m),
            _ => 0.0,
        });
        self.estimate = &a * &self.estimate;
        self.covariance = &a * &self.covariance * a.transpose() + added;
        self.drop_what_v_has_not();
    }

    /// ŝ = (Z' V⁻¹ Z)⁻¹ Z' V⁻¹ z with z = [y; s~] and Z = [H; I]: (12)–(14).
    fn analyse(&mut self, observed: &ObservationWindow) {
        let (m, size, n) = (self.problem.background.values().len(), self.covariance.nrows(), observed.len());
        let jacobian = observed.operator.linearize(&self.problem.background, &vec![0.0; size - m]);
        let mut h = Mat::<f64>::zeros(n, size);
        for row in 0..n {
            jacobian.state.row(row).iter().for_each(|&(column, weight)| h[(row, column)] += weight);
            jacobian.calibration.row(row).iter().for_each(|&(column, weight)| h[(row, m + column)] += weight);
        }
        let weighted = Mat::from_fn(n, size, |i, j| h[(i, j)] / observed.sigma[i].powi(2));
        let prior = self.covariance.llt(Side::Lower).unwrap().inverse();
        let information = &prior + h.transpose() * &weighted;
        let y = Mat::from_fn(n, 1, |i, _| observed.values[i]);
        let right = weighted.transpose() * y + &prior * &self.estimate;
        self.covariance = information.llt(Side::Lower).unwrap().inverse();
        self.estimate = &self.covariance * right;
    }
}

/// The largest relative differences of estimates and of all of Cov(ŝ) over eight cycles, of the forecast's too, and the
/// partitions.
fn difference(problem: &Problem, settings: FastKalmanSettings, observations: usize) -> (f64, Vec<PartitionReport>) {
    let (mut filter, mut card) =
        (FastKalmanFilter::new(problem.clone(), settings).unwrap(), Card::new(problem, settings.blocks));
    let (mut largest, mut reports) = (0.0_f64, Vec::new());
    for cycle in 1..=8 {
        let observed = window(problem, observations, false, cycle, 5);
        let background = filter.forecast(WINDOW).unwrap();
        card.forecast();
        largest = largest.max(relative_difference(&flat(&filter.dense_covariance()), &flat(&card.covariance)));
        let analysis = filter.analyse(&background, &observed).unwrap();
        card.analyse(&observed);
        let found: Vec<f64> =
            analysis.estimate.state.values().iter().chain(&analysis.estimate.calibration).copied().collect();
        largest = largest
            .max(relative_difference(&found, card.estimate.col_as_slice(0)))
            .max(relative_difference(&flat(&filter.dense_covariance()), &flat(&card.covariance)));
        reports.push(analysis.partition.unwrap());
    }
    (largest, reports)
}

/// A model that couples all blocks, shared and local biases that drift, and observations that link blocks.
#[test]
fn merged_separated_and_nested_components_are_the_printed_recursion() {
    for (shared, local) in [(0, 0), (3, 0), (0, 3), (3, 3)] {
        let problem = problem(true, calibration(shared, local, 0.7), 2);
        for blocks in [BlockShape::Cell, BlockShape::Tile { nx: 2, ny: 2 }] {
            let printed = settings(blocks, BiasCoupling::Drop);
            for (name, largest_component, separator_factors) in
                [("merged", usize::MAX, 0), ("separated", 9, 1000), ("nested", 9, 0)]
            {
                let settings = FastKalmanSettings { largest_component, separator_factors, ..printed };
                let (found, reports) = difference(&problem, settings, 26);
                assert!(found < 1e-9, "{name}, {blocks:?}, {shared} shared, {local} local: {found:e}");
                let last = reports.last().unwrap();
                assert_eq!(
                    (last.separator_unknowns > 0 || last.nested, last.nested),
                    (name != "merged", name == "nested")
                );
            }
        }
    }
}
