//! Covariances of state and calibration with what is not known of C, without the matrix.
//!
//! The calibration is reported as it is now, with what the factors add to it, c = c₀ + H_C C + H_e e: constant amplitudes C and
//! evolving ones e, the rows of H their functions of time for the parameters on which they act. With P the covariance given
//! C, U the sensitivities to C, and S = Cov(Ĉ),
//!
//! ```text
//! T = [I 0 0; 0 I H_e],    W = T U + [0; H_C],    Cov(x, c) = T P T' + W S W'
//! ```

use super::TimeVolume;
use crate::calibration_accuracy::{CalibrationAccuracy, CalibrationErrors};
use crate::covariance_column::{CovarianceColumn, JointErrors, Unknown};
use crate::filter::Errors;
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
        let p = volume.parameters();
        let mut constant = Mat::zeros(p, volume.unknowns());
        let mut evolving = Mat::zeros(p, volume.evolving.len());
        for number in 0..p {
            let (of_constant, of_evolving) = volume.heights(number, volume.memory.time);
            of_constant.into_iter().enumerate().for_each(|(k, height)| constant[(number, k)] = height);
            of_evolving.into_iter().enumerate().for_each(|(k, height)| evolving[(number, k)] = height);
        }
        Self { constant, evolving }
    }

    /// T of the rows of parameters, evolving amplitudes, and others that stay as they are.
    fn transform(&self, rows: MatRef<'_, f64>) -> Mat<f64> {
        let (p, e) = (self.evolving.nrows(), self.evolving.ncols());
        Mat::from_fn(rows.nrows() - e, rows.ncols(), |i, j| {
            if i < p {
                rows[(i, j)] + (0..e).map(|k| self.evolving[(i, k)] * rows[(p + k, j)]).sum::<f64>()
            } else {
                rows[(i + e, j)]
            }
        })
    }

    /// W of the rows of parameters and means.
    fn weights(&self, volume: &TimeVolume) -> Mat<f64> {
        let mut weights = self.transform(volume.errors.joint_rows(&volume.memory.sensitivity).as_ref());
        let mut of_parameters = weights.as_mut().get_mut(..self.constant.nrows(), ..);
        of_parameters += &self.constant;
        weights
    }
}

impl CalibrationErrors for TimeVolume {
    /// What is infinite in the covariance, where a combination of C without a prior is not determined and moves a parameter,
    /// is given as the prior variance of the parameter that it moves most: nothing has become known of that one.
    fn calibration_accuracy(&self) -> CalibrationAccuracy {
        let heights = Heights::of(self);
        let half = heights.transform(self.errors.joint_covariance().as_ref());
        let mut joint = heights.transform(half.transpose());
        let weights = heights.weights(self);
        let posterior = &self.memory.posterior;
        let known = product(weights.as_ref(), posterior.root.as_ref());
        add_symmetric_product(joint.as_mut(), 1.0, known.as_ref(), known.transpose());
        for combination in &posterior.undetermined {
            let moved = self.moved(weights.as_ref(), combination);
            add_symmetric_product(joint.as_mut(), 1.0, moved.as_ref(), moved.transpose());
        }
        CalibrationAccuracy::new(joint, self.parameters())
    }
}

impl TimeVolume {
    /// How a combination of C that is not determined moves parameters and means, `[p + v, 1]`: one prior standard
    /// deviation of the parameter that it moves most, or nothing if it moves none.
    fn moved(&self, weights: MatRef<'_, f64>, combination: &[f64]) -> Mat<f64> {
        let mut moved = product(weights, column(combination).as_ref());
        let mut largest: f64 = 0.0;
        for (number, parameter) in self.problem.calibration.parameters.iter().enumerate() {
            let terms = combination.iter().enumerate().map(|(k, part)| (weights[(number, k)] * part).abs());
            if moved[(number, 0)].abs() > ROUNDING * terms.fold(0.0, f64::max) {
                largest = largest.max(moved[(number, 0)].abs() / parameter.sigma_prior);
            }
        }
        let scale = if largest > 0.0 { 1.0 / largest } else { 0.0 };
        moved.col_as_slice_mut(0).iter_mut().for_each(|value| *value *= scale);
        moved
    }
}

impl JointErrors for TimeVolume {
    /// Without what combinations of C that are not determined add.
    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        let (m, p) = (self.memory.s.state.values().len(), self.parameters());
        let heights = Heights::of(self);
        let weights = heights.weights(self);
        let sensitivity = &self.memory.sensitivity.state;
        // T' of the unknown's unit vector, and its row of W.
        let mut h = vec![0.0; m + self.calibration.len()];
        let own = match unknown {
            Unknown::Value(number) => {
                *h[..m].get_mut(number)? = 1.0;
                Mat::from_fn(self.unknowns(), 1, |k, _| sensitivity.column(k)[number])
            }
            Unknown::Parameter(number) if number >= p => return None,
            Unknown::Parameter(number) => {
                h[m + number] = 1.0;
                (0..self.evolving.len()).for_each(|k| h[m + p + k] = heights.evolving[(number, k)]);
                Mat::from_fn(self.unknowns(), 1, |k, _| weights[(number, k)])
            }
        };
        let mut state = self.errors.multiply(&h);
        let calibration = state.split_off(m);
        // S w, how C goes together with the unknown.
        let root = self.memory.posterior.root.as_ref();
        let of_c = product(root, product(root.transpose(), own.as_ref()).as_ref());
        sensitivity.multiply_add(of_c.col_as_slice(0), &mut state);
        let calibration =
            heights.transform(column(&calibration).as_ref()) + product(weights.as_ref().get(..p, ..), of_c.as_ref());
        Some(CovarianceColumn { state, calibration: calibration.col_as_slice(0).to_vec() })
    }
}
