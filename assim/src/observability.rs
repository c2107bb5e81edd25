//! Which calibration parameters, and which combinations of them, the data determine.

use crate::calibration_accuracy::CalibrationAccuracy;
use crate::error::Error;
use crate::linalg::{cholesky, eigen, mirror_lower, product, solve_lower, solve_lower_transposed};
use crate::ties::first_largest;
use faer::{Mat, MatRef};
use isobar_model::vector::dot;

/// A parameter that keeps more than this share of its prior variance has not been observed at all.
const UNOBSERVED: f64 = 0.999;

/// A combination whose error is correlated so much with that of a mean of the state cannot be told from it.
const INSEPARABLE: f64 = 0.9;

/// The most sensors that are named as references.
const MOST_REFERENCES: usize = 20;

/// The accuracy S of the calibration parameters against their prior P, by the eigenvalues of S v = λ P v: the share of its
/// prior variance that each combination vᵀc of parameters still has (the degrees of freedom for signal are Σ (1 − λ),
/// Rodgers 2000, Inverse Methods for Atmospheric Sounding, section 2.4). Where λ is near 1, the data say nothing of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Observability {
    /// S_jj / P_jj of each parameter.
    pub variance_ratios: Vec<f64>,
    /// The combinations that keep more than the threshold of their prior variance, by descending share.
    pub undetermined: Vec<Combination>,
    /// The parameters whose exact knowledge (a reference sensor) would leave nothing undetermined, the most effective
    /// first; at most twenty.
    pub references: Vec<usize>,
}

/// A combination of calibration parameters that the data do not determine.
#[derive(Clone, Debug, PartialEq)]
pub struct Combination {
    /// How the parameters change along it, each in units of its prior standard deviation, the largest +1.
    pub direction: Vec<f64>,
    /// λ, the share of its prior variance that it still has.
    pub variance_ratio: f64,
    /// The mean of the state from which it cannot be told, if there is one.
    pub mean: Option<Inseparable>,
}

/// A mean over the domain whose error goes together with that of a combination of biases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inseparable {
    /// Number of the state's variable.
    pub variable: usize,
    /// Correlation of the errors.
    pub correlation: f64,
    /// The largest standard deviation of an unbiased observation of the mean that would bring the combination's share of its
    /// prior variance to the threshold: of an observation with variance r of the mean, whose variance is V, is left
    /// `λ (1 − ρ² V/(V + r))`.
    pub sigma_needed: f64,
}

impl Observability {
    /// Compares an accuracy with the covariance `prior` that the parameters would have without any observation,
    /// `[p, p]`; what keeps more than `threshold` of its prior variance is undetermined.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] for a prior that is no covariance.
    pub fn new(prior: MatRef<'_, f64>, accuracy: &CalibrationAccuracy, threshold: f64) -> Result<Self, Error> {
        let root = cholesky(prior.to_owned(), || "the prior covariance of the calibration parameters".into())?;
        let p = prior.nrows();
        let covariance = accuracy.covariance();
        let variance_ratios: Vec<f64> = (0..p).map(|j| covariance[(j, j)] / prior[(j, j)]).collect();
        let undetermined = undetermined(prior, root.as_ref(), accuracy, &variance_ratios, threshold);
        let references = references(root.as_ref(), covariance, threshold);
        Ok(Self { variance_ratios, undetermined, references })
    }
}

/// L⁻¹ S L⁻ᵀ with L Lᵀ = P.
fn whitened(root: MatRef<'_, f64>, covariance: MatRef<'_, f64>) -> Mat<f64> {
    let mut half = covariance.to_owned();
    solve_lower(root, half.as_mut());
    let mut whitened = half.transpose().to_owned();
    solve_lower(root, whitened.as_mut());
    mirror_lower(whitened.as_mut());
    whitened
}

