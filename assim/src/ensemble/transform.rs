//! The analysis in the space of the ensemble.

use super::inflation::Sizes;
use super::observed::ObservedEnsemble;
use super::principal::{Principal, principal};
use crate::linalg::{add_product, add_symmetric_product, column, eigen, product, squared_norm};
use crate::problem::Innovations;
use faer::Mat;

/// Observations as an analysis in ensemble space takes them: all divided by their standard deviations, which
/// localisation may have enlarged.
pub(super) struct WhitenedObservations {
    /// R^-½ Y' / √(N−1), `[n, N]`.
    pub perturbations: Mat<f64>,
    /// R^-½ d, `[n]`.
    pub departures: Vec<f64>,
    /// How far rounding may have changed a row of the perturbations, `[n]`.
    pub rounding: Vec<f64>,
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
        // Each of the N members has it, and √(N−1) of them are a row's norm.
        let rounding =
            members.rounding.iter().zip(variance).map(|(rounding, variance)| rounding / variance.sqrt()).collect();
        Self { perturbations, departures, rounding }
    }

    /// How large they are.
    pub fn sizes(&self) -> Sizes {
        let columns = 0..self.perturbations.ncols();
        Sizes {
            perturbations: columns.map(|j| squared_norm(self.perturbations.col_as_slice(j))).sum(),
            departures: squared_norm(&self.departures),
            weight: self.departures.len() as f64,
        }
    }
}

/// An analysis in the space of the ensemble, and what the observations said of the covariance.
pub(super) struct Transform {
    /// A⁻¹ Ỹᵀ d̃ / √(N−1) but for a factor √f, `[N]`.
    pub mean: Vec<f64>,
    /// W, `[N, N]`.
    pub root: Mat<f64>,
    /// f.
    pub inflation: f64,
    /// dᵀ (H P Hᵀ + R)⁻¹ d.
    pub chi2: f64,
}

impl Transform {
    /// T, `[N, N + 1]`: analysed member i is x̄ + Σ_k X'_k (T_ki + T_k,N+1), the last column being the mean's. `relaxation` is
    /// that to the prior perturbations, α.
    pub fn weights(self, relaxation: f64) -> Mat<f64> {
        // w = √f A⁻¹ Ỹᵀ d̃ with the un-inflated Ỹ, and X' is inflated by √f again.
        let mut weights = self.combined(self.inflation, self.inflation.sqrt() * (1.0 - relaxation));
        (0..weights.nrows()).for_each(|j| weights[(j, j)] += relaxation);
        weights
    }

    /// What T is for members of an earlier time, which are not inflated: `[W, A⁻¹ Ỹᵀ d̃/√(N−1)]`.
    pub fn earlier_weights(&self) -> Mat<f64> {
        self.combined(self.inflation.sqrt(), 1.0)
    }

    fn combined(&self, of_mean: f64, of_root: f64) -> Mat<f64> {
        let members = self.mean.len();
        Mat::from_fn(members, members + 1, |i, j| {
            if j < members { of_root * self.root[(i, j)] } else { of_mean * self.mean[i] }
        })
    }
}

