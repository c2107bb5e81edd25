//! The analysis: banded normal equations of the state, bordered by the calibration parameters.

use super::BandedKalmanFilter;
use super::band::Band;
use crate::error::Error;
use crate::linalg::{
    add_symmetric_product, cholesky, column, product, semidefinite_root, solve_lower, solve_lower_transposed,
    squared_norm,
};
use crate::problem::Innovations;
use faer::Mat;

/// R^-½ H L of one observation: zero but for these columns.
struct Row {
    first: usize,
    values: Vec<f64>,
}

impl BandedKalmanFilter {
    /// Takes in the observations; returns the normalised innovation squared, which is the least value of
    /// `|R^-½ (d − H L χ − G̃ c)|² + |χ|² + cᵀ P_c⁻¹ c`.
    pub(super) fn take(&mut self, innovations: &Innovations) -> Result<f64, Error> {
        let (m, p, n) = (self.state.values().len(), self.calibration.len(), innovations.variance.len());
        let rows: Vec<Row> = (0..n).map(|row| self.row(innovations, row)).collect();
        // R^-½ G̃ and R^-½ d.
        let mut border = Mat::zeros(n, p);
        for row in 0..n {
            let scale = 1.0 / innovations.variance[row].sqrt();
            for &(index, weight) in innovations.jacobian.state.row(row) {
                (0..p).for_each(|k| border[(row, k)] += scale * weight * self.coupling[(index, k)]);
            }
            for &(parameter, weight) in innovations.jacobian.calibration.row(row) {
                border[(row, parameter)] += scale * weight;
            }
        }
        let departures = innovations.whiten(innovations.departures.clone());

        // W, B and (H L)ᵀ R⁻¹ d.
        let widest = rows.iter().map(|row| row.values.len()).max().unwrap_or(1).max(1);
        let mut normal = Band::zeros(m, widest - 1);
        let width = normal.half() + 1;
        normal.values_mut().iter_mut().step_by(width).for_each(|diagonal| *diagonal = 1.0);
        let (mut b, mut right) = (Mat::<f64>::zeros(m, p), vec![0.0; m]);
        for (number, row) in rows.iter().enumerate() {
            normal.add_square(row.first, &row.values);
            let add = |to: &mut [f64], factor: f64| {
                let to = &mut to[row.first..row.first + row.values.len()];
                to.iter_mut().zip(&row.values).for_each(|(to, value)| *to += factor * value);
            };
            add(&mut right, departures[number]);
            (0..p).for_each(|k| add(b.col_as_slice_mut(k), border[(number, k)]));
        }
        let information = normal.cholesky("the banded information matrix I + L' H' R^-1 H L")?;

        // With c = U ξ, P_c = U Uᵀ, the Schur complement of (26) is I + Uᵀ (G̃ᵀ R⁻¹ G̃ − Bᵀ W⁻¹ B) U.
        let mut whitened = b.clone();
        (0..p).for_each(|k| information.solve_lower(0, whitened.col_as_slice_mut(k)));
        let mut whitened_right = right.clone();
        information.solve_lower(0, &mut whitened_right);
        let mut schur = product(border.transpose(), border.as_ref());
        add_symmetric_product(schur.as_mut(), -1.0, whitened.transpose(), whitened.as_ref());
        let prior = semidefinite_root(self.bias_covariance.as_ref());
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
        for (k, c) in biases.iter().enumerate() {
            whitened_right.iter_mut().zip(whitened.col_as_slice(k)).for_each(|(value, b)| *value -= b * c);
        }
        let mut chi = whitened_right;
        information.solve_lower_transposed(&mut chi);
        let mut increment = self.in_state_order(&self.root.multiply(&chi));
        for (k, c) in biases.iter().enumerate() {
            increment.iter_mut().zip(self.coupling.col_as_slice(k)).for_each(|(value, t)| *value += t * c);
        }
        let mut misfit = departures;
        for (number, row) in rows.iter().enumerate() {
            let of_state: f64 = row.values.iter().zip(&chi[row.first..]).map(|(h, chi)| h * chi).sum();
            let of_biases: f64 = biases.iter().enumerate().map(|(k, c)| border[(number, k)] * c).sum();
            misfit[number] -= of_state + of_biases;
        }
        let amplitudes: f64 = (0..p).map(|k| amplitudes[(k, 0)].powi(2)).sum();
        let chi2 = squared_norm(&misfit) + squared_norm(&chi) + amplitudes;

        self.state.values_mut().iter_mut().zip(&increment).for_each(|(value, change)| *value += change);
        self.bias.iter_mut().zip(&biases).for_each(|(value, change)| *value += change);
        // T ← T − L W⁻¹ B and P_c ← U (Schur complement)⁻¹ Uᵀ.
        for k in 0..p {
            let gain = whitened.col_as_slice_mut(k);
            information.solve_lower_transposed(gain);
            let change = self.in_state_order(&self.root.multiply(gain));
            self.coupling.col_as_slice_mut(k).iter_mut().zip(change).for_each(|(t, change)| *t -= change);
        }
        let mut half = prior.transpose().to_owned();
        solve_lower(root.as_ref(), half.as_mut());
        let mut posterior = Mat::zeros(p, p);
        add_symmetric_product(posterior.as_mut(), 1.0, half.transpose(), half.as_ref());
        self.bias_covariance = posterior;
        self.information = Some(information);
        Ok(chi2)
    }

    fn row(&self, innovations: &Innovations, row: usize) -> Row {
        let entries = innovations.jacobian.state.row(row);
        let places = || entries.iter().map(|&(index, _)| self.position[index]);
        let (Some(least), Some(last)) = (places().min(), places().max()) else {
            return Row { first: 0, values: Vec::new() };
        };
        let first = self.root.first(least);
        let mut values = vec![0.0; last + 1 - first];
        let scale = 1.0 / innovations.variance[row].sqrt();
        for &(index, weight) in entries {
            let place = self.position[index];
            for j in self.root.first(place)..=place {
                values[j - first] += scale * weight * self.root.entry(place, j);
            }
        }
        Row { first, values }
    }
}
