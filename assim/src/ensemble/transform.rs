//! The analysis in the space of the ensemble.

use super::members::ObservedEnsemble;
use crate::linalg::{add_product, add_symmetric_product, eigen, product};
use crate::problem::Innovations;
use faer::Mat;

/// Observations as an analysis in ensemble space takes them: all divided by their standard deviations, which
/// localisation may have enlarged.
pub(super) struct WhitenedObservations {
    /// R^-½ Y' / √(N−1), `[n, N]`.
    pub perturbations: Mat<f64>,
    /// R^-½ d, `[n]`.
    pub departures: Vec<f64>,
}

impl WhitenedObservations {
    /// All observations.
    pub fn new(members: &ObservedEnsemble) -> Self {
        let root = ((members.perturbations.ncols() - 1) as f64).sqrt();
        let Innovations { departures, variance, .. } = &members.innovations;
        let departures = departures.iter().zip(variance).map(|(d, variance)| d / variance.sqrt()).collect();
        let perturbations = Mat::from_fn(members.perturbations.nrows(), members.perturbations.ncols(), |i, j| {
            members.perturbations[(i, j)] / (variance[i].sqrt() * root)
        });
        Self { perturbations, departures }
    }
}

/// The analysed members as combinations of the background's, and what the observations said of the covariance.
pub(super) struct Transform {
    /// T, `[N, N]`: analysed member i is x̄ + Σ_k X'_k T_ki.
    pub weights: Mat<f64>,
    /// dᵀ (H P Hᵀ + R)⁻¹ d.
    pub chi2: f64,
}

/// The symmetric square root of Bishop, Etherton and Majumdar (2001) and Hunt, Kostelich and Szunyogh (2007):
///
/// ```text
/// A = I + Ỹᵀ Ỹ,    w = A⁻¹ Ỹᵀ d̃,    W = A^-½,    T = √f [ w 1ᵀ/√(N−1) + (1−α) W ] + α I
/// ```
///
/// with Ỹ and d̃ the whitened perturbations (times √f, the inflation of the background's covariance) and departures, and
/// α the relaxation to the prior perturbations. The eigenvectors are those of the smaller of ỸᵀỸ `[N, N]` and ỸỸᵀ
/// `[n, n]`: with Ỹ = V Λ^½ Uᵀ, `g(ỸᵀỸ) = g(0) I + Ỹᵀ V [(g(Λ) − g(0))/Λ] Vᵀ Ỹ`.
pub(super) fn transform(observed: &WhitenedObservations, inflation: f64, relaxation: f64) -> Transform {
    let (n, members) = (observed.perturbations.nrows(), observed.perturbations.ncols());
    let y = observed.perturbations.as_ref();
    let d = Mat::from_fn(n, 1, |i, _| observed.departures[i]);
    let scale = inflation.sqrt();
    let mut weights = Mat::zeros(members, members);
    let (mean, chi2);
    if n < members {
        let mut gram = Mat::zeros(n, n);
        add_symmetric_product(gram.as_mut(), inflation, y, y.transpose());
        let (values, vectors) = eigen(gram.as_ref());
        let projected = product(vectors.transpose(), d.as_ref());
        let solved = Mat::from_fn(n, 1, |i, _| projected[(i, 0)] / (1.0 + values[i].max(0.0)));
        chi2 = (0..n).map(|i| projected[(i, 0)] * solved[(i, 0)]).sum();
        mean = product(y.transpose(), product(vectors.as_ref(), solved.as_ref()).as_ref());
        let right = product(y.transpose(), vectors.as_ref());
        // ((1 + λ)^-½ − 1)/λ without cancellation.
        let factor = |value: f64| {
            let root = (1.0 + value.max(0.0)).sqrt();
            -1.0 / (root * (1.0 + root))
        };
        let left = Mat::from_fn(members, n, |i, j| right[(i, j)] * factor(values[j]) * inflation);
        add_symmetric_product(weights.as_mut(), 1.0, left.as_ref(), right.transpose());
        (0..members).for_each(|i| weights[(i, i)] += 1.0);
    } else {
        let mut gram = Mat::zeros(members, members);
        add_symmetric_product(gram.as_mut(), inflation, y.transpose(), y);
        let (values, vectors) = eigen(gram.as_ref());
        let projected = product(vectors.transpose(), product(y.transpose(), d.as_ref()).as_ref());
        let solved = Mat::from_fn(members, 1, |i, _| projected[(i, 0)] / (1.0 + values[i].max(0.0)));
        let explained: f64 = (0..members).map(|i| inflation * projected[(i, 0)] * solved[(i, 0)]).sum();
        chi2 = observed.departures.iter().map(|d| d * d).sum::<f64>() - explained;
        mean = product(vectors.as_ref(), solved.as_ref());
        let left = Mat::from_fn(members, members, |i, j| vectors[(i, j)] / (1.0 + values[j].max(0.0)).sqrt());
        add_product(weights.as_mut(), 1.0, left.as_ref(), vectors.transpose());
    }
    // w = √f A⁻¹ Ỹᵀ d̃ with the un-inflated Ỹ, and X' is inflated by √f again.
    let shift: Vec<f64> = (0..members).map(|i| inflation * mean[(i, 0)] / ((members - 1) as f64).sqrt()).collect();
    for j in 0..members {
        let column = weights.col_as_slice_mut(j);
        for (weight, shift) in column.iter_mut().zip(&shift) {
            *weight = shift + scale * (1.0 - relaxation) * *weight;
        }
        column[j] += relaxation;
    }
    Transform { weights, chi2 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    /// Both ways to the square root are the same, and the weights keep the sum of the perturbations at zero.
    #[test]
    fn few_and_many_observations_agree() {
        let members = 7;
        for n in [3, 6] {
            let normals = standard_normals(&mut stream(3, "transform"), (n + 1) * members);
            let mean: Vec<f64> =
                (0..n).map(|i| (0..members).map(|j| normals[j * n + i]).sum::<f64>() / members as f64).collect();
            let perturbations = Mat::from_fn(n, members, |i, j| normals[j * n + i] - mean[i]);
            let departures = normals[n * members..][..n].to_vec();
            // Rows of zeros make it many observations, and change nothing.
            let padded = Mat::from_fn(members, members, |i, j| if i < n { perturbations[(i, j)] } else { 0.0 });
            let mut padded_departures = departures.clone();
            padded_departures.resize(members, 0.0);
            let few = transform(&WhitenedObservations { perturbations, departures }, 1.2, 0.3);
            let many =
                transform(&WhitenedObservations { perturbations: padded, departures: padded_departures }, 1.2, 0.3);
            assert!((few.chi2 / many.chi2 - 1.0).abs() < 1e-12);
            for i in 0..members {
                for j in 0..members {
                    assert!((few.weights[(i, j)] - many.weights[(i, j)]).abs() < 1e-12);
                }
            }
        }
    }
}
