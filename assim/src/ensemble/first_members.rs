//! The first members.

use super::members::Ensemble;
use super::moments::variable_scales;
use super::parts_of_draws::draw_parts;
use super::{EnsembleSettings, InitialMembers};
use crate::covariance::{self, randomize};
use crate::error::Error;
use crate::linalg::{cholesky, column, polar_factor, product, qr};
use crate::problem::Problem;
use faer::Mat;
use isobar_model::random::{standard_normals, stream};
use isobar_model::vector::dot;
use isobar_model::{Bands, Model};
use rand_chacha::ChaCha8Rng;

impl Ensemble {
    /// Members about the background of the problem, with the spread of B and of the biases' priors.
    ///
    /// # Errors
    /// [`Error::Setting`] for too few members, [`Error::TooLarge`] if they do not fit into the memory limit.
    pub fn draw(
        problem: &Problem<dyn Model>,
        settings: &EnsembleSettings,
        random: &mut ChaCha8Rng,
    ) -> Result<Self, Error> {
        let calibration = problem.estimated_calibration();
        let bands = problem.bands();
        let mut mean = bands.own_part(problem.background.values());
        let (m, p, members) = (mean.len(), calibration.len(), settings.members);
        check(settings.initial_members, p, members)?;
        // `m` is that of this rank.
        let numbers = 4.0 * (m + p) as f64 * members as f64 + exact_sampling(settings.initial_members, members);
        problem.require_memory(numbers, || format!("an ensemble of {members} members of {} unknowns", m + p))?;
        let prior = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
        let root = cholesky(prior, || "the prior covariance of the calibration parameters".into())?;
        let perturbations = match settings.initial_members {
            InitialMembers::Random => {
                let background_error = &*problem.background_error;
                let draw = || {
                    let normals = standard_normals(random, background_error.control_len());
                    (normals, standard_normals(random, p))
                };
                let mut values = Vec::with_capacity((m + p) * members);
                for (state, normals) in
                    draw_parts(&bands, (Some(background_error), background_error.len()), members, draw)
                {
                    let biases = product(root.as_ref(), column(&normals).as_ref());
                    values.extend(state);
                    values.extend_from_slice(biases.col_as_slice(0));
                }
                values
            }
            InitialMembers::SecondOrderExact => {
                let whole = second_order_exact(problem, &root, members, random);
                let (len, mut values) = (problem.background.values().len(), Vec::with_capacity((m + p) * members));
                for member in whole.chunks_exact(len + p) {
                    values.extend(bands.own_part(&member[..len]));
                    values.extend_from_slice(&member[len..]);
                }
                values
            }
        };
        mean.resize(m + p, 0.0);
        Ok(Self::about(&mean, m, perturbations, problem.background.time()))
    }
}

/// √(N−1) F Ω, column-major `[m + p, N]`: F holds the leading factors of B and the priors, Ω `[N − 1, N]` orthonormal rows
/// whose sums are zero (Pham 2001, Monthly Weather Review 129, second-order exact sampling).
fn second_order_exact(
    problem: &Problem<dyn Model>,
    root: &Mat<f64>,
    members: usize,
    random: &mut ChaCha8Rng,
) -> Vec<f64> {
    let (m, p) = (problem.background.values().len(), root.nrows());
    let variances: Vec<f64> = {
        // A few draws tell the scales of the variables well enough.
        let draws: Vec<Vec<f64>> = (0..8).map(|_| randomize(&*problem.background_error, random)).collect();
        (0..m).map(|i| draws.iter().map(|draw| draw[i] * draw[i]).sum::<f64>() / 8.0).collect()
    };
    let spread: Vec<f64> = variances.iter().map(|variance| variance.sqrt()).collect();
    let layout = problem.background.layout();
    let scales = variable_scales(&Bands::whole(&layout.grid), layout.variables.len(), &spread);
    let factors = covariance::leading_factors(&*problem.background_error, &scales, members - 1 - p, random);
    let factors = turned_to_fixed_directions(factors, &scales);
    let r = factors.ncols();
    let mut all = Mat::<f64>::zeros(m + p, members - 1);
    all.as_mut().get_mut(..m, ..r).copy_from(&factors);
    all.as_mut().get_mut(m.., r..r + p).copy_from(root);
    // The QR factors of [1, random]: all columns of Q but the first are orthogonal to 1.
    let normals = standard_normals(random, members * (members - 1));
    let start = Mat::from_fn(members, members, |i, j| if j == 0 { 1.0 } else { normals[(j - 1) * members + i] });
    let orthonormal = qr(start.as_ref()).compute_Q();
    let rotation = orthonormal.as_ref().get(.., 1..).transpose();
    let members = product(all.as_ref(), rotation);
    let scale = (members.ncols() as f64 - 1.0).sqrt();
    (0..members.ncols()).flat_map(|j| members.col_as_slice(j).iter().map(move |value| scale * value)).collect()
}

/// The rotation of second-order exact sampling, Q, and what it is made from.
fn exact_sampling(initial: InitialMembers, members: usize) -> f64 {
    match initial {
        InitialMembers::Random => 0.0,
        InitialMembers::SecondOrderExact => 4.0 * (members as f64).powi(2),
    }
}

/// F R for the R orthogonal `[r, r]` that makes it the nearest to fixed random directions W, `[m, r]`:
///
/// ```text
/// Fᵀ S⁻¹ W = U Σ Vᵀ,    R = U Vᵀ,    S the scales
/// ```
///
/// (the orthogonal Procrustes problem, Schönemann 1966, Psychometrika 31). F O has the same covariance for any orthogonal O and
/// the same F R. Eigenvectors of equal eigenvalues are known up to such an O only, which rounding chooses, and the members of a
/// nonlinear model depend on the columns of F, not on F Fᵀ alone.
fn turned_to_fixed_directions(factors: Mat<f64>, scales: &[f64]) -> Mat<f64> {
    let (m, r) = (factors.nrows(), factors.ncols());
    let mut directions = stream(0, "directions of the first members");
    let mut alignment = Mat::zeros(r, r);
    for j in 0..r {
        let mut direction = standard_normals(&mut directions, m);
        direction.iter_mut().zip(scales).for_each(|(value, scale)| *value /= scale);
        (0..r).for_each(|i| alignment[(i, j)] = dot(factors.col_as_slice(i), &direction));
    }
    product(factors.as_ref(), polar_factor(alignment.as_ref()).as_ref())
}

fn check(initial: InitialMembers, p: usize, members: usize) -> Result<(), Error> {
    if members < 2 {
        return Err(Error::Setting(format!("an ensemble of {members} has no spread; it needs 2 members or more")));
    }
    if initial == InitialMembers::SecondOrderExact && members < p + 2 {
        return Err(Error::Setting(format!(
            "{members} members cannot hold {p} biases and a factor of B; second-order exact sampling needs {}",
            p + 2
        )));
    }
    Ok(())
}
