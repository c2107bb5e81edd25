//! What the filter knows of the calibration parameters: their priors, their accuracy, and what a recalibration adds, or
//! another source says.

use super::FastKalmanFilter;
use super::factors::Factors;
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::error::Error;
use crate::linalg::{add_symmetric_product, cholesky, semidefinite_root, solve_lower};
use crate::tall_matrix::TallMatrix;
use faer::{Mat, MatRef};
use isobar_obs::Calibration;

/// The prior covariance P_c in the filter's form: with P_c's part of the shared parameters as L Lᵀ, the local ones have
/// `C_ls L⁻ᵀ` in the factors that carry the shared ones, which holds their covariance with these, and the rest of their
/// covariance in the blocks. What local parameters of two blocks have in common beyond the shared ones is dropped, as
/// whatever two blocks have in common.
pub(super) struct Prior {
    /// L, `[p, p]`.
    pub shared: Mat<f64>,
    /// (C_ls L⁻ᵀ)ᵀ = L⁻¹ C_sl, `[p, local]`.
    of_local: Mat<f64>,
}

impl Prior {
    pub fn new(calibration: &Calibration, shared: &[usize], local: &[usize]) -> Result<Self, Error> {
        let covariance = |i: usize, j: usize| calibration.prior_covariance(i, j);
        let own = Mat::from_fn(shared.len(), shared.len(), |i, j| covariance(shared[i], shared[j]));
        let root = cholesky(own, || "the prior covariance of the shared calibration parameters".into())?;
        let mut of_local = Mat::from_fn(shared.len(), local.len(), |i, j| covariance(shared[i], local[j]));
        solve_lower(root.as_ref(), of_local.as_mut());
        Ok(Self { shared: root, of_local })
    }

    /// Copies the local parameters' part into the first p factors.
    pub fn copy_into(&self, factors: &mut TallMatrix) {
        for column in 0..self.of_local.nrows() {
            (0..factors.rows()).for_each(|local| factors.set(local, column, self.of_local[(column, local)]));
        }
    }
}

/// The covariance of all parameters and of the state's means; see [`CalibrationAccuracy`].
pub(super) fn accuracy(filter: &FastKalmanFilter) -> Option<CalibrationAccuracy> {
    let p = filter.local.len() + filter.shared.len();
    (p > 0).then(|| CalibrationAccuracy::new(joint_covariance(filter), p))
}

/// The rows of the parameters, in the order of the calibration, and of the state's means, `[p + v, r]`, of factors.
pub(super) fn joint_rows(filter: &FastKalmanFilter, factors: &Factors) -> Mat<f64> {
    let p = filter.local.len() + filter.shared.len();
    let cells = filter.state.layout().grid.cells();
    let v = filter.state.values().len() / cells;
    let mut rows = Mat::<f64>::zeros(p + v, factors.columns());
    for column in 0..factors.columns() {
        let target = rows.col_as_slice_mut(column);
        for (&number, &value) in filter.local.iter().zip(factors.local.column(column).iter()) {
            target[number] = value;
        }
        for (&number, &value) in filter.shared.iter().zip(factors.shared.col_as_slice(column)) {
            target[number] = value;
        }
        for (variable, field) in factors.state.column(column).chunks_exact(cells).enumerate() {
            target[p + variable] = field.iter().sum::<f64>() / cells as f64;
        }
    }
    rows
}

/// The covariance of the parameters, in the order of the calibration, and of the state's means, `[p + v, p + v]`: what Φ and
/// the block diagonal have of it.
pub(super) fn joint_covariance(filter: &FastKalmanFilter) -> Mat<f64> {
    let (m, p) = (filter.state.values().len(), filter.local.len() + filter.shared.len());
    let cells = filter.state.layout().grid.cells();
    let rows = joint_rows(filter, &filter.covariance.factors);
    let mut joint = Mat::zeros(rows.nrows(), rows.nrows());
    add_symmetric_product(joint.as_mut(), 1.0, rows.as_ref(), rows.transpose());
    // Of the block diagonal: where each block variable belongs in the joint vector, and with which weight.
    let place = |variable: usize| match variable < m {
        true => (p + variable / cells, 1.0 / cells as f64),
        false => (filter.local[variable - m], 1.0),
    };
    for (variables, covariance) in filter.covariance.patches(&filter.blocks) {
        for (j, &column) in variables.iter().enumerate() {
            let (to_column, column_weight) = place(column);
            for (i, &row) in variables.iter().enumerate() {
                let (to_row, row_weight) = place(row);
                joint[(to_row, to_column)] += row_weight * column_weight * covariance[(i, j)];
            }
        }
    }
    joint
}

/// Φ ← \[Φ L\], L Lᵀ the covariance that is added to that of the parameters.
pub(super) fn widen(filter: &mut FastKalmanFilter, covariance: MatRef<'_, f64>) {
    let root = semidefinite_root(covariance);
    let carried: Vec<usize> =
        (0..root.ncols()).filter(|&j| root.col_as_slice(j).iter().any(|&value| value != 0.0)).collect();
    let factors = &mut filter.covariance.factors;
    let first = factors.columns();
    factors.append(carried.len());
    for (column, &j) in (first..).zip(&carried) {
        for (i, &number) in filter.local.iter().enumerate() {
            factors.local.set(i, column, root[(number, j)]);
        }
        for (i, &number) in filter.shared.iter().enumerate() {
            factors.shared[(i, column)] = root[(number, j)];
        }
    }
}

/// A calibration from elsewhere: see [`Assimilator::set_calibration`](crate::Assimilator::set_calibration).
///
/// With Cov(ĉ) = L Lᵀ, shared parameters before local ones, the columns of L that the shared ones have become factors; of
/// what the local ones have beyond them each keeps its variance.
pub(super) fn set(filter: &mut FastKalmanFilter, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
    let numbers: Vec<usize> = filter.shared.iter().chain(&filter.local).copied().collect();
    let (p, shared) = (numbers.len(), filter.shared.len());
    if estimate.len() != p || covariance.nrows() != p {
        return Err(Error::Setting("the calibration is not the one that the method estimates".into()));
    }
    let ordered = Mat::from_fn(p, p, |i, j| covariance[(numbers[i], numbers[j])]);
    let root = cholesky(ordered, || "the covariance of the calibration".into())?;
    numbers.iter().for_each(|&number| filter.bias[number] = estimate[number]);
    let m = filter.state.values().len();
    let factors = &mut filter.covariance.factors;
    factors.shared.fill(0.0);
    for column in 0..factors.columns() {
        factors.local.edit_column(column, |values| values.fill(0.0));
    }
    let before = factors.columns();
    factors.append(shared);
    for j in 0..shared {
        (0..shared).for_each(|i| factors.shared[(i, before + j)] = root[(i, j)]);
        (shared..p).for_each(|i| factors.local.set(i - shared, before + j, root[(i, j)]));
    }
    filter.covariance.linked.clear();
    for i in shared..p {
        let variance = (shared..=i).map(|j| root[(i, j)].powi(2)).sum();
        let (block, position) = filter.blocks.place(m + i - shared);
        let mut own = filter.covariance.own.block_mut(&filter.blocks, block);
        for other in 0..own.nrows() {
            (own[(position, other)], own[(other, position)]) = (0.0, 0.0);
        }
        own[(position, position)] = variance;
    }
    Ok(())
}
