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

/// An analysis in the space of the ensemble, and what the observations said of the covariance.
pub(super) struct Transform {
    /// A⁻¹ Ỹᵀ d̃ / √(N−1) but for a factor √f, `[N]`.
    mean: Vec<f64>,
    /// W, `[N, N]`.
    root: Mat<f64>,
    inflation: f64,
    /// dᵀ (H P Hᵀ + R)⁻¹ d.
    pub chi2: f64,
}

impl Transform {
    /// T, `[N, N]`: analysed member i is x̄ + Σ_k X'_k T_ki. `relaxation` is that to the prior perturbations, α.
    pub fn weights(self, relaxation: f64) -> Mat<f64> {
        // w = √f A⁻¹ Ỹᵀ d̃ with the un-inflated Ỹ, and X' is inflated by √f again.
        let mut weights = self.combined(self.inflation, self.inflation.sqrt() * (1.0 - relaxation));
        (0..weights.ncols()).for_each(|j| weights[(j, j)] += relaxation);
        weights
    }

    /// What T is for members of an earlier time, which are not inflated: `A⁻¹ Ỹᵀ d̃ 1ᵀ/√(N−1) + W`.
    pub fn earlier_weights(&self) -> Mat<f64> {
        self.combined(self.inflation.sqrt(), 1.0)
    }

    fn combined(&self, of_mean: f64, of_root: f64) -> Mat<f64> {
        Mat::from_fn(self.root.nrows(), self.root.ncols(), |i, j| of_mean * self.mean[i] + of_root * self.root[(i, j)])
    }
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
pub(super) fn transform(observed: &WhitenedObservations, inflation: f64) -> Transform {
    let (n, members) = (observed.perturbations.nrows(), observed.perturbations.ncols());
    let y = observed.perturbations.as_ref();
    let d = Mat::from_fn(n, 1, |i, _| observed.departures[i]);
    let mut root = Mat::zeros(members, members);
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
        add_symmetric_product(root.as_mut(), 1.0, left.as_ref(), right.transpose());
        (0..members).for_each(|i| root[(i, i)] += 1.0);
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
        add_product(root.as_mut(), 1.0, left.as_ref(), vectors.transpose());
    }
    let mean = (0..members).map(|i| mean[(i, 0)] / ((members - 1) as f64).sqrt()).collect();
    Transform { mean, root, inflation, chi2 }
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
            let few = transform(&WhitenedObservations { perturbations, departures }, 1.2);
            let many = transform(&WhitenedObservations { perturbations: padded, departures: padded_departures }, 1.2);
            assert!((few.chi2 / many.chi2 - 1.0).abs() < 1e-12);
            let earlier = [few.earlier_weights(), many.earlier_weights()];
            for [few, many] in [[few.weights(0.3), many.weights(0.3)], earlier] {
                for i in 0..members {
                    for j in 0..members {
                        assert!((few[(i, j)] - many[(i, j)]).abs() < 1e-12);
                    }
                }
            }
        }
    }
}
