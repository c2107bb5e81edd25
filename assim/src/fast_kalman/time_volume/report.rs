//! The estimate with all that the unknowns C add to it, and what is told of them.

use super::factor::Target;
use super::{Amplitude, TimeVolume};
use crate::assimilator::Estimate;
use crate::error::Error;
use crate::estimated::EstimatedParameter;
use crate::high_pass::in_words;
use faer::{Mat, MatRef};

impl TimeVolume {
    /// State and calibration as of now: a parameter with the factors that act on what it acts on, as far as they have no
    /// pattern in space.
    pub(super) fn estimate(&self) -> Result<Estimate, Error> {
        let mut estimate = self.filter.estimate()?;
        let root = &self.posterior.root;
        if let Some(spread) = &mut estimate.state_spread {
            let mut variances: Vec<f64> = spread.iter().map(|sigma| sigma * sigma).collect();
            let mut columns = self.sensitivity.state.clone();
            columns.recombine(None, root.as_ref());
            columns.add_squared_rows(&mut variances);
            *spread = variances.into_iter().map(f64::sqrt).collect();
        }
        estimate.calibration.truncate(self.parameters);
        let mut spread = estimate.calibration_spread.take().unwrap_or_default();
        spread.truncate(self.parameters);
        for number in 0..self.parameters {
            let (value, variance) = self.parameter_now(number);
            estimate.calibration[number] += value;
            spread[number] = variance.sqrt();
        }
        estimate.calibration_spread = (!spread.is_empty()).then_some(spread);
        Ok(estimate)
    }

    /// With which weights constant and evolving amplitudes add to a calibration parameter now.
    pub(super) fn heights(&self, number: usize) -> (Vec<f64>, Vec<f64>) {
        let height = |amplitude: &Amplitude| {
            let factor = &self.settings.factors[amplitude.factor];
            match &factor.target {
                Target::Observations(numbers) if numbers.contains(&number) && amplitude.pattern.is_none() => {
                    factor.shape.value(amplitude.function, self.time)
                }
                _ => 0.0,
            }
        };
        (self.constant.iter().map(height).collect(), self.evolving.iter().map(height).collect())
    }

    /// What factors add to a calibration parameter now, and the variance of the sum.
    fn parameter_now(&self, number: usize) -> (f64, f64) {
        let filter = &self.filter;
        let (factors, m) = (&filter.covariance.factors, filter.state.values().len());
        let mut own_variance = 0.0;
        let (mut common, mut weights) = match filter.shared.iter().position(|&it| it == number) {
            Some(row) => (row_of(&factors.shared, row), row_of(&self.sensitivity.shared, row)),
            None => {
                let row = filter.local.iter().position(|&it| it == number).expect("it is shared or local");
                let (block, position) = filter.blocks.place(m + row);
                own_variance = filter.covariance.own.block(&filter.blocks, block)[(position, position)];
                let of = |columns: &super::Factors| {
                    (0..columns.columns()).map(|k| columns.local.column(k)[row]).collect::<Vec<f64>>()
                };
                (of(factors), of(&self.sensitivity))
            }
        };
        let (of_constant, of_evolving) = self.heights(number);
        let mut value = 0.0;
        for (k, height) in of_constant.into_iter().enumerate() {
            value += height * self.reference[k];
            weights[k] += height;
        }
        let first = filter.shared.len() - self.evolving.len();
        for (k, height) in of_evolving.into_iter().enumerate() {
            value += height * filter.bias[self.parameters + k];
            for (own, row) in [(&mut common, &factors.shared), (&mut weights, &self.sensitivity.shared)] {
                own.iter_mut().enumerate().for_each(|(j, own)| *own += height * row[(first + k, j)]);
            }
        }
        let of_factors: f64 = common.iter().map(|it| it * it).sum();
        (value, own_variance.max(0.0) + of_factors + self.posterior.sigma(&weights).powi(2))
    }

