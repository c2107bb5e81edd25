//! What the filter knows of the calibration parameters: their priors, their accuracy, and what a recalibration adds, or
//! another source says.

use super::block_diagonal::scale_row_and_column;
use super::factored_covariance::{FactoredCovariance, Patch};
use super::factors::Factors;
use super::{BlockErrors, Frame};
use crate::error::Error;
use crate::linalg::{add_symmetric_product, cholesky, semidefinite_root, summed};
use faer::{Mat, MatRef};
use std::borrow::Cow;
use std::sync::Arc;

impl Frame {
    /// Multiplies the rows of the parameters by φ, `[p]`.
    fn decay(&self, kept: &[f64], factors: &mut Factors) {
        let Frame { local, shared, .. } = self;
        let of_local: Vec<f64> = local.iter().map(|&number| kept[number]).collect();
        factors.local.edit_columns(|column| column.iter_mut().zip(&of_local).for_each(|(value, kept)| *value *= kept));
        for column in 0..factors.columns() {
            let values = factors.shared.col_as_slice_mut(column);
            values.iter_mut().zip(shared).for_each(|(value, &number)| *value *= kept[number]);
        }
    }
}

impl BlockErrors {
    /// The rows of the parameters, in the order of the calibration, and of the state's means, `[p + v, r]`, of factors.
    pub(crate) fn joint_rows(&self, factors: &Factors) -> Mat<f64> {
        let Frame { local, shared, layout, .. } = &*self.frame;
        let (p, v, cells) = (local.len() + shared.len(), layout.variables.len(), layout.grid.cells());
        let own_cells = factors.state.own_rows() / v;
        let field_sums =
            |column: Cow<'_, [f64]>| column.chunks_exact(own_cells).map(|it| it.iter().sum()).collect::<Vec<f64>>();
        let mut sums: Vec<f64> = (0..factors.columns()).flat_map(|j| field_sums(factors.state.own_column(j))).collect();
        factors.sum(&mut sums);
        let mut rows = Mat::<f64>::zeros(p + v, factors.columns());
        for column in 0..factors.columns() {
            let target = rows.col_as_slice_mut(column);
            for (&number, &value) in local.iter().zip(factors.local.column(column).iter()) {
                target[number] = value;
            }
            for (&number, &value) in shared.iter().zip(factors.shared.col_as_slice(column)) {
                target[number] = value;
            }
            for (variable, sum) in sums[column * v..][..v].iter().enumerate() {
                target[p + variable] = sum / cells as f64;
            }
        }
        rows
    }

    /// The covariance of the parameters, in the order of the calibration, and of the state's means, `[p + v, p + v]`: what Φ and
    /// the block diagonal have of it.
    pub(crate) fn joint_covariance(&self) -> Mat<f64> {
        let Frame { blocks, local, shared, layout, .. } = &*self.frame;
        let (m, p, cells) = (layout.len(), local.len() + shared.len(), layout.grid.cells());
        let rows = self.joint_rows(self.factors());
        let mut joint = Mat::zeros(rows.nrows(), rows.nrows());
        // Of the block diagonal: where each block variable belongs in the joint vector, and with which weight.
        let place = |variable: usize| {
            if variable < m { (p + variable / cells, 1.0 / cells as f64) } else { (local[variable - m], 1.0) }
        };
        for (variables, covariance) in self.memory.covariance.patches(blocks) {
            for (j, &column) in variables.iter().enumerate() {
                let (to_column, column_weight) = place(column);
                for (i, &row) in variables.iter().enumerate() {
                    let (to_row, row_weight) = place(row);
                    joint[(to_row, to_column)] += row_weight * column_weight * covariance[(i, j)];
                }
            }
        }
        let mut joint = summed(self.frame.bands.communicator(), joint);
        add_symmetric_product(joint.as_mut(), 1.0, rows.as_ref(), rows.transpose());
        joint
    }

