//! The rows of F^y.

use super::super::analysis::SplitRows;
use super::factor::Target;
use super::{Amplitude, NORM, TimeVolume};
use crate::error::Error;
use crate::problem::Innovations;
use isobar_obs::{ObservationWindow, SparseRows};

/// A row of F^y: entries by the number of the amplitude.
pub(super) struct Coefficients {
    /// Of the unknowns C.
    pub constant: Vec<(usize, f64)>,
    /// Of the evolving amplitudes.
    pub evolving: Vec<(usize, f64)>,
}

impl TimeVolume {
    /// F^y at the observations.
    pub(super) fn coefficients(&self, observed: &ObservationWindow) -> Vec<Coefficients> {
        let filter = &self.filter;
        let jacobian = observed.operator.linearize(&filter.state, &filter.bias[..self.parameters]).calibration;
        let layout = filter.state.layout();
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
        let p = self.parameters;
        let filter = &self.filter;
        let mut innovations = filter.problem.innovations(observed, &filter.state, &filter.bias[..p])?;
        let mut calibration = SparseRows::new();
        for (row, own) in coefficients.iter().enumerate() {
            let of_evolving = own.evolving.iter().map(|&(number, value)| (p + number, value));
            calibration.push_row(innovations.jacobian.calibration.row(row).iter().copied().chain(of_evolving.clone()));
            let constant: f64 = own.constant.iter().map(|&(k, value)| value * self.reference[k]).sum();
            let evolving: f64 = of_evolving.map(|(number, value)| value * filter.bias[number]).sum();
            innovations.departures[row] -= constant + evolving;
        }
        innovations.jacobian.calibration = calibration;
        Ok(innovations)
    }

    /// For each unknown C what makes its column of the whitened H U + F^y have the norm that suits the nominal prior.
    pub(super) fn scales(&self, rows: &SplitRows, variance: &[f64]) -> Vec<f64> {
        let p = self.sensitivity.shared.nrows();
        let scale = |k: usize| {
            let value = |row: usize| {
                let of_block = rows.block.row(row).iter().map(|it| it.1 * self.sensitivity.value(it.0, k));
                let of_shared = rows.shared.row(row).iter().map(|&(number, weight)| match number < p {
                    true => weight * self.sensitivity.shared[(number, k)],
                    false => {
                        if number - p == k {
                            weight
                        } else {
                            0.0
                        }
                    }
                });
                of_block.sum::<f64>() + of_shared.sum::<f64>()
            };
            let squared: f64 = variance.iter().enumerate().map(|(row, variance)| value(row).powi(2) / variance).sum();
            if squared > 0.0 { NORM / squared.sqrt() } else { 1.0 }
        };
        (0..self.unknowns()).map(scale).collect()
    }
}
