//! What a cycle adds to the members: model error and the drift of the biases.

use super::ModelErrorTreatment;
use super::moments::{spread, variable_scales};
use super::parts_of_draws::draw_parts;
use crate::covariance;
use crate::linalg::{add_product, add_symmetric_product, eigen, product, summed};
use crate::problem::Problem;
use faer::Mat;
use isobar_model::random::standard_normals;
use isobar_model::{Bands, Duration, Model};
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
        let span = Span::new(problem, perturbations, drift.len());
        span.remove_from(&mut draws, drift.len());
        *perturbations = product(perturbations.as_ref(), span.square_root(&drift).as_ref());
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
struct Span<'a> {
    problem: &'a Problem<dyn Model>,
    bands: Bands,
    scales: Vec<f64>,
    /// Z = S⁻¹ X, `[m + p, N]`.
    scaled: Mat<f64>,
    /// V Σ⁻² with (ZᵀZ) = V Σ² Vᵀ, and V, both `[N, rank]`.
    inverse: Mat<f64>,
    vectors: Mat<f64>,
}

impl<'a> Span<'a> {
    /// Of perturbations whose last rows are those of `parameters` parameters.
    fn new(problem: &'a Problem<dyn Model>, perturbations: &Mat<f64>, parameters: usize) -> Self {
        let (bands, fields) = (problem.bands(), problem.background.layout().variables.len());
        let scales = variable_scales(&bands, fields, &spread(perturbations));
        let members = perturbations.ncols();
        let scaled = Mat::from_fn(perturbations.nrows(), members, |i, j| perturbations[(i, j)] / scales[i]);
        let gram = inner_products(&bands, parameters, &scaled, &scaled);
        let (values, vectors) = eigen(gram.as_ref());
        let first = values.partition_point(|&value| value <= LEAST_VARIANCE * values[members - 1]);
        let vectors = vectors.as_ref().get(.., first..).to_owned();
        let inverse = Mat::from_fn(members, members - first, |i, j| vectors[(i, j)] / values[first + j]);
        Self { problem, bands, scales, scaled, inverse, vectors }
    }

    /// D ← S (I − Z Z⁺) S⁻¹ D, where Z⁺ A = V Σ⁻² Vᵀ Zᵀ A.
    fn remove_from(&self, draws: &mut Mat<f64>, parameters: usize) {
        let mut scaled = Mat::from_fn(draws.nrows(), draws.ncols(), |i, j| draws[(i, j)] / self.scales[i]);
        let inner = inner_products(&self.bands, parameters, &self.scaled, &scaled);
        let coordinates = product(self.inverse.as_ref(), product(self.vectors.transpose(), inner.as_ref()).as_ref());
        add_product(scaled.as_mut(), -1.0, self.scaled.as_ref(), coordinates.as_ref());
        *draws = Mat::from_fn(draws.nrows(), draws.ncols(), |i, j| scaled[(i, j)] * self.scales[i]);
    }

    /// T = (I + (N − 1) Z⁺ S⁻¹ Q S⁻¹ Z⁺ᵀ)^½, so that X T has the covariance of X and the projected Q together.
    fn square_root(&self, drift: &[f64]) -> Mat<f64> {
        let (rows, members) = (self.scaled.nrows(), self.scaled.ncols());
        let m = rows - drift.len();
        // Z⁺ᵀ = Z V Σ⁻² Vᵀ; of it the columns Z V Σ⁻² suffice.
        let dual = product(self.scaled.as_ref(), self.inverse.as_ref());
        let rank = dual.ncols();
        let unscaled = |j: usize| dual.col_as_slice(j).iter().zip(&self.scales).map(|(value, scale)| value / scale);
        let states: Vec<_> = (0..rank).map(|j| unscaled(j).take(m).collect::<Vec<_>>().into()).collect();
        let states = self.bands.collect(&states);
        let multiply = |state: &Vec<f64>| match self.problem.model_error.as_deref() {
            Some(model_error) => covariance::multiply(model_error, state),
            None => vec![0.0; state.len()],
        };
        let images = self.bands.deal(states.par_iter().map(multiply).collect());
        let with_walks = |(j, mut image): (usize, Vec<f64>)| {
            image.extend(unscaled(j).skip(m).zip(drift).map(|(value, sigma)| value * sigma * sigma));
            image.iter_mut().zip(&self.scales).for_each(|(value, scale)| *value /= scale);
            image
        };
        let columns: Vec<Vec<f64>> = images.into_iter().enumerate().map(with_walks).collect();
        let image = Mat::from_fn(rows, rank, |i, j| columns[j][i]);
        let mut core = inner_products(&self.bands, drift.len(), &dual, &image);
        core *= faer::Scale((members - 1) as f64);
        (0..rank).for_each(|j| core[(j, j)] += 1.0);
        // T = I + V (core^½ − I) Vᵀ: the identity beyond the span.
        let (values, vectors) = eigen(core.as_ref());
        let outer = product(self.vectors.as_ref(), vectors.as_ref());
        let weighted = Mat::from_fn(members, rank, |i, j| outer[(i, j)] * (values[j].max(1.0).sqrt() - 1.0));
        let mut root = Mat::identity(members, members);
        add_symmetric_product(root.as_mut(), 1.0, weighted.as_ref(), outer.transpose());
        root
    }
}

/// Aᵀ B. Of the rows of the state this rank has its part; those of the parameters, the last ones, are on all ranks.
fn inner_products(bands: &Bands, parameters: usize, a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let rows = if bands.communicator().rank() == 0 { a.nrows() } else { a.nrows() - parameters };
    summed(bands.communicator(), product(a.as_ref().get(..rows, ..).transpose(), b.as_ref().get(..rows, ..)))
}
