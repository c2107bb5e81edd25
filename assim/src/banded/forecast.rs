//! The forecast: tangent-linear columns a few at a time, of whose covariance the band is kept.

use super::BandedKalmanFilter;
use super::band::Band;
use crate::error::Error;
use crate::linalg::{cholesky, product, semidefinite_root, solve_lower, solve_lower_transposed};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use isobar_model::{Duration, forecast};
use rayon::prelude::*;

/// Columns that are propagated together.
pub(super) const BATCH: usize = 128;

/// Columns of the band that are worked out together.
const STRIP: usize = 64;

impl BandedKalmanFilter {
    /// x ← M(x), and the band of `A L W⁻¹ Lᵀ Aᵀ + Q`.
    ///
    /// The biases walk, c ← c + w, w ~ N(0, Q_c); what the state has in common with the new ones is by regression
    /// `T ← A T P_c (P_c + Q_c)⁻¹`, and the rest, `A T (P_c⁻¹ + Q_c⁻¹)⁻¹ Tᵀ Aᵀ`, belongs to the band.
    pub(super) fn forecast_covariance(&mut self, window: Duration) -> Result<(), Error> {
        let steps = self.problem.steps(window)?;
        let (m, p) = (self.state.values().len(), self.calibration.len());
        let start = self.state.clone();
        let mut band = self.model_error.clone();
        band.values_mut().iter_mut().for_each(|entry| *entry *= self.model_error_factor);
        for first in (0..m).step_by(BATCH) {
            let count = BATCH.min(m - first);
            let mut columns = vec![0.0; m * count];
            columns.par_chunks_mut(m).enumerate().for_each(|(number, column)| {
                let mut unit = vec![0.0; m];
                unit[first + number] = 1.0;
                if let Some(information) = &self.information {
                    information.solve_lower_transposed(&mut unit);
                }
                column.copy_from_slice(&self.in_state_order(&self.root.multiply(&unit)));
            });
            let mut state = start.clone();
            forecast::forecast_tl(&*self.problem.model, &mut state, &mut columns, steps)?;
            self.state = state;
            self.add_squares(&mut band, MatRef::from_column_major_slice(&columns, m, count));
        }
        if p > 0 {
            let mut columns: Vec<f64> = (0..p).flat_map(|k| self.coupling.col_as_slice(k)).copied().collect();
            forecast::forecast_tl(&*self.problem.model, &mut start.clone(), &mut columns, steps)?;
            self.coupling = MatRef::from_column_major_slice(&columns, m, p).to_owned();
            if let Some(lost) = self.walk(window)? {
                self.add_squares(&mut band, lost.as_ref());
            }
        }
        self.information = None;
        (self.root, self.taper) = band.covariance_factor()?;
        Ok(())
    }

    /// Lets the biases walk; returns a root of the state's covariance that is not explained by them any more.
    fn walk(&mut self, window: Duration) -> Result<Option<Mat<f64>>, Error> {
        let p = self.calibration.len();
        let mut walk = std::mem::replace(&mut self.widening, Mat::zeros(p, p));
        for (k, parameter) in self.calibration.parameters.iter().enumerate() {
            walk[(k, k)] += parameter.sigma_drift_per_sqrt_day.powi(2) * window.days();
        }
        if (0..p).all(|k| walk[(k, k)] == 0.0) {
            return Ok(None);
        }
        let before = std::mem::replace(&mut self.bias_covariance, Mat::zeros(0, 0));
        let after = &before + &walk;
        // F = (P_c + Q_c)⁻¹ P_c, and P_c − P_c F = (P_c⁻¹ + Q_c⁻¹)⁻¹ = Fᵀ Q_c.
        let root = cholesky(after.clone(), || "the covariance of the calibration".into())?;
        let mut regression = before;
        solve_lower(root.as_ref(), regression.as_mut());
        solve_lower_transposed(root.as_ref(), regression.as_mut());
        let rest = product(regression.transpose(), walk.as_ref());
        let rest = Mat::from_fn(p, p, |i, j| 0.5 * (rest[(i, j)] + rest[(j, i)]));
        let lost = product(self.coupling.as_ref(), semidefinite_root(rest.as_ref()).as_ref());
        self.coupling = product(self.coupling.as_ref(), regression.transpose());
        self.bias_covariance = after;
        Ok(Some(lost))
    }

    /// band += the band of U Uᵀ, for columns U in the order of the state.
    fn add_squares(&self, band: &mut Band, columns: MatRef<'_, f64>) {
        let (m, half) = (band.size(), band.half());
        let ordered = Mat::from_fn(m, columns.ncols(), |place, k| columns[(self.order[place], k)]);
        band.values_mut().par_chunks_mut((half + 1) * STRIP).enumerate().for_each(|(strip, values)| {
            let first = strip * STRIP;
            let count = STRIP.min(m - first);
            let rows = (count + half).min(m - first);
            let mut squares = Mat::<f64>::zeros(rows, count);
            let (left, right) = (ordered.get(first..first + rows, ..), ordered.get(first..first + count, ..));
            matmul(squares.as_mut(), Accum::Replace, left, right.transpose(), 1.0, Par::Seq);
            for (j, column) in values.chunks_exact_mut(half + 1).enumerate() {
                let squares = &squares.col_as_slice(j)[j..];
                column.iter_mut().zip(squares).for_each(|(entry, square)| *entry += square);
            }
        });
    }
}