fn undetermined(
    prior: MatRef<'_, f64>,
    root: MatRef<'_, f64>,
    accuracy: &CalibrationAccuracy,
    variance_ratios: &[f64],
    threshold: f64,
) -> Vec<Combination> {
    let p = variance_ratios.len();
    // Parameters of which nothing is known one by one: together they have no directions of their own.
    let alone = |j: &usize| variance_ratios[*j] > UNOBSERVED;
    let mut all: Vec<Combination> = (0..p)
        .filter(alone)
        .map(|j| {
            let mut direction = vec![0.0; p];
            direction[j] = 1.0;
            Combination { direction, variance_ratio: variance_ratios[j], mean: None }
        })
        .collect();
    let (values, vectors) = eigen(whitened(root, accuracy.covariance()).as_ref());
    for (number, &value) in values.iter().enumerate().rev().take_while(|(_, value)| **value > threshold) {
        let vector = vectors.as_ref().get(.., number..number + 1);
        // d = L u is the change of c, a = L⁻ᵀ u the functional aᵀc with prior variance 1.
        let change = product(root, vector);
        let mut direction: Vec<f64> = (0..p).map(|j| change[(j, 0)] / prior[(j, j)].sqrt()).collect();
        let of_alone: f64 = (0..p).filter(alone).map(|j| direction[j].powi(2)).sum();
        if of_alone > 0.5 * direction.iter().map(|value| value * value).sum::<f64>() {
            continue;
        }
        let largest = first_largest(direction.iter().map(|value| value.abs())).map_or(1.0, |j| direction[j]);
        direction.iter_mut().for_each(|value| *value /= largest);
        let mut functional = vector.to_owned();
        solve_lower_transposed(root, functional.as_mut());
        let functional = functional.col_as_slice(0);
        let with_mean = |(variable, (with, variance)): (usize, (&[f64], f64))| {
            let covariance: f64 = dot(functional, with);
            let correlation = covariance / (value * variance).sqrt();
            let most = variance * (correlation * correlation * value / (value - threshold) - 1.0);
            Inseparable { variable, correlation, sigma_needed: most.max(0.0).sqrt() }
        };
        let all_means: Vec<Inseparable> = accuracy.of_means().enumerate().map(with_mean).collect();
        let strongest = first_largest(all_means.iter().map(|mean| mean.correlation.abs())).map(|it| all_means[it]);
        let mean = strongest.filter(|mean| mean.correlation.abs() >= INSEPARABLE);
        all.push(Combination { direction, variance_ratio: value, mean });
    }
    all
}

