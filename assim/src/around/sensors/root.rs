//! The columns of the method within, whose members have calibration parameters c' = c − o.

use super::Calibrated;
use crate::covariance_root::{CovarianceRoot, RootKind};
use isobar_model::vector::add;

impl Calibrated {
    fn inner_root(&self) -> &dyn CovarianceRoot {
        self.method.can().root.expect("only a method with columns offers this view")
    }
}

impl CovarianceRoot for Calibrated {
    fn kind(&self) -> RootKind {
        self.inner_root().kind()
    }

    fn columns(&self) -> usize {
        self.inner_root().columns()
    }

    fn column(&self, number: usize) -> (Vec<f64>, Vec<f64>) {
        let (state, mut calibration) = self.inner_root().column(number);
        if self.kind() == RootKind::Members && !calibration.is_empty() {
            add(&mut calibration, &self.memory.offset);
        }
        (state, calibration)
    }
}
