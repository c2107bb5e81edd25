//! The filter's parts and leading common factors, for viewers.

use super::FastKalmanFilter;
use crate::covariance::principal_rotation;
use crate::linalg::product;
use crate::structure::{CommonFactor, Structure};
use faer::{Mat, MatRef};
use isobar_model::Increment;
use isobar_obs::ObservationWindow;

impl FastKalmanFilter {
    /// The structure after the analysis of `observed`, with at most `count` factors.
    pub(super) fn structure_after(&self, observed: &ObservationWindow, count: usize) -> Structure {
        let mut part = vec![0; self.blocks.variables()];
        for (number, patch) in self.covariance.patches.iter().enumerate() {
            patch.variables.iter().for_each(|&variable| part[variable] = number);
        }
        let mut touched = vec![false; self.covariance.patches.len()];
        let rows = observed.operator.linearize(&self.state, &self.bias).state;
        for row in 0..rows.rows() {
            rows.row(row).iter().for_each(|&(variable, _)| touched[part[variable]] = true);
        }
        part.truncate(self.state.layout().grid.cells());
        Structure { part_of_cell: part, observed: touched, factors: self.leading_factors(count) }
    }

    /// The leading principal directions of Φ in the norm of the compression, Φ V with V from S⁻¹ Φ_b = U Σ Vᵀ: they are
    /// orthogonal in that norm, and all of them together have the same Φ Φᵀ.
    fn leading_factors(&self, count: usize) -> Vec<CommonFactor> {
        let factors = &self.covariance.block_factors;
        let (b, m, r) = (factors.nrows(), self.state.values().len(), factors.ncols());
        let count = count.min(r);
        if count == 0 {
            return Vec::new();
        }
        let scaled = Mat::from_fn(b, r, |i, j| factors[(i, j)] / self.scales[i]);
        let rotation = principal_rotation(scaled.as_ref());
        let leading = |all: MatRef<'_, f64>| product(all, rotation.as_ref().get(.., ..count));
        let (scaled, on_blocks) = (leading(scaled.as_ref()), leading(factors.as_ref()));
        let on_shared = leading(self.covariance.shared_factors.as_ref());
        let variances = self.covariance.block_variances();
        let total: f64 = variances.iter().zip(&self.scales).map(|(variance, scale)| variance / (scale * scale)).sum();
        let factor = |j: usize| {
            let energy: f64 = scaled.col_as_slice(j).iter().map(|value| value * value).sum();
            // A direction has no sign of its own: the largest value is positive.
            let largest = scaled.col_as_slice(j).iter().fold(0.0, |a: f64, &b| if b.abs() > a.abs() { b } else { a });
            let sign = if largest < 0.0 { -1.0 } else { 1.0 };
            let values = on_blocks.col_as_slice(j).iter().map(|value| sign * value).collect::<Vec<_>>();
            let mut calibration = vec![0.0; self.bias.len()];
            self.local.iter().zip(&values[m..]).for_each(|(&number, value)| calibration[number] = *value);
            self.shared.iter().enumerate().for_each(|(i, &number)| calibration[number] = sign * on_shared[(i, j)]);
            let increment = Increment::from_values(self.state.layout(), values[..m].to_vec());
            CommonFactor { increment, calibration, share: if total > 0.0 { energy / total } else { 0.0 } }
        };
        (0..count).map(factor).collect()
    }
}