    /// All amplitudes and corrections.
    pub(super) fn estimated(&self) -> Vec<EstimatedParameter> {
        let (q, first) = (self.unknowns(), self.constant.len());
        let candidates = self.corrections.iter().flat_map(|it| it.candidates());
        let corrections = candidates.map(|it| (format!("transition/{}", it.name), it.unit.clone()));
        let names: Vec<(String, String)> =
            self.constant.iter().map(|it| (it.name.clone(), it.unit.clone())).chain(corrections).collect();
        let combinations: Vec<Vec<(f64, String)>> = (self.posterior.undetermined.iter())
            .map(|it| it.iter().zip(&names).filter(|it| *it.0 != 0.0).map(|(c, name)| (*c, name.0.clone())).collect())
            .collect();
        let total = self.window.total();
        let constant = (0..q).map(|k| {
            let unit: Vec<f64> = (0..q).map(|j| f64::from(u8::from(j == k))).collect();
            let undetermined: Vec<String> = (self.posterior.undetermined.iter().zip(&combinations))
                .filter(|(combination, _)| combination[k] != 0.0)
                .map(|(_, words)| in_words(words))
                .collect();
            let verdict = match (self.active[k], undetermined.is_empty()) {
                (true, true) => "determined".to_string(),
                (true, false) => format!("not determined: {}", undetermined.join("; ")),
                (false, _) => match self.score(&total, &self.active, k) {
                    Some(score) => format!("not chosen: its correlation with the innovations is {score:.1} sigma"),
                    None => "not chosen: what is chosen leaves nothing of it to be seen".to_string(),
                },
            };
            let sigma = (self.active[k] && undetermined.is_empty()).then(|| self.posterior.sigma(&unit));
            let (name, unit) = names[k].clone();
            EstimatedParameter { name, unit, value: self.reference[k], sigma, verdict }
        });
        debug_assert!(first <= q);
        let filter = &self.filter;
        let shared_of = filter.shared.len() - self.evolving.len();
        let evolving = self.evolving.iter().enumerate().map(|(k, amplitude)| {
            let own = row_of(&filter.covariance.factors.shared, shared_of + k);
            let weights = row_of(&self.sensitivity.shared, shared_of + k);
            let variance = own.iter().map(|it| it * it).sum::<f64>() + self.posterior.sigma(&weights).powi(2);
            EstimatedParameter {
                name: amplitude.name.clone(),
                unit: amplitude.unit.clone(),
                value: filter.bias[self.parameters + k],
                sigma: Some(variance.sqrt()),
                verdict: "determined".into(),
            }
        });
        constant.chain(evolving).collect()
    }

    /// A calibration from elsewhere, to which the sensitivities to C do not matter any more.
    pub(super) fn take_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let (p, all) = (self.parameters, self.filter.bias.len());
        if estimate.len() != p || covariance.nrows() != p {
            return Err(Error::Setting("the calibration is not the one that the method estimates".into()));
        }
        let mut extended = estimate.to_vec();
        extended.resize(all, 0.0);
        let prior = |number: usize| self.filter.problem.calibration.parameters[number].sigma_prior.powi(2);
        let joint = Mat::from_fn(all, all, |i, j| match (i < p && j < p, i == j) {
            (true, _) => covariance[(i, j)],
            (false, true) => prior(i),
            (false, false) => 0.0,
        });
        super::super::calibration::set(&mut self.filter, &extended, joint.as_ref())
    }

    /// Adds a covariance to that of the parameters given C: what is added is independent of C, and of what the cycles of the
    /// window have said of it.
    pub(super) fn widen(&mut self, covariance: MatRef<'_, f64>) {
        let (p, all) = (self.parameters, self.filter.bias.len());
        let joint = Mat::from_fn(all, all, |i, j| if i < p && j < p { covariance[(i, j)] } else { 0.0 });
        super::super::calibration::widen(&mut self.filter, joint.as_ref());
    }
}

fn row_of(matrix: &Mat<f64>, row: usize) -> Vec<f64> {
    (0..matrix.ncols()).map(|j| matrix[(row, j)]).collect()
}
