//! The rows of F^y.

use super::factor::Target;
use super::observed::Coefficients;
use super::{Amplitude, TimeVolume};
use crate::error::Error;
use crate::errors::blocks::SplitRows;
use crate::problem::Innovations;
use isobar_obs::{ObservationWindow, SparseRows};

/// The observations' rows after the scaling of free columns have this norm each, with which the nominal prior is 10⁻⁶ of
/// what they say.
const NORM: f64 = 1e3;

impl TimeVolume {
    /// F^y at the observations.
    pub(super) fn coefficients(&self, observed: &ObservationWindow) -> Vec<Coefficients> {
        let s = &self.memory.s;
        let jacobian = observed.operator.linearize(&s.state, &s.bias[..self.parameters()]).calibration;
        let layout = s.state.layout();
        let entry = |amplitude: &Amplitude, row: usize| {
            let factor = &self.settings.factors[amplitude.factor];
            let Target::Observations(numbers) = &factor.target else { return 0.0 };
            let entries = jacobian.row(row).iter().filter(|entry| numbers.contains(&entry.0));
            let weight: f64 = entries.map(|entry| entry.1).sum();
            if weight == 0.0 {
                return 0.0;
            }
            let place = factor.at_report(amplitude.pattern, &observed.reports[row], layout);
            weight * place * factor.shape.value(amplitude.function, observed.time)
        };
        let entries = |amplitudes: &[Amplitude], row: usize| {
            let all = amplitudes.iter().enumerate().map(|(number, amplitude)| (number, entry(amplitude, row)));
            all.filter(|entry| entry.1 != 0.0).collect()
        };
        let of_row =
            |row| Coefficients { constant: entries(&self.constant, row), evolving: entries(&self.evolving, row) };
        (0..observed.len()).map(of_row).collect()
    }

    /// Innovations about the estimate as it stands, with rows of the evolving amplitudes among those of the calibration.
    pub(super) fn innovations(
        &self,
        observed: &ObservationWindow,
        coefficients: &[Coefficients],
    ) -> Result<Innovations, Error> {
        let (p, s) = (self.parameters(), &self.memory.s);
        let mut innovations = self.problem.innovations(observed, &s.state, &s.bias[..p])?;
        let mut calibration = SparseRows::new();
        for (row, own) in coefficients.iter().enumerate() {
            let of_evolving = own.evolving.iter().map(|&(number, value)| (p + number, value));
            calibration.push_row(innovations.jacobian.calibration.row(row).iter().copied().chain(of_evolving.clone()));
            let constant: f64 = own.constant.iter().map(|&(k, value)| value * self.memory.reference[k]).sum();
            let evolving: f64 = of_evolving.map(|(number, value)| value * s.bias[number]).sum();
            innovations.departures[row] -= constant + evolving;
        }
        innovations.jacobian.calibration = calibration;
        Ok(innovations)
    }

    /// For each unknown C what makes its column of the whitened H U + F^y have the norm that suits the nominal prior.
    pub(super) fn scales(&self, rows: &SplitRows, variance: &[f64]) -> Vec<f64> {
        let own = &self.memory.sensitivity;
        let p = own.shared.nrows();
        let scale = |k: usize| {
            let of_shared = |&(number, weight): &(usize, f64)| {
                if number < p {
                    weight * own.shared[(number, k)]
                } else if number - p == k {
                    weight
                } else {
                    0.0
                }
            };
            let value = |row: usize| {
                let of_block = rows.block.row(row).iter().map(|it| it.1 * own.value(it.0, k));
                of_block.sum::<f64>() + rows.shared.row(row).iter().map(of_shared).sum::<f64>()
            };
            let squared: f64 = variance.iter().enumerate().map(|(row, variance)| value(row).powi(2) / variance).sum();
            if squared > 0.0 { NORM / squared.sqrt() } else { 1.0 }
        };
        (0..self.unknowns()).map(scale).collect()
    }
}
