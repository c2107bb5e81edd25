//! The forecast: tangent-linear columns a few at a time; only the band of their covariance is kept.

use super::band::Band;
use super::{BATCH, Banded, Memory};
use crate::error::Error;
use crate::filter::Cycle;
use crate::linalg::{cholesky, product, semidefinite_root, solve_lower, solve_lower_transposed};
use crate::memory::Matrix;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use isobar_model::vector::{add, scale};
use isobar_model::{State, forecast};
use rayon::prelude::*;

/// Columns of the band that are worked out together.
const STRIP: usize = 64;

impl Banded {
    /// x ← M(x), and the band of `A L W⁻¹ Lᵀ Aᵀ + Q`.
    ///
    /// The biases drift, c ← φ c + w, w ~ N(0, Q_c); what the state has in common with the new ones is by regression
    /// `T ← A T P_c φ (φ P_c φ + Q_c)⁻¹`, and the rest, `A T (P_c⁻¹ + φ Q_c⁻¹ φ)⁻¹ Tᵀ Aᵀ`, belongs to the band.
    pub(super) fn propagate(&mut self, x: &mut State, cycle: &Cycle<'_>) -> Result<(), Error> {
        let (m, p) = (self.memory.coupling.nrows(), self.memory.coupling.ncols());
        let start = x.clone();
        let mut band = (*self.model_error).clone();
        scale(band.values_mut(), cycle.error_factor);
        for first in (0..m).step_by(BATCH) {
            let count = BATCH.min(m - first);
            let mut columns = vec![0.0; m * count];
            columns.par_chunks_mut(m).enumerate().for_each(|(number, column)| {
                let mut unit = vec![0.0; m];
                unit[first + number] = 1.0;
                self.memory.information.solve_lower_transposed(&mut unit);
                column.copy_from_slice(&self.in_state_order(&self.memory.root.multiply(&unit)));
            });
            let mut state = start.clone();
            forecast::forecast_tl(cycle.model, &mut state, &mut columns, cycle.steps)?;
            *x = state;
            self.add_squares(&mut band, MatRef::from_column_major_slice(&columns, m, count));
        }
        if p > 0 {
            let coupling = &self.memory.coupling;
            let mut columns: Vec<f64> = (0..p).flat_map(|k| coupling.col_as_slice(k)).copied().collect();
            forecast::forecast_tl(cycle.model, &mut start.clone(), &mut columns, cycle.steps)?;
            self.memory.coupling = Matrix(MatRef::from_column_major_slice(&columns, m, p).to_owned());
            if let Some(lost) = self.walk(cycle)? {
                self.add_squares(&mut band, lost.as_ref());
            }
        }
        self.memory.information = Band::identity(m);
        (self.memory.root, self.memory.taper) = band.covariance_factor()?;
        Ok(())
    }

    /// Lets the biases drift; returns a root of the state's covariance that they no longer explain.
    fn walk(&mut self, cycle: &Cycle<'_>) -> Result<Option<Mat<f64>>, Error> {
        let Memory { coupling, bias_covariance, widening, .. } = &mut self.memory;
        let p = coupling.ncols();
        let mut walk = std::mem::replace(&mut widening.0, Mat::zeros(p, p));
        (0..p).for_each(|k| walk[(k, k)] += cycle.drift(k));
        let kept = cycle.kept();
        if kept.is_none() && (0..p).all(|k| walk[(k, k)] == 0.0) {
            return Ok(None);
        }
        let kept = kept.unwrap_or_else(|| vec![1.0; p]);
        let decayed = Mat::from_fn(p, p, |i, j| kept[i] * bias_covariance[(i, j)]);
        let after = Mat::from_fn(p, p, |i, j| decayed[(i, j)] * kept[j] + walk[(i, j)]);
        // F = (φ P_c φ + Q_c)⁻¹ φ P_c, and P_c − P_c φ F = (P_c⁻¹ + φ Q_c⁻¹ φ)⁻¹ = Fᵀ Q_c φ⁻¹.
        let root = cholesky(after.clone(), || "the covariance of the calibration".into())?;
        bias_covariance.0 = after;
        let mut regression = decayed;
        solve_lower(root.as_ref(), regression.as_mut());
        solve_lower_transposed(root.as_ref(), regression.as_mut());
        let walk = Mat::from_fn(p, p, |i, j| walk[(i, j)] / kept[j]);
        let rest = product(regression.transpose(), walk.as_ref());
        let rest = Mat::from_fn(p, p, |i, j| 0.5 * (rest[(i, j)] + rest[(j, i)]));
        let lost = product(coupling.as_ref(), semidefinite_root(rest.as_ref()).as_ref());
        *coupling = Matrix(product(coupling.as_ref(), regression.transpose()));
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
                let within = squares.len().min(column.len());
                add(&mut column[..within], &squares[..within]);
            }
        });
    }
}