/// The symmetric square root of Bishop, Etherton and Majumdar (2001) and Hunt, Kostelich and Szunyogh (2007):
///
/// ```text
/// A = I + Ỹᵀ Ỹ,    w = A⁻¹ Ỹᵀ d̃,    W = A^-½,    T = [ √f (1−α) W + α I,  √f w/√(N−1) ]
/// ```
///
/// with Ỹ and d̃ the whitened perturbations (times √f, the inflation of the background's covariance) and departures, and
/// α the relaxation to the prior perturbations. The eigenvectors are those of the smaller of ỸᵀỸ `[N, N]` and ỸỸᵀ
/// `[n, n]`: with Ỹ = V Λ^½ Uᵀ, `g(ỸᵀỸ) = g(0) I + Ỹᵀ V [(g(Λ) − g(0))/Λ] Vᵀ Ỹ`. Where these would lose what less accurate
/// observations say beside very accurate ones, V is found by [`principal`].
///
/// χ² is twice the least cost, |w|² + |d̃ − Ỹ w|², a sum of squares.
pub(super) fn transform(observed: &WhitenedObservations, inflation: f64) -> Transform {
    let (n, members) = (observed.perturbations.nrows(), observed.perturbations.ncols());
    let y = observed.perturbations.as_ref();
    let d = column(&observed.departures);
    let mut root = Mat::zeros(members, members);
    let (mean, chi2);
    let is_graded = observed.sizes().are_graded(inflation);
    if n < members || is_graded {
        let Principal { columns: right, values, amplitudes } = if is_graded {
            principal(&observed.perturbations, &observed.departures, &observed.rounding, inflation.sqrt())
        } else {
            let mut gram = Mat::zeros(n, n);
            add_symmetric_product(gram.as_mut(), inflation, y, y.transpose());
            let (mut values, vectors) = eigen(gram.as_ref());
            values.iter_mut().for_each(|value| *value = value.max(0.0));
            let amplitudes = product(vectors.transpose(), d.as_ref()).col_as_slice(0).to_vec();
            let columns = product(y.transpose(), vectors.as_ref()) * faer::Scale(inflation.sqrt());
            Principal { columns, values, amplitudes }
        };
        let solved: Vec<f64> = amplitudes.iter().zip(&values).map(|(x, value)| x / (1.0 + value)).collect();
        chi2 = amplitudes.iter().zip(&solved).map(|(amplitude, solved)| amplitude * solved).sum();
        mean = product(right.as_ref(), column(&solved).as_ref()) * faer::Scale(1.0 / inflation.sqrt());
        // ((1 + λ)^-½ − 1)/λ without cancellation.
        let factor = |value: f64| {
            let root = (1.0 + value).sqrt();
            -1.0 / (root * (1.0 + root))
        };
        let left = Mat::from_fn(members, n, |i, j| right[(i, j)] * factor(values[j]));
        add_symmetric_product(root.as_mut(), 1.0, left.as_ref(), right.transpose());
        (0..members).for_each(|i| root[(i, i)] += 1.0);
    } else {
        let mut gram = Mat::zeros(members, members);
        add_symmetric_product(gram.as_mut(), inflation, y.transpose(), y);
        let (values, vectors) = eigen(gram.as_ref());
        let projected = product(vectors.transpose(), product(y.transpose(), d.as_ref()).as_ref());
        let solved = Mat::from_fn(members, 1, |i, _| projected[(i, 0)] / (1.0 + values[i].max(0.0)));
        mean = product(vectors.as_ref(), solved.as_ref());
        let fitted = product(y, mean.as_ref());
        let misfit: f64 = (0..n).map(|i| (d[(i, 0)] - inflation * fitted[(i, 0)]).powi(2)).sum();
        chi2 = inflation * squared_norm(mean.col_as_slice(0)) + misfit;
        let left = Mat::from_fn(members, members, |i, j| vectors[(i, j)] / (1.0 + values[j].max(0.0)).sqrt());
        add_product(root.as_mut(), 1.0, left.as_ref(), vectors.transpose());
    }
    let mean = (0..members).map(|i| mean[(i, 0)] / ((members - 1) as f64).sqrt()).collect();
    Transform { mean, root, inflation, chi2 }
}

/// How many numbers [`transform`] and the weights hold for N members and n observations: the roots, the eigenvectors of the
/// smaller side, and the observations as they are and in the eigenvectors.
pub(super) fn numbers(members: f64, observations: f64) -> f64 {
    5.0 * members * members + 3.0 * members.min(observations).powi(2) + 3.0 * members * observations
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
            let few = transform(&WhitenedObservations { perturbations, departures, rounding: vec![0.0; n] }, 1.2);
            let rounding = vec![0.0; members];
            let padded = WhitenedObservations { perturbations: padded, departures: padded_departures, rounding };
            let many = transform(&padded, 1.2);
            assert!((few.chi2 / many.chi2 - 1.0).abs() < 1e-12);
            let earlier = [few.earlier_weights(), many.earlier_weights()];
            for [few, many] in [[few.weights(0.3), many.weights(0.3)], earlier] {
                for i in 0..members {
                    for j in 0..=members {
                        assert!((few[(i, j)] - many[(i, j)]).abs() < 1e-12);
                    }
                }
            }
        }
    }
}
