//! The ensemble: members (x, c) as columns.

use super::EnsembleSettings;
use super::model_error::add_model_error;
use super::moments::{Moments, split_fields};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::error::Error;
use crate::estimate::Estimate;
use crate::linalg::{add_symmetric_product, product, semidefinite_root};
use crate::memory::{Matrix, read, require, write};
use crate::problem::{Problem, steps};
use faer::{Mat, MatRef};
use isobar_model::random::standard_normals;
use isobar_model::vector::{add, axpy, subtract};
use isobar_model::{Bands, Duration, Model, State, Time, forecast};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rayon::slice::ChunksExact;
use std::io::{Read, Write};

/// N members of the augmented state (x, c), each a column of m + p values; p is zero where biases are not estimated.
///
/// Where several ranks compute a run, each has the m values of the state in its band of rows, and all parameters.
#[derive(Clone)]
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
    /// Members with this mean, `[m + p]`, and these perturbations shifted to mean zero, column-major `[m + p, N]`.
    pub(super) fn about(mean: &[f64], state_values: usize, perturbations: Vec<f64>, time: Option<Time>) -> Self {
        let mut ensemble = Self { state_values, rows: mean.len(), values: perturbations, time };
        ensemble.center();
        ensemble.values.chunks_exact_mut(mean.len()).for_each(|member| add(member, mean));
        ensemble
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

    /// A column of the members' covariance, of all rows of the state and the parameters; `None` if there is no such number.
    pub(super) fn covariance_column(&self, bands: &Bands, number: usize) -> Option<Vec<f64>> {
        let Moments { perturbations, .. } = self.moments();
        let (m, whole) = (self.state_values, self.whole_state_values(bands));
        if number >= whole + self.parameters() {
            return None;
        }
        // The rank that has the row adds it; that of a parameter is on all of them.
        let own_row = match number.checked_sub(whole) {
            None => bands.own_index(number),
            Some(parameter) => (bands.communicator().rank() == 0).then_some(m + parameter),
        };
        let value = |j: usize| own_row.map_or(0.0, |row| perturbations[(row, j)]);
        let mut row: Vec<f64> = (0..self.members()).map(value).collect();
        bands.communicator().sum(&mut row);
        let mut column = vec![0.0; self.rows];
        let degrees = (self.members() - 1) as f64;
        for (j, value) in row.iter().enumerate() {
            axpy(value / degrees, perturbations.col_as_slice(j), &mut column);
        }
        let of_parameters = column.split_off(m);
        let mut column = bands.gather(column);
        column.extend(of_parameters);
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

    /// Forecasts each member with the model, and adds what a window adds to the errors.
    pub(super) fn forecast(
        &mut self,
        problem: &Problem<dyn Model>,
        settings: &EnsembleSettings,
        window: Duration,
        random: &mut ChaCha8Rng,
    ) -> Result<(), Error> {
        self.forecast_states(&*problem.model, steps(&*problem.model, window)?)?;
        let kept = problem.estimated_calibration().kept(window);
        for member in self.values.chunks_exact_mut(self.rows) {
            member[self.state_values..].iter_mut().zip(&kept).for_each(|(value, kept)| *value *= kept);
        }
        self.time = self.time.map(|time| time + window);
        let mut moments = self.moments();
        add_model_error(problem, settings.model_error, window, &mut moments.perturbations, random);
        self.set(&moments);
        Ok(())
    }

    /// Advances the members' states: this rank's part of each, if several ranks have them.
    fn forecast_states(&mut self, model: &dyn Model, steps: usize) -> Result<(), Error> {
        let (m, rows, time, together) =
            (self.state_values, self.rows, self.time, forecast::together(model, self.members()));
        if let Some(model) = model.in_bands() {
            let mut parts: Vec<&mut [f64]> =
                self.values.chunks_exact_mut(rows).map(|member| &mut member[..m]).collect();
            return Ok(model.forecast_parts(&mut parts, time, steps)?);
        }
        self.values.par_chunks_mut(together * rows).try_for_each(|members| {
            let state = |member: &[f64]| State::from_values(model.layout(), member[..m].to_vec()).valid_at(time);
            let mut states: Vec<State> = members.chunks_exact(rows).map(state).collect();
            forecast::forecast_together(model, &mut states, steps)?;
            for (member, state) in members.chunks_exact_mut(rows).zip(&states) {
                member[..m].copy_from_slice(state.values());
            }
            Ok(())
        })
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

    /// State and full calibration of a whole member.
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

    /// Writes the members of all ranks, one by one; they are not whole in what another rank than 0 writes. Collective.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub(super) fn save(&self, bands: &Bands, to: &mut dyn Write) -> Result<(), Error> {
        write(&(self.whole_state_values(bands), self.parameters(), self.members(), self.time), to)?;
        self.values.chunks_exact(self.rows).try_for_each(|member| {
            let (state, parameters) = member.split_at(self.state_values);
            if bands.is_whole() {
                return write(&(state, parameters), to);
            }
            write(&(bands.gather_to_first(state.to_vec()), parameters), to)
        })
    }

    /// This rank's part of an ensemble of the size of this one, which [`Ensemble::save`] has written.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub(super) fn read_like(&self, bands: &Bands, from: &mut dyn Read) -> Result<Self, Error> {
        let (state_values, parameters, members, time) = read(from)?;
        let own: (usize, usize, usize) = (self.whole_state_values(bands), self.parameters(), self.members());
        require((state_values, parameters, members) == own, "the ensemble")?;
        let mut values = Vec::with_capacity(self.values.len());
        for _ in 0..members {
            let (state, parameters): (Vec<f64>, Vec<f64>) = read(from)?;
            require((state.len(), parameters.len()) == (own.0, own.1), "a member of the ensemble")?;
            values.extend(if bands.is_whole() { state } else { bands.own_part(&state) });
            values.extend(parameters);
        }
        Ok(Self { values, time, ..*self })
    }

    /// The number of values of a state of all ranks.
    fn whole_state_values(&self, bands: &Bands) -> usize {
        self.state_values / bands.own_cells().len() * bands.grid().cells()
    }
}
