//! The estimate with all that the unknowns C add to it, and the report on them.

use super::correction::Correction;
use super::factor::Target;
use super::{Amplitude, TimeVolume};
use crate::error::Error;
use crate::errors::blocks::{BlockErrors, Factors};
use crate::estimate::Estimate;
use crate::estimated::{EstimatedParameter, EstimatesParameters};
use crate::filter::Errors;
use crate::high_pass::in_words;
use crate::linalg::squared_norm;
use isobar_model::Time;
use isobar_model::vector::axpy;

/// An evolving amplitude that keeps more than this share of the variance that it has without observations is not determined:
/// its standard deviation is not yet half of that.
const DETERMINED: f64 = 0.25;

/// What is believed at some time of (b, c) given C.
pub(super) struct Believed<'a> {
    /// ĉ given that C is the reference, `[p]`.
    pub bias: &'a [f64],
    /// Its rows of Φ.
    pub factors: &'a Factors,
    /// U.
    pub sensitivity: &'a Factors,
    pub time: Time,
}

impl TimeVolume {
    /// State and calibration as of now: a parameter with the factors that act on what it acts on, as far as they have no
    /// pattern in space.
    pub(super) fn estimate(&self) -> Result<Estimate, Error> {
        let (s, variances) = (&self.memory.s, self.errors.variances());
        let (state, bias) = (s.state.clone(), s.bias.clone());
        let part = |number| self.errors.part(number);
        let given = Estimate::with_variances(state, bias, &self.calibration, &variances, BlockErrors::NAME, part)?;
        Ok(self.with_unknowns(given, &self.now(), |number| self.errors.own_variance(number)))
    }

    fn now(&self) -> Believed<'_> {
        let super::Memory { s, sensitivity, time, .. } = &self.memory;
        Believed { bias: &s.bias, factors: self.errors.factors(), sensitivity, time: *time }
    }

    /// An estimate given C with what C adds to it, where `beside_factors` is the variance that a parameter has beside Φ.
    pub(super) fn with_unknowns(
        &self,
        mut estimate: Estimate,
        believed: &Believed<'_>,
        beside_factors: impl Fn(usize) -> f64,
    ) -> Estimate {
        let p = self.parameters();
        if let Some(spread) = &mut estimate.state_spread {
            let mut variances: Vec<f64> = spread.iter().map(|sigma| sigma * sigma).collect();
            let mut columns = believed.sensitivity.state.clone();
            columns.recombine(None, self.memory.posterior.root.as_ref());
            columns.add_squared_rows(0, &mut variances);
            *spread = variances.into_iter().map(f64::sqrt).collect();
        }
        estimate.calibration.truncate(p);
        let mut spread = vec![0.0; p];
        for number in 0..p {
            let (value, variance) = self.parameter_at(number, believed, beside_factors(number));
            estimate.calibration[number] += value;
            spread[number] = variance.sqrt();
        }
        estimate.calibration_spread = (p > 0).then_some(spread);
        estimate
    }

    /// With which weights constant and evolving amplitudes add to a calibration parameter at a time.
    pub(super) fn heights(&self, number: usize, time: Time) -> (Vec<f64>, Vec<f64>) {
        let height = |amplitude: &Amplitude| {
            let factor = &self.settings.factors[amplitude.factor];
            match &factor.target {
                Target::Observations(numbers) if numbers.contains(&number) && amplitude.pattern.is_none() => {
                    factor.shape.value(amplitude.function, time)
                }
                _ => 0.0,
            }
        };
        (self.constant.iter().map(height).collect(), self.evolving.iter().map(height).collect())
    }

    /// Whether the observations have determined an evolving amplitude: its variance beside that which it has without them.
    fn evolving_verdict(&self, amplitude: &Amplitude, variance: f64) -> String {
        let evolution = self.settings.factors[amplitude.factor].evolution;
        let kept = variance / evolution.unobserved_variance(self.memory.time - self.settings.start);
        if kept <= DETERMINED {
            return "determined".into();
        }
        format!("not determined: it keeps {:.0} % of the variance it has without observations", 100.0 * kept)
    }

    /// What factors add to a calibration parameter at a time, and the variance of the sum.
    fn parameter_at(&self, number: usize, believed: &Believed<'_>, beside_factors: f64) -> (f64, f64) {
        let Believed { bias, factors, sensitivity, time } = *believed;
        let errors = &self.errors;
        let mut common = errors.row_of_parameter(factors, number);
        let mut weights = errors.row_of_parameter(sensitivity, number);
        let (of_constant, of_evolving) = self.heights(number, time);
        let mut value = 0.0;
        for (k, height) in of_constant.into_iter().enumerate() {
            value += height * self.memory.reference[k];
            weights[k] += height;
        }
        for (k, height) in of_evolving.into_iter().enumerate() {
            let amplitude = self.parameters() + k;
            value += height * bias[amplitude];
            axpy(height, &errors.row_of_parameter(factors, amplitude), &mut common);
            axpy(height, &errors.row_of_parameter(sensitivity, amplitude), &mut weights);
        }
        let known = self.memory.posterior.sigma(&weights).powi(2);
        (value, beside_factors.max(0.0) + squared_norm(&common) + known)
    }
}

