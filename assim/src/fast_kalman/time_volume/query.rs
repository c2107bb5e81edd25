//! Covariances of state and calibration with what is not known of C, without the matrix.
//!
//! The calibration is told as it is now, with what the factors add to it, c = c₀ + H_C C + H_e e: constant amplitudes C and
//! evolving ones e, the rows of H their functions of time for the parameters on which they act. With P the covariance given
//! C, U the sensitivities to C, and S = Cov(Ĉ),
//!
//! ```text
//! T = [I 0 0; 0 I H_e],    W = T U + [0; H_C],    Cov(x, c) = T P T' + W S W'
//! ```

use super::TimeVolume;
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::fast_kalman::calibration::{joint_covariance, joint_rows};
use crate::linalg::{add_symmetric_product, column, product};
use faer::{Mat, MatRef};

/// A part of a parameter in a combination of C below this, relative to the largest of its terms, is rounding.
const ROUNDING: f64 = 1e-6;

/// The rows of H for all parameters.
struct Heights {
    /// H_C, `[p, q]`.
    constant: Mat<f64>,
    /// H_e, `[p, evolving]`.
    evolving: Mat<f64>,
}

impl Heights {
    fn of(volume: &TimeVolume) -> Self {
        let p = volume.parameters;
        let mut constant = Mat::zeros(p, volume.unknowns());
        let mut evolving = Mat::zeros(p, volume.evolving.len());
        for number in 0..p {
            let (of_constant, of_evolving) = volume.heights(number);
            of_constant.into_iter().enumerate().for_each(|(k, height)| constant[(number, k)] = height);
            of_evolving.into_iter().enumerate().for_each(|(k, height)| evolving[(number, k)] = height);
        }
        Self { constant, evolving }
    }

    /// T of the rows of parameters, evolving amplitudes, and others that stay as they are.
    fn told(&self, rows: MatRef<'_, f64>) -> Mat<f64> {
        let (p, e) = (self.evolving.nrows(), self.evolving.ncols());
        Mat::from_fn(rows.nrows() - e, rows.ncols(), |i, j| match i < p {
            true => rows[(i, j)] + (0..e).map(|k| self.evolving[(i, k)] * rows[(p + k, j)]).sum::<f64>(),
            false => rows[(i + e, j)],
        })
    }

    /// W of the rows of parameters and means.
    fn weights(&self, volume: &TimeVolume) -> Mat<f64> {
        let mut weights = self.told(joint_rows(&volume.filter, &volume.sensitivity).as_ref());
        let mut of_parameters = weights.as_mut().get_mut(..self.constant.nrows(), ..);
        of_parameters += &self.constant;
        weights
    }
}

impl TimeVolume {
    /// The covariance of the calibration as it is now and of the state's means.
    ///
    /// What is infinite in it, where a combination of C without a prior is not determined and moves a parameter, is given
    /// as the prior variance of the parameter that it moves most: nothing has become known of that one.
    pub(super) fn accuracy(&self) -> Option<CalibrationAccuracy> {
        if self.parameters == 0 {
            return None;
        }
        let heights = Heights::of(self);
        let half = heights.told(joint_covariance(&self.filter).as_ref());
        let mut joint = heights.told(half.transpose());
        let weights = heights.weights(self);
        let known = product(weights.as_ref(), self.posterior.root.as_ref());
        add_symmetric_product(joint.as_mut(), 1.0, known.as_ref(), known.transpose());
        for combination in &self.posterior.undetermined {
            let moved = self.moved(weights.as_ref(), combination);
            add_symmetric_product(joint.as_mut(), 1.0, moved.as_ref(), moved.transpose());
        }
        Some(CalibrationAccuracy::new(joint, self.parameters))
    }

    /// How a combination of C that is not determined moves parameters and means, `[p + v, 1]`: one prior standard
    /// deviation of the parameter that it moves most, or nothing if it moves none.
    fn moved(&self, weights: MatRef<'_, f64>, combination: &[f64]) -> Mat<f64> {
        let mut moved = product(weights, column(combination).as_ref());
        let mut largest: f64 = 0.0;
        for (number, parameter) in self.filter.problem.calibration.parameters[..self.parameters].iter().enumerate() {
            let terms = combination.iter().enumerate().map(|(k, part)| (weights[(number, k)] * part).abs());
            if moved[(number, 0)].abs() > ROUNDING * terms.fold(0.0, f64::max) {
                largest = largest.max(moved[(number, 0)].abs() / parameter.sigma_prior);
            }
        }
        let scale = if largest > 0.0 { 1.0 / largest } else { 0.0 };
        moved.col_as_slice_mut(0).iter_mut().for_each(|value| *value *= scale);
        moved
    }

    /// A column of Cov(x, c), without what combinations of C that are not determined add to it.
    pub(super) fn column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        let p = self.parameters;
        if matches!(unknown, Unknown::Parameter(number) if number >= p) {
            return None;
        }
        let heights = Heights::of(self);
        let weights = heights.weights(self);
        let mut found = self.filter.column(unknown)?;
        let own = match unknown {
            Unknown::Value(number) => Mat::from_fn(self.unknowns(), 1, |k, _| self.sensitivity.state.column(k)[number]),
            Unknown::Parameter(number) => {
                for k in (0..self.evolving.len()).filter(|&k| heights.evolving[(number, k)] != 0.0) {
                    let further = self.filter.column(Unknown::Parameter(p + k))?;
                    let all = found.state.iter_mut().zip(&further.state);
                    let all = all.chain(found.calibration.iter_mut().zip(&further.calibration));
                    all.for_each(|(own, further)| *own += heights.evolving[(number, k)] * further);
                }
                Mat::from_fn(self.unknowns(), 1, |k, _| weights[(number, k)])
            }
        };
        // S w, how C goes together with the unknown.
        let root = self.posterior.root.as_ref();
        let of_c = product(root, product(root.transpose(), own.as_ref()).as_ref());
        self.sensitivity.state.multiply_add(of_c.col_as_slice(0), &mut found.state);
        let calibration =
            heights.told(column(&found.calibration).as_ref()) + product(weights.as_ref().get(..p, ..), of_c.as_ref());
        found.calibration = calibration.col_as_slice(0).to_vec();
        Some(found)
    }
}
