//! One column of a method's error covariance, without the matrix.

use isobar_model::vector::{add, scale};
use isobar_obs::Calibration;

/// A number that a method estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unknown {
    /// The value of the state with this number.
    Value(usize),
    /// The calibration parameter with this number, among all of the experiment.
    Parameter(usize),
}

/// The covariances of the error of one unknown with the errors of all: a column of the covariance P of (x, c).
#[derive(Clone, Debug, PartialEq)]
pub struct CovarianceColumn {
    /// With every value of the state, each in the unknown's unit times its own, `[m]`.
    pub state: Vec<f64>,
    /// With every calibration parameter of the experiment; 0 with those that the method does not estimate.
    pub calibration: Vec<f64>,
}

impl CovarianceColumn {
    /// The covariance with a combination of unknowns.
    pub fn with_combination(&self, combination: &[(Unknown, f64)]) -> f64 {
        combination.iter().map(|&(unknown, weight)| weight * self.with(unknown)).sum()
    }

    /// From a column over (x, c), c the parameters that are estimated: all of the experiment, or none.
    pub(crate) fn of_augmented(mut column: Vec<f64>, state_values: usize, all: &Calibration) -> Self {
        let mut calibration = column.split_off(state_values);
        calibration.resize(all.len(), 0.0);
        Self { state: column, calibration }
    }

    /// The covariance with an unknown.
    pub fn with(&self, unknown: Unknown) -> f64 {
        match unknown {
            Unknown::Value(number) => self.state[number],
            Unknown::Parameter(number) => self.calibration[number],
        }
    }
}

/// A method that carries a covariance of its errors.
pub trait JointErrors {
    /// The covariances of one unknown's error with all others as the method has them now, found without the whole matrix;
    /// `None` if the method does not estimate the unknown.
    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn>;

    /// P v, the covariances of the error of a combination vᵀs of unknowns with the errors of all unknowns; `None` if the method
    /// does not estimate an unknown of the combination, or the combination is empty.
    fn covariance_with(&self, combination: &[(Unknown, f64)]) -> Option<CovarianceColumn> {
        let mut sum: Option<CovarianceColumn> = None;
        for &(unknown, weight) in combination {
            let mut column = self.covariance_column(unknown)?;
            scale(&mut column.state, weight);
            scale(&mut column.calibration, weight);
            match &mut sum {
                Some(sum) => {
                    add(&mut sum.state, &column.state);
                    add(&mut sum.calibration, &column.calibration);
                }
                None => sum = Some(column),
            }
        }
        sum
    }

    /// aᵀ P b, the covariance of the errors of two short combinations of unknowns; `None` as for
    /// [`JointErrors::covariance_with`].
    fn covariance_between(&self, a: &[(Unknown, f64)], b: &[(Unknown, f64)]) -> Option<f64> {
        Some(self.covariance_with(a)?.with_combination(b))
    }
}

/// The correlation of the errors of two unknowns, in \[−1, 1\]; `None` if the method does not estimate both of them, or one
/// of them has no error.
pub fn correlation(method: &dyn JointErrors, a: Unknown, b: Unknown) -> Option<f64> {
    let (of_a, of_b) = (method.covariance_column(a)?, method.covariance_column(b)?);
    let variances = of_a.with(a) * of_b.with(b);
    (variances > 0.0).then(|| (of_a.with(b) / variances.sqrt()).clamp(-1.0, 1.0))
}
