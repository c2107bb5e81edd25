//! How well a method claims to know the calibration parameters.

use faer::{Mat, MatRef};

/// The covariance of the errors of the calibration parameters c and, where a method knows them, of the means x̄ over the
/// domain of each of the state's variables: the minimum needed to decide whether a bias is separable from the state.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationAccuracy {
    /// Of (c, x̄), `[p + v, p + v]`; v is zero for a method without a covariance of the state that goes with that of c.
    joint: Mat<f64>,
    parameters: usize,
}

impl CalibrationAccuracy {
    /// The covariance of (c, x̄), whose first `parameters` rows are those of c.
    ///
    /// # Panics
    /// If there are fewer rows.
    pub fn new(joint: Mat<f64>, parameters: usize) -> Self {
        assert!(joint.nrows() == joint.ncols() && parameters <= joint.nrows());
        Self { joint, parameters }
    }

    /// S, the covariance of c, `[p, p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.joint.as_ref().get(..self.parameters, ..self.parameters)
    }

    /// The covariances of each mean with c and its own variance, in the order of the variables; nothing if they are not
    /// known.
    pub fn of_means(&self) -> impl Iterator<Item = (&[f64], f64)> {
        let own = self.parameters..self.joint.nrows();
        own.map(|row| (&self.joint.col_as_slice(row)[..self.parameters], self.joint[(row, row)]))
    }
}

/// A method that estimates the calibration.
pub trait CalibrationErrors {
    /// How well it claims to know the calibration, and the means of the state with it.
    fn calibration_accuracy(&self) -> CalibrationAccuracy;
}