/// Parameters that, once known exactly, leave no eigenvalue above the threshold; each is the one that lowers the largest
/// the most. To know parameter j takes `S_j S_jᵀ / S_jj` from S.
fn references(root: MatRef<'_, f64>, covariance: MatRef<'_, f64>, threshold: f64) -> Vec<usize> {
    let mut rest = covariance.to_owned();
    let mut references = Vec::new();
    while references.len() < MOST_REFERENCES.min(rest.nrows()) {
        let (values, vectors) = eigen(whitened(root, rest.as_ref()).as_ref());
        let last = values.len() - 1;
        if values[last] <= threshold {
            break;
        }
        let mut functional = vectors.as_ref().get(.., last..).to_owned();
        solve_lower_transposed(root, functional.as_mut());
        let with_all = product(rest.as_ref(), functional.as_ref());
        let gain = |j: &usize| with_all[(*j, 0)].powi(2) / rest[(*j, *j)];
        let candidates: Vec<usize> =
            (0..rest.nrows()).filter(|j| !references.contains(j) && rest[(*j, *j)] > 0.0).collect();
        let Some(best) = first_largest(candidates.iter().map(gain)).map(|best| candidates[best]) else { break };
        let own = rest.col_as_slice(best).to_vec();
        rest = Mat::from_fn(own.len(), own.len(), |i, j| rest[(i, j)] - own[i] * own[j] / own[best]);
        references.push(best);
    }
    references
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What observations h of (c, x̄) with unit variance leave of a diagonal covariance, by the Kalman filter.
    fn after(variances: &[f64], observations: &[&[f64]], parameters: usize) -> CalibrationAccuracy {
        let n = variances.len();
        let mut joint = Mat::from_fn(n, n, |i, j| if i == j { variances[i] } else { 0.0 });
        for h in observations {
            let v: Vec<f64> = (0..n).map(|i| (0..n).map(|j| joint[(i, j)] * h[j]).sum()).collect();
            let alpha = h.iter().zip(&v).map(|(a, b)| a * b).sum::<f64>() + 1.0;
            joint = Mat::from_fn(n, n, |i, j| joint[(i, j)] - v[i] * v[j] / alpha);
        }
        CalibrationAccuracy::new(joint, parameters)
    }

    fn diagonal(variances: &[f64]) -> Mat<f64> {
        Mat::from_fn(variances.len(), variances.len(), |i, j| if i == j { variances[i] } else { 0.0 })
    }

    #[test]
    fn a_bias_that_only_its_sum_with_the_mean_is_seen_of_is_named_with_the_mean() {
        let prior = [400.0, 400.0];
        let observed: Vec<&[f64]> = vec![&[1.0, 0.0, 1.0], &[0.0, 1.0, 1.0]];
        let accuracy = after(&[400.0, 400.0, 400.0], &observed.repeat(30), 2);
        let found = Observability::new(diagonal(&prior).as_ref(), &accuracy, 0.25).unwrap();
        let [combination] = found.undetermined.as_slice() else { panic!("{found:?}") };
        // Their difference is known; their mean, with variance 200, is only known in its sum with x̄, with variance 400: of
        // it stays 200 · 400/600.
        assert!(combination.direction.iter().all(|value| (value - 1.0).abs() < 1e-9), "{combination:?}");
        let mean = combination.mean.unwrap();
        assert!(mean.variable == 0 && mean.correlation < -0.99, "{mean:?}");
        // An observation of the mean as good as it says brings the share to the threshold.
        let scaled = |sigma: f64| [0.0, 0.0, 1.0 / sigma];
        let told = scaled(mean.sigma_needed);
        let with_mean: Vec<&[f64]> = observed.repeat(30).into_iter().chain([&told[..]]).collect();
        let cured = after(&[400.0, 400.0, 400.0], &with_mean, 2);
        let left = Observability::new(diagonal(&prior).as_ref(), &cured, 0.1).unwrap().undetermined[0].variance_ratio;
        assert!((left - 0.25).abs() < 1e-9, "{left}");
        assert!((combination.variance_ratio - 2.0 / 3.0).abs() < 1e-3, "{combination:?}");
        // One reference is enough: the other follows from the difference.
        assert_eq!(found.references.len(), 1);
        // And it does what it promises: with the first bias known to be what it is, nothing is left open.
        let with_reference: Vec<&[f64]> =
            observed.repeat(30).into_iter().chain(vec![&[1.0, 0.0, 0.0][..]; 2000]).collect();
        let cured = after(&[400.0, 400.0, 400.0], &with_reference, 2);
        assert!(Observability::new(diagonal(&prior).as_ref(), &cured, 0.25).unwrap().undetermined.is_empty());
    }

    #[test]
    fn what_is_never_observed_is_named_by_itself() {
        let accuracy = after(&[4.0, 9.0, 1.0], &[&[0.0, 1.0, 0.0][..]; 20], 3);
        let found = Observability::new(diagonal(&[4.0, 9.0, 1.0]).as_ref(), &accuracy, 0.25).unwrap();
        let directions: Vec<&[f64]> = found.undetermined.iter().map(|it| it.direction.as_slice()).collect();
        assert_eq!(directions, [&[1.0, 0.0, 0.0][..], &[0.0, 0.0, 1.0]]);
        assert_eq!(found.references.len(), 2);
        assert!(found.references.contains(&0) && found.references.contains(&2), "{found:?}");
        assert!((found.variance_ratios[1] - 1.0 / 181.0).abs() < 1e-12);
    }

    #[test]
    fn eigenvalues_are_those_of_the_pencil_whatever_the_units() {
        let scale = [1.0, 1e-3, 1e4];
        let prior = Mat::from_fn(3, 3, |i, j| scale[i] * scale[j] * if i == j { 2.0 } else { 0.5 });
        let halved = CalibrationAccuracy::new(Mat::from_fn(3, 3, |i, j| 0.5 * prior[(i, j)]), 3);
        let found = Observability::new(prior.as_ref(), &halved, 0.25).unwrap();
        assert_eq!(found.undetermined.len(), 3);
        assert!(found.undetermined.iter().all(|it| (it.variance_ratio - 0.5).abs() < 1e-12), "{found:?}");
        assert!(Observability::new(prior.as_ref(), &halved, 0.6).unwrap().undetermined.is_empty());
    }
}
