//! The ensemble: members (x, c) as columns.

use super::model_error::add_model_error;
use super::moments::{Moments, split_fields, variable_scales};
use super::{EnsembleSettings, InitialMembers};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance::{self, Covariance, randomize};
use crate::error::Error;
use crate::estimate::Estimate;
use crate::linalg::{add_symmetric_product, cholesky, column, polar_factor, product, qr, semidefinite_root};
use crate::memory::{Matrix, require};
use crate::problem::{Problem, steps};
use faer::{Mat, MatRef};
use isobar_model::random::{standard_normals, stream};
use isobar_model::vector::{add, axpy, dot, subtract};
use isobar_model::{Bands, Duration, Model, State, Time, forecast};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rayon::slice::ChunksExact;
use serde::{Deserialize, Serialize};

/// N members of the augmented state (x, c), each a column of m + p values; p is zero where biases are not estimated.
///
/// Where several ranks compute a run, each has the state's values in its band of rows, of which m is the number then, and all
/// parameters.
#[derive(Clone, Serialize, Deserialize)]
pub struct Ensemble {
    /// m.
    state_values: usize,
    /// m + p.
    rows: usize,
    /// Column-major `[m + p, N]`.
    values: Vec<f64>,
    /// Valid time of the members' states, if it is known.
    time: Option<Time>,
}

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
        let time = problem.background.time();
        let mut ensemble = Self { state_values: m, rows: m + p, values: perturbations, time };
        ensemble.center();
        for member in ensemble.values.chunks_exact_mut(m + p) {
            add(member, &mean);
        }
        Ok(ensemble)
    }

    /// Number of members.
    pub fn members(&self) -> usize {
        self.values.len() / self.rows
    }

    /// The members one after another.
    pub(super) fn each(&self) -> ChunksExact<'_, f64> {
        self.values.par_chunks_exact(self.rows)
    }

    /// The members, `[m + p, N]`.
    pub fn values(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice(&self.values, self.rows, self.members())
    }

    /// p, the number of parameters that are estimated.
    pub(super) fn parameters(&self) -> usize {
        self.rows - self.state_values
    }

    /// Whether it has the size of another one.
    pub(super) fn is_like(&self, other: &Ensemble) -> bool {
        let size = |it: &Ensemble| (it.state_values, it.rows, it.values.len());
        size(self) == size(other)
    }

    /// A column of the members' covariance, `[m + p]`; `None` if there is no such number.
    pub(super) fn covariance_column(&self, number: usize) -> Option<Vec<f64>> {
        let Moments { perturbations, .. } = self.moments();
        let mut column = vec![0.0; self.rows];
        let degrees = (self.members() - 1) as f64;
        for j in 0..self.members() {
            let member = perturbations.col_as_slice(j);
            axpy(member.get(number)? / degrees, member, &mut column);
        }
        Some(column)
    }

    /// The mean of the members, `[m + p]`.
    pub fn mean(&self) -> Vec<f64> {
        let members = self.members() as f64;
        self.by_rows(|_, mean, values| add(mean, values), |sum| sum / members)
    }

    /// The standard deviations of the members about their mean, `[m + p]`.
    fn spread(&self, mean: &[f64]) -> Vec<f64> {
        let degrees = (self.members() - 1) as f64;
        let add_squares = |first: usize, squares: &mut [f64], values: &[f64]| {
            for ((square, value), mean) in squares.iter_mut().zip(values).zip(&mean[first..]) {
                *square += (value - mean) * (value - mean);
            }
        };
        self.by_rows(add_squares, |square| (square / degrees).sqrt())
    }

    /// A number for each row, `[m + p]`: sums over the members in their order, to which `add_to` adds the values of one from
    /// the given row on; `finish` turns each sum into the result.
    fn by_rows(
        &self,
        add_to: impl Fn(usize, &mut [f64], &[f64]) + Sync,
        finish: impl Fn(f64) -> f64 + Sync,
    ) -> Vec<f64> {
        /// Rows that one thread works on at a time.
        const CHUNK: usize = 4096;
        let mut results = vec![0.0; self.rows];
        results.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, results)| {
            let first = chunk * CHUNK;
            for member in self.values.chunks_exact(self.rows) {
                add_to(first, results, &member[first..first + results.len()]);
            }
            results.iter_mut().for_each(|result| *result = finish(*result));
        });
        results
    }

    /// Shifts the members to mean zero.
    fn center(&mut self) {
        let mean = self.mean();
        for member in self.values.chunks_exact_mut(self.rows) {
            subtract(member, &mean);
        }
    }

    pub(super) fn moments(&self) -> Moments {
        let mean = self.mean();
        let perturbations = Mat::from_fn(self.rows, self.members(), |i, j| self.values[j * self.rows + i] - mean[i]);
        Moments { mean, perturbations: Matrix(perturbations) }
    }

    pub(super) fn set(&mut self, moments: &Moments) {
        for (j, member) in self.values.chunks_exact_mut(self.rows).enumerate() {
            let perturbation = moments.perturbations.col_as_slice(j);
            for (value, (mean, perturbation)) in member.iter_mut().zip(moments.mean.iter().zip(perturbation)) {
                *value = mean + perturbation;
            }
        }
    }

    /// The moments of the parameters, `[p]` and `[p, N]`.
    pub(super) fn parameter_moments(&self) -> Moments {
        let (m, p, members) = (self.state_values, self.parameters(), self.members());
        let values = |i: usize, j: usize| self.values[j * self.rows + m + i];
        let mean: Vec<f64> = (0..p).map(|i| (0..members).map(|j| values(i, j)).sum::<f64>() / members as f64).collect();
        let perturbations = Mat::from_fn(p, members, |i, j| values(i, j) - mean[i]);
        Moments { mean, perturbations: Matrix(perturbations) }
    }

    /// Sets all parameters.
    pub(super) fn set_parameters(&mut self, moments: &Moments) {
        for (j, member) in self.values.chunks_exact_mut(self.rows).enumerate() {
            let parameters = member[self.state_values..].iter_mut().enumerate();
            parameters.for_each(|(i, value)| *value = moments.mean[i] + moments.perturbations[(i, j)]);
        }
    }

    /// m, the number of values of a state that this rank has.
    pub(super) fn state_values(&self) -> usize {
        self.state_values
    }

    /// The state's fields of `cells` values, cut at these lengths: for each piece the parts of the first member's fields,
    /// then those of the second's …
    pub(super) fn split_fields(&mut self, cells: usize, lengths: &[usize]) -> Vec<Vec<&mut [f64]>> {
        split_fields(self.values.chunks_exact_mut(self.rows), self.state_values, cells, lengths)
    }

    /// Forecasts each member with the model, as many together as it says unless a thread would have none, and adds what a window
    /// adds to the errors.
    pub(super) fn forecast(
        &mut self,
        problem: &Problem<dyn Model>,
        settings: &EnsembleSettings,
        window: Duration,
        random: &mut ChaCha8Rng,
    ) -> Result<(), Error> {
        let (steps, m) = (steps(&*problem.model, window)?, self.state_values);
        let layout = problem.background.layout();
        let kept = problem.estimated_calibration().kept(window);
        let time = self.time;
        for member in self.values.chunks_exact_mut(self.rows) {
            member[m..].iter_mut().zip(&kept).for_each(|(value, kept)| *value *= kept);
        }
        if let Some(model) = problem.model.in_bands() {
            let mut parts: Vec<&mut [f64]> = self.values.chunks_exact_mut(self.rows).map(|it| &mut it[..m]).collect();
            model.forecast_parts(&mut parts, time, steps)?;
            return self.add_errors(problem, settings, window, random);
        }
        let share = self.members().div_ceil(rayon::current_num_threads());
        let groups = share.div_ceil(problem.model.best_together().clamp(1, share));
        let together = share.div_ceil(groups);
        self.values.par_chunks_mut(together * self.rows).try_for_each(|members| {
            let state = |member: &[f64]| State::from_values(layout, member[..m].to_vec()).valid_at(time);
            let mut states: Vec<State> = members.chunks_exact(self.rows).map(state).collect();
            forecast::forecast_together(&*problem.model, &mut states, steps)?;
            for (member, state) in members.chunks_exact_mut(self.rows).zip(&states) {
                member[..m].copy_from_slice(state.values());
            }
            Ok::<(), Error>(())
        })?;
        self.add_errors(problem, settings, window, random)
    }

    /// Adds what a window adds to the errors of members that have been forecast through it.
    fn add_errors(
        &mut self,
        problem: &Problem<dyn Model>,
        settings: &EnsembleSettings,
        window: Duration,
        random: &mut ChaCha8Rng,
    ) -> Result<(), Error> {
        self.time = self.time.map(|time| time + window);
        let mut moments = self.moments();
        add_model_error(problem, settings.model_error, window, &mut moments.perturbations, random);
        self.set(&moments);
        Ok(())
    }

    /// The members' covariance of the parameters and of the means of the state's fields.
    pub(super) fn calibration_accuracy(&self, bands: &Bands) -> CalibrationAccuracy {
        let (m, p, Moments { perturbations, .. }) = (self.state_values, self.parameters(), self.moments());
        let (own, cells) = (bands.own_cells().len(), bands.grid().cells());
        let (fields, members) = (m / own, self.members());
        let mut sums: Vec<f64> = (0..members)
            .flat_map(|j| perturbations.col_as_slice(j)[..m].chunks_exact(own).map(|field| field.iter().sum()))
            .collect();
        bands.communicator().sum(&mut sums);
        let rows = p + fields;
        let reduced = Mat::from_fn(rows, members, |i, j| match i.checked_sub(p) {
            None => perturbations[(m + i, j)],
            Some(field) => sums[j * fields + field] / cells as f64,
        });
        let mut joint = Mat::zeros(rows, rows);
        let scale = 1.0 / (members - 1) as f64;
        add_symmetric_product(joint.as_mut(), scale, reduced.as_ref(), reduced.transpose());
        CalibrationAccuracy::new(joint, p)
    }

    /// Adds draws with a covariance, about mean zero, to the members' parameters.
    pub(super) fn widen_calibration(&mut self, covariance: MatRef<'_, f64>, random: &mut ChaCha8Rng) {
        let (p, members) = (self.rows - self.state_values, self.members());
        let root = semidefinite_root(covariance);
        let normals = standard_normals(random, p * members);
        let mut draws = product(root.as_ref(), MatRef::from_column_major_slice(&normals, p, members));
        for i in 0..p {
            let mean = (0..members).map(|j| draws[(i, j)]).sum::<f64>() / members as f64;
            (0..members).for_each(|j| draws[(i, j)] -= mean);
        }
        for (j, member) in self.values.chunks_exact_mut(self.rows).enumerate() {
            add(&mut member[self.state_values..], draws.col_as_slice(j));
        }
    }

    /// State and full calibration, given the values of a whole state and the parameters that are estimated.
    pub(super) fn unpack(
        &self,
        problem: &Problem<dyn Model>,
        state: Vec<f64>,
        parameters: &[f64],
    ) -> (State, Vec<f64>) {
        let state = State::from_values(problem.background.layout(), state).valid_at(self.time);
        let mut calibration = parameters.to_vec();
        calibration.resize(problem.calibration.len(), 0.0);
        (state, calibration)
    }

    /// State and full calibration of a member of which this rank has all.
    pub(super) fn unpack_member(&self, problem: &Problem<dyn Model>, member: &[f64]) -> (State, Vec<f64>) {
        let (state, parameters) = member.split_at(self.state_values);
        self.unpack(problem, state.to_vec(), parameters)
    }

    /// Mean and standard deviation of the members.
    pub(super) fn estimate(&self, problem: &Problem<dyn Model>, bands: &Bands) -> Estimate {
        let mean = self.mean();
        self.estimate_of(problem, bands, &mean, self.spread(&mean))
    }

    /// An estimate from a mean and standard deviations, both `[m + p]`.
    pub(super) fn estimate_of(
        &self,
        problem: &Problem<dyn Model>,
        bands: &Bands,
        mean: &[f64],
        mut spread: Vec<f64>,
    ) -> Estimate {
        let (state, parameters) = mean.split_at(self.state_values);
        let of_parameters = spread.split_off(self.state_values);
        let mut state = bands.gather([state, &spread].concat());
        let mut spread = state.split_off(state.len() / 2);
        spread.extend(of_parameters);
        let (state, calibration) = self.unpack(problem, state, parameters);
        Estimate::with_spread(state, calibration, spread)
    }

    /// The members of all ranks, on rank 0; members without values of the state on the others.
    pub(super) fn gathered(&self, bands: &Bands) -> Self {
        if bands.is_whole() {
            return self.clone();
        }
        let mut values = Vec::new();
        let mut state_values = 0;
        for member in self.values.chunks_exact(self.rows) {
            let (state, parameters) = member.split_at(self.state_values);
            let state = bands.gather_to_first(state.to_vec());
            state_values = state.len();
            values.extend(state);
            values.extend_from_slice(parameters);
        }
        Self { state_values, rows: state_values + self.parameters(), values, time: self.time }
    }

    /// This rank's part of whole members.
    ///
    /// # Errors
    /// [`Error::Memory`] if they are not members of states of the bands' grid.
    pub(super) fn part(self, bands: &Bands) -> Result<Self, Error> {
        if bands.is_whole() {
            return Ok(self);
        }
        let Self { state_values, rows, values, time } = self;
        let is_whole = state_values <= rows
            && rows > 0
            && values.len().is_multiple_of(rows)
            && state_values.is_multiple_of(bands.grid().cells());
        require(is_whole, "the ensemble")?;
        let own_values = state_values / bands.grid().ny * bands.own().len();
        let of_member =
            |member: &[f64]| [&bands.own_part(&member[..state_values])[..], &member[state_values..]].concat();
        let values = values.chunks_exact(rows).flat_map(of_member).collect();
        Ok(Self { state_values: own_values, rows: own_values + rows - state_values, values, time })
    }
}

/// Parts of draws from N(0, U Uᵀ) for states of `len` values, zero if there is no covariance, given what all ranks draw alike for each: normal numbers of the root's control space, and others,
/// which are given back. Each rank makes whole columns of its share of the draws.
pub(super) fn draw_parts(
    bands: &Bands,
    (covariance, len): (Option<&dyn Covariance>, usize),
    draws: usize,
    mut draw: impl FnMut() -> (Vec<f64>, Vec<f64>),
) -> impl Iterator<Item = (Vec<f64>, Vec<f64>)> {
    let (share, mut own, mut others) = (bands.share(draws), Vec::new(), Vec::new());
    for number in 0..draws {
        let (normals, other) = draw();
        others.push(other);
        if share.contains(&number) {
            own.push(normals);
        }
    }
    let make = |normals: &Vec<f64>| {
        let mut column = vec![0.0; len];
        if let Some(covariance) = covariance {
            covariance.root_add(normals, &mut column);
        }
        column
    };
    bands.deal(own.par_iter().map(make).collect()).into_iter().zip(others)
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