impl EstimatesParameters for TimeVolume {
    /// All amplitudes and corrections.
    fn estimated_parameters(&self) -> Vec<EstimatedParameter> {
        let q = self.unknowns();
        let corrections = self.corrections.iter().flat_map(|transition| {
            let name = |it: &Correction| (format!("transition/{}", it.name), transition.candidate(it).unit.clone());
            transition.amplitudes.iter().map(name)
        });
        let names: Vec<(String, String)> =
            self.constant.iter().map(|it| (it.name.clone(), it.unit.clone())).chain(corrections).collect();
        let combinations: Vec<Vec<(f64, String)>> = (self.memory.posterior.undetermined.iter())
            .map(|it| it.iter().zip(&names).filter(|it| *it.0 != 0.0).map(|(c, name)| (*c, name.0.clone())).collect())
            .collect();
        let (total, precisions) = (self.known(), &self.memory.precisions);
        let solved = self.solve_window();
        let constant = (0..q).map(|k| {
            let unit: Vec<f64> = (0..q).map(|j| f64::from(u8::from(j == k))).collect();
            let undetermined: Vec<String> = (self.memory.posterior.undetermined.iter().zip(&combinations))
                .filter(|(combination, _)| combination[k] != 0.0)
                .map(|(_, words)| in_words(words))
                .collect();
            let correlation = || self.score(&total, &solved, precisions, k);
            let verdict = match (self.memory.active[k], undetermined.is_empty()) {
                (true, true) if precisions[k] > 0.0 => format!(
                    "not chosen, estimated with others: a prior of {:.2} was found, its correlation with the innovations is \
                     {:.1} sigma",
                    precisions[k].sqrt().recip(),
                    correlation().unwrap_or(0.0)
                ),
                (true, true) => "determined".to_string(),
                (true, false) => format!("not determined: {}", undetermined.join("; ")),
                (false, _) => match correlation() {
                    Some(score) => format!("not chosen: its correlation with the innovations is {score:.1} sigma"),
                    None => "not chosen: what is chosen leaves nothing of it to be seen".to_string(),
                },
            };
            let sigma = (self.memory.active[k] && undetermined.is_empty()).then(|| self.memory.posterior.sigma(&unit));
            let (name, unit) = names[k].clone();
            EstimatedParameter { name, unit, value: self.memory.reference[k], sigma, verdict }
        });
        let evolving = self.evolving.iter().enumerate().map(|(k, amplitude)| {
            let number = self.parameters() + k;
            let own = self.errors.row_of_parameter(self.errors.factors(), number);
            let weights = self.errors.row_of_parameter(&self.memory.sensitivity, number);
            let variance = squared_norm(&own) + self.memory.posterior.sigma(&weights).powi(2);
            EstimatedParameter {
                name: amplitude.name.clone(),
                unit: amplitude.unit.clone(),
                value: self.memory.s.bias[number],
                sigma: Some(variance.sqrt()),
                verdict: self.evolving_verdict(amplitude, variance),
            }
        });
        constant.chain(evolving).collect()
    }
}
