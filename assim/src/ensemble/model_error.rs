//! What a cycle adds to the members: model error and the drift of the biases.

use super::ModelErrorTreatment;
use super::members::draw_parts;
use super::moments::{spread, variable_scales};
use crate::covariance;
use crate::linalg::{add_product, add_symmetric_product, eigen, product};
use crate::problem::Problem;
use faer::Mat;
use isobar_model::random::standard_normals;
use isobar_model::{Duration, Model};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Directions of the ensemble with less than this part of the largest variance are not inverted.
const LEAST_VARIANCE: f64 = 1e-12;

/// Adds the errors of a window to perturbations X, `[m + p, N]`.
pub(super) fn add_model_error(
    problem: &Problem<dyn Model>,
    treatment: ModelErrorTreatment,
    window: Duration,
    perturbations: &mut Mat<f64>,
    random: &mut ChaCha8Rng,
) {
    let drift: Vec<f64> = problem
        .estimated_calibration()
        .parameters
        .iter()
        .map(|parameter| parameter.drift.added_sigma(window))
        .collect();
    if problem.model_error.is_none() && drift.iter().all(|&sigma| sigma == 0.0) {
        return;
    }
    let mut draws = draws(problem, &drift, perturbations.ncols(), random);
    if treatment == ModelErrorTreatment::SquareRoot {
        let span = Span::new(problem, perturbations);
        span.remove_from(&mut draws);
        *perturbations = product(perturbations.as_ref(), span.square_root(problem, &drift).as_ref());
    }
    *perturbations += draws;
}

/// N draws of Q and the walks, with mean zero, `[m + p, N]`.
fn draws(problem: &Problem<dyn Model>, drift: &[f64], members: usize, random: &mut ChaCha8Rng) -> Mat<f64> {
    let bands = problem.bands();
    let model_error = problem.model_error.as_deref();
    let controls = model_error.map_or(0, |model_error| model_error.control_len());
    let draw = || {
        let mut normals = standard_normals(random, controls + drift.len());
        let of_drift = normals.split_off(controls);
        (normals, of_drift)
    };
    let columns: Vec<Vec<f64>> = draw_parts(&bands, (model_error, problem.background.values().len()), members, draw)
        .map(|(mut column, normals)| {
            column.extend(normals.iter().zip(drift).map(|(normal, sigma)| normal * sigma));
            column
        })
        .collect();
    let rows = columns.first().map_or(0, Vec::len);
    let mean: Vec<f64> =
        (0..rows).map(|i| columns.iter().map(|column| column[i]).sum::<f64>() / members as f64).collect();
    Mat::from_fn(rows, members, |i, j| columns[j][i] - mean[i])
}

/// The span of an ensemble, in the norm in which every variable is divided by its spread.
struct Span {
    scales: Vec<f64>,
    /// Z = S⁻¹ X, `[m + p, N]`.
    scaled: Mat<f64>,
    /// V Σ⁻² with (ZᵀZ) = V Σ² Vᵀ, and V, both `[N, rank]`.
    inverse: Mat<f64>,
    vectors: Mat<f64>,
}

impl Span {
    fn new(problem: &Problem<dyn Model>, perturbations: &Mat<f64>) -> Self {
        let scales = variable_scales(problem, &spread(perturbations));
        let members = perturbations.ncols();
        let scaled = Mat::from_fn(perturbations.nrows(), members, |i, j| perturbations[(i, j)] / scales[i]);
        let mut gram = Mat::zeros(members, members);
        add_symmetric_product(gram.as_mut(), 1.0, scaled.transpose(), scaled.as_ref());
        let (values, vectors) = eigen(gram.as_ref());
        let first = values.partition_point(|&value| value <= LEAST_VARIANCE * values[members - 1]);
        let vectors = vectors.as_ref().get(.., first..).to_owned();
        let inverse = Mat::from_fn(members, members - first, |i, j| vectors[(i, j)] / values[first + j]);
        Self { scales, scaled, inverse, vectors }
    }

    /// Z⁺ A = V Σ⁻² Vᵀ Zᵀ A for scaled columns A.
    fn coordinates(&self, columns: &Mat<f64>) -> Mat<f64> {
        let inner = product(self.scaled.transpose(), columns.as_ref());
        product(self.inverse.as_ref(), product(self.vectors.transpose(), inner.as_ref()).as_ref())
    }

    /// D ← S (I − Z Z⁺) S⁻¹ D.
    fn remove_from(&self, draws: &mut Mat<f64>) {
        let mut scaled = Mat::from_fn(draws.nrows(), draws.ncols(), |i, j| draws[(i, j)] / self.scales[i]);
        let coordinates = self.coordinates(&scaled);
        add_product(scaled.as_mut(), -1.0, self.scaled.as_ref(), coordinates.as_ref());
        *draws = Mat::from_fn(draws.nrows(), draws.ncols(), |i, j| scaled[(i, j)] * self.scales[i]);
    }

    /// T = (I + (N − 1) Z⁺ S⁻¹ Q S⁻¹ Z⁺ᵀ)^½, so that X T has the covariance of X and the projected Q together.
    fn square_root(&self, problem: &Problem<dyn Model>, drift: &[f64]) -> Mat<f64> {
        let (rows, members) = (self.scaled.nrows(), self.scaled.ncols());
        let m = rows - drift.len();
        // Z⁺ᵀ = Z V Σ⁻² Vᵀ; of it the columns Z V Σ⁻² suffice.
        let dual = product(self.scaled.as_ref(), self.inverse.as_ref());
        let columns: Vec<Vec<f64>> = (0..dual.ncols())
            .into_par_iter()
            .map(|j| {
                let mut dual: Vec<f64> =
                    dual.col_as_slice(j).iter().zip(&self.scales).map(|(value, scale)| value / scale).collect();
                let walks = dual.split_off(m);
                let mut image = match problem.model_error.as_deref() {
                    Some(model_error) => covariance::multiply(model_error, &dual),
                    None => vec![0.0; m],
                };
                image.extend(walks.iter().zip(drift).map(|(value, sigma)| value * sigma * sigma));
                image.iter_mut().zip(&self.scales).for_each(|(value, scale)| *value /= scale);
                image
            })
            .collect();
        let rank = columns.len();
        let image = Mat::from_fn(rows, rank, |i, j| columns[j][i]);
        let mut core = Mat::identity(rank, rank);
        add_symmetric_product(core.as_mut(), (members - 1) as f64, dual.transpose(), image.as_ref());
        // T = I + V (core^½ − I) Vᵀ: the identity beyond the span.
        let (values, vectors) = eigen(core.as_ref());
        let outer = product(self.vectors.as_ref(), vectors.as_ref());
        let weighted = Mat::from_fn(members, rank, |i, j| outer[(i, j)] * (values[j].max(1.0).sqrt() - 1.0));
        let mut root = Mat::identity(members, members);
        add_symmetric_product(root.as_mut(), 1.0, weighted.as_ref(), outer.transpose());
        root
    }
}