    /// c ← φ c in the covariance: the rows of the parameters in Φ, and those of the local ones in the blocks.
    pub(crate) fn decay(&mut self, kept: &[f64]) {
        let frame = Arc::clone(&self.frame);
        let m = frame.layout.len();
        let FactoredCovariance { own, linked, factors } = &mut self.memory.covariance;
        frame.decay(kept, factors);
        for (i, &number) in frame.local.iter().enumerate() {
            own.scale(&frame.blocks, m + i, kept[number]);
            for Patch { variables, covariance } in linked.iter_mut() {
                if let Ok(place) = variables.binary_search(&(m + i)) {
                    scale_row_and_column(covariance.as_mut(), place, kept[number]);
                }
            }
        }
    }

    /// c ← φ c in factors like Φ.
    pub(crate) fn decay_factors(&self, kept: &[f64], factors: &mut Factors) {
        self.frame.decay(kept, factors);
    }

    /// Φ ← \[Φ L\], L Lᵀ the covariance that is added to that of the parameters.
    pub(super) fn widen(&mut self, covariance: MatRef<'_, f64>) {
        let frame = Arc::clone(&self.frame);
        let root = semidefinite_root(covariance);
        let carried: Vec<usize> =
            (0..root.ncols()).filter(|&j| root.col_as_slice(j).iter().any(|&value| value != 0.0)).collect();
        let factors = self.factors_mut();
        let first = factors.columns();
        factors.append(carried.len());
        for (column, &j) in (first..).zip(&carried) {
            for (i, &number) in frame.local.iter().enumerate() {
                factors.local.set(i, column, root[(number, j)]);
            }
            for (i, &number) in frame.shared.iter().enumerate() {
                factors.shared[(i, column)] = root[(number, j)];
            }
        }
    }

    /// Replaces the covariance of the calibration.
    ///
    /// With Cov(ĉ) = L Lᵀ, shared parameters before local ones, the columns of L that the shared ones have become factors; of
    /// what the local ones have beyond them each keeps its variance.
    pub(super) fn replace(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let frame = Arc::clone(&self.frame);
        let numbers: Vec<usize> = frame.shared.iter().chain(&frame.local).copied().collect();
        let (p, shared, m) = (numbers.len(), frame.shared.len(), frame.layout.len());
        let ordered = Mat::from_fn(p, p, |i, j| covariance[(numbers[i], numbers[j])]);
        let root = cholesky(ordered, || "the covariance of the calibration".into())?;
        self.forget();
        let factors = self.factors_mut();
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
        self.memory.covariance.linked.clear();
        for i in shared..p {
            let variance = (shared..=i).map(|j| root[(i, j)].powi(2)).sum();
            let own = &mut self.memory.covariance.own;
            own.clear(&frame.blocks, m + i - shared);
            own.edit(&frame.blocks, m + i - shared, |mut matrix, position| matrix[(position, position)] = variance);
        }
        Ok(())
    }

    /// A parameter's row of factors like Φ.
    pub(crate) fn row_of_parameter(&self, factors: &Factors, number: usize) -> Vec<f64> {
        match self.frame.shared.iter().position(|&shared| shared == number) {
            Some(row) => (0..factors.columns()).map(|k| factors.shared[(row, k)]).collect(),
            None => {
                let row = self.local_row(number);
                (0..factors.columns()).map(|k| factors.local.column(k)[row]).collect()
            }
        }
    }

    /// The variance that a parameter has beside that of the common factors.
    pub(crate) fn own_variance(&self, number: usize) -> f64 {
        if self.frame.shared.contains(&number) {
            return 0.0;
        }
        let (block, position) = self.frame.blocks.place(self.frame.layout.len() + self.local_row(number));
        self.memory.covariance.own.block(&self.frame.blocks, block)[(position, position)]
    }

    fn local_row(&self, number: usize) -> usize {
        self.frame.local.iter().position(|&local| local == number).expect("a parameter is shared or local")
    }
}
