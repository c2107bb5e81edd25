//! The common factors as columns over (x, c).

use super::BlockErrors;
use super::solution::augmented;
use crate::covariance_root::{CovarianceRoot, RootKind};

impl CovarianceRoot for BlockErrors {
    fn kind(&self) -> RootKind {
        RootKind::Factors
    }

    fn columns(&self) -> usize {
        self.factors().columns()
    }

    fn column(&self, number: usize) -> (Vec<f64>, Vec<f64>) {
        let factors = self.factors();
        let of_blocks = [factors.state.column(number), factors.local.column(number)].concat();
        let mut state =
            augmented(&of_blocks, factors.shared.col_as_slice(number), &self.frame.local, &self.frame.shared);
        let calibration = state.split_off(factors.state.rows());
        (state, calibration)
    }
}
