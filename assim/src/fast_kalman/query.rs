//! Covariances of one unknown with all others, without the matrix.

use super::FastKalmanFilter;
use crate::covariance_column::{CovarianceColumn, Unknown};

impl FastKalmanFilter {
    /// A column of blkdiag(C) + Φ Φᵀ: the row φ of Φ that belongs to the unknown gives Φ φᵀ, its block the rest. It costs
    /// as much as the factors of one variable, (m + p) r, and the block.
    pub(super) fn column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        let (b, m) = (self.blocks.variables(), self.state.values().len());
        let factors = &self.covariance.factors;
        let variable = match unknown {
            Unknown::Value(number) => Some(number),
            Unknown::Parameter(number) => self.local.iter().position(|&own| own == number).map(|local| m + local),
        };
        let row: Vec<f64> = match (variable, unknown) {
            (Some(variable), _) => (0..factors.columns()).map(|j| factors.value(variable, j)).collect(),
            (None, Unknown::Parameter(number)) => {
                let shared = self.shared.iter().position(|&own| own == number)?;
                (0..factors.columns()).map(|j| factors.shared[(shared, j)]).collect()
            }
            (None, Unknown::Value(_)) => return None,
        };
        let mut blocks = vec![0.0; b];
        factors.multiply_add(&row, &mut blocks);
        if let Some(variable) = variable {
            let block = self.blocks.place(variable).0;
            // A patch holds the blocks that observations have linked, its own among them.
            let linked = self.covariance.linked.iter().find(|it| it.variables.binary_search(&variable).is_ok());
            let (members, own) = match linked {
                Some(patch) => (patch.variables.as_slice(), patch.covariance.as_ref()),
                None => (self.blocks.members(block), self.covariance.own.block(&self.blocks, block)),
            };
            let column = members.binary_search(&variable).ok()?;
            members.iter().enumerate().for_each(|(i, &member)| blocks[member] += own[(i, column)]);
        }
        let mut calibration = vec![0.0; self.bias.len()];
        self.local.iter().zip(&blocks[m..]).for_each(|(&number, value)| calibration[number] = *value);
        for (i, &number) in self.shared.iter().enumerate() {
            calibration[number] = row.iter().enumerate().map(|(j, value)| value * factors.shared[(i, j)]).sum();
        }
        blocks.truncate(m);
        Some(CovarianceColumn { state: blocks, calibration })
    }
}
