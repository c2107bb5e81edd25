//! The analysis: banded normal equations of the state, bordered by the calibration parameters.

use super::band::Band;
use super::{Banded, Memory};
use crate::error::Error;
use crate::linalg::{
    add_symmetric_product, cholesky, column, product, semidefinite_root, solve_lower, solve_lower_transposed,
    squared_norm,
};
use crate::memory::Matrix;
use crate::problem::Innovations;
use faer::Mat;
use isobar_model::vector::{axpy, dot, subtract};

/// R^-½ H L of one observation: zero but for these columns.
struct Row {
    first: usize,
    values: Vec<f64>,
}

/// What an analysis adds to (x, c), `[m + p]`, and the normalised innovation squared.
pub(super) struct BandedAnalysis {
    pub increment: Vec<f64>,
    pub chi2: f64,
}

impl Banded {
    /// Takes the observations into W, T and P_c. The normalised innovation squared is the least value of
    /// `|R^-½ (d − H L χ − G̃ c)|² + χᵀ W χ + cᵀ P_c⁻¹ c`, with the W of before.
    pub(super) fn take(&mut self, innovations: &Innovations) -> Result<BandedAnalysis, Error> {
        let rows: Vec<Row> = (0..innovations.len()).map(|row| self.row(innovations, row)).collect();
        let Memory { root: forecast_root, information: before, coupling, bias_covariance, .. } = &self.memory;
        let (m, p, n) = (coupling.nrows(), coupling.ncols(), innovations.len());
        // R^-½ G̃ and R^-½ d.
        let mut border = Mat::zeros(n, p);
        for row in 0..n {
            let scale = 1.0 / innovations.variance[row].sqrt();
            for &(index, weight) in innovations.jacobian.state.row(row) {
                (0..p).for_each(|k| border[(row, k)] += scale * weight * coupling[(index, k)]);
            }
            for &(parameter, weight) in innovations.jacobian.calibration.row(row) {
                border[(row, parameter)] += scale * weight;
            }
        }
        let departures = innovations.whiten(innovations.departures.clone());

        // W, B and (H L)ᵀ R⁻¹ d.
        let widest = rows.iter().map(|row| row.values.len()).max().unwrap_or(1).max(before.half() + 1);
        let mut normal = Band::zeros(m, widest - 1);
        (0..m).for_each(|k| normal.add_square(k, before.column(k)));
        let (mut b, mut right) = (Mat::<f64>::zeros(m, p), vec![0.0; m]);
        for (number, row) in rows.iter().enumerate() {
            normal.add_square(row.first, &row.values);
            let part = row.first..row.first + row.values.len();
            axpy(departures[number], &row.values, &mut right[part.clone()]);
            (0..p).for_each(|k| axpy(border[(number, k)], &row.values, &mut b.col_as_slice_mut(k)[part.clone()]));
        }
        let information = normal.cholesky("the banded information matrix I + L' H' R^-1 H L")?;

        // With c = U ξ, P_c = U Uᵀ, the Schur complement of (26) is I + Uᵀ (G̃ᵀ R⁻¹ G̃ − Bᵀ W⁻¹ B) U.
        let mut whitened = b.clone();
        (0..p).for_each(|k| information.solve_lower(0, whitened.col_as_slice_mut(k)));
        let mut whitened_right = right.clone();
        information.solve_lower(0, &mut whitened_right);
        let mut schur = product(border.transpose(), border.as_ref());
        add_symmetric_product(schur.as_mut(), -1.0, whitened.transpose(), whitened.as_ref());
        let prior = semidefinite_root(bias_covariance.as_ref());
        let schur = product(prior.transpose(), product(schur.as_ref(), prior.as_ref()).as_ref());
        let schur = Mat::from_fn(p, p, |i, j| schur[(i, j)] + if i == j { 1.0 } else { 0.0 });
        let root = cholesky(schur, || "the Schur complement of the calibration".into())?;
        let score = product(border.transpose(), column(&departures).as_ref())
            - product(whitened.transpose(), column(&whitened_right).as_ref());
        let mut amplitudes = product(prior.transpose(), score.as_ref());
        solve_lower(root.as_ref(), amplitudes.as_mut());
        solve_lower_transposed(root.as_ref(), amplitudes.as_mut());
        let biases = product(prior.as_ref(), amplitudes.as_ref());
        let biases: Vec<f64> = (0..p).map(|k| biases[(k, 0)]).collect();

        // χ = W⁻¹ ((H L)ᵀ R⁻¹ d − B c), δx = L χ + T c.
        (0..p).for_each(|k| axpy(-biases[k], whitened.col_as_slice(k), &mut whitened_right));
        let mut chi = whitened_right;
        information.solve_lower_transposed(&mut chi);
        let mut increment = self.in_state_order(&forecast_root.multiply(&chi));
        (0..p).for_each(|k| axpy(biases[k], coupling.col_as_slice(k), &mut increment));
        let mut misfit = departures;
        for (number, row) in rows.iter().enumerate() {
            let of_state = dot(&row.values, &chi[row.first..][..row.values.len()]);
            let of_biases: f64 = biases.iter().enumerate().map(|(k, c)| border[(number, k)] * c).sum();
            misfit[number] -= of_state + of_biases;
        }
        let amplitudes: f64 = (0..p).map(|k| amplitudes[(k, 0)].powi(2)).sum();
        let chi2 = squared_norm(&misfit) + squared_norm(&before.multiply_transposed(&chi)) + amplitudes;
        increment.extend(biases);

        // T ← T − L W⁻¹ B and P_c ← U (Schur complement)⁻¹ Uᵀ.
        let mut coupling = coupling.clone();
        for k in 0..p {
            let gain = whitened.col_as_slice_mut(k);
            information.solve_lower_transposed(gain);
            subtract(coupling.col_as_slice_mut(k), &self.in_state_order(&forecast_root.multiply(gain)));
        }
        let mut half = prior.transpose().to_owned();
        solve_lower(root.as_ref(), half.as_mut());
        let mut posterior = Mat::zeros(p, p);
        add_symmetric_product(posterior.as_mut(), 1.0, half.transpose(), half.as_ref());
        self.memory.coupling = coupling;
        self.memory.bias_covariance = Matrix(posterior);
        self.memory.information = information;
        Ok(BandedAnalysis { increment, chi2 })
    }

    fn row(&self, innovations: &Innovations, row: usize) -> Row {
        let entries = innovations.jacobian.state.row(row);
        let places = || entries.iter().map(|&(index, _)| self.position[index]);
        let (Some(least), Some(last)) = (places().min(), places().max()) else {
            return Row { first: 0, values: Vec::new() };
        };
        let root = &self.memory.root;
        let first = root.first(least);
        let mut values = vec![0.0; last + 1 - first];
        let scale = 1.0 / innovations.variance[row].sqrt();
        for &(index, weight) in entries {
            let place = self.position[index];
            for j in root.first(place)..=place {
                values[j - first] += scale * weight * root.entry(place, j);
            }
        }
        Row { first, values }
    }
}
