//! Mean and perturbations of an ensemble.

use crate::memory::Matrix;
use faer::Mat;
use isobar_model::Bands;
use isobar_model::vector::{add, subtract};
use serde::{Deserialize, Serialize};

/// An ensemble as its mean and the members' deviations from it.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Moments {
    /// `[m + p]`.
    pub mean: Vec<f64>,
    /// `[m + p, N]`; each row has sum zero.
    pub perturbations: Matrix,
}

impl Moments {
    /// The moments of members whose perturbations are the first columns of `transformed`, `[m + p, N + 1]`, about the given
    /// mean plus the last column. The two are kept apart because an increment may exceed the perturbations by far.
    pub fn of_transformed(mut mean: Vec<f64>, transformed: &Mat<f64>) -> Self {
        let members = transformed.ncols() - 1;
        add(&mut mean, transformed.col_as_slice(members));
        Self::of_deviations(mean, transformed.get(.., ..members).to_owned())
    }

    /// The moments of members that deviate from `about` by the given columns, `[m + p, N]`.
    pub fn of_deviations(mut about: Vec<f64>, mut deviations: Mat<f64>) -> Self {
        let members = deviations.ncols();
        let mut shift = vec![0.0; about.len()];
        (0..members).for_each(|j| add(&mut shift, deviations.col_as_slice(j)));
        shift.iter_mut().for_each(|shift| *shift /= members as f64);
        (0..members).for_each(|j| subtract(deviations.col_as_slice_mut(j), &shift));
        add(&mut about, &shift);
        Self { mean: about, perturbations: Matrix(deviations) }
    }

    /// The moments of the rows from `first` on.
    pub fn rows_from(&self, first: usize) -> Self {
        let perturbations = self.perturbations.get(first.., ..).to_owned();
        Self { mean: self.mean[first..].to_vec(), perturbations: Matrix(perturbations) }
    }

    /// Sets the rows from `first` on.
    pub fn set_rows_from(&mut self, first: usize, rows: &Self) {
        self.mean[first..].copy_from_slice(&rows.mean);
        self.perturbations.as_mut().get_mut(first.., ..).copy_from(&*rows.perturbations);
    }

    /// The first `state_values` rows as fields of `cells` values, cut at these lengths: for each piece the parts of the mean's
    /// fields, then those of the first member's perturbations …
    pub fn split_fields(&mut self, state_values: usize, cells: usize, lengths: &[usize]) -> Vec<Vec<&mut [f64]>> {
        let perturbations = self.perturbations.as_mut().try_as_col_major_mut().expect("columns are in one piece");
        let columns = perturbations.col_iter_mut().map(|column| column.as_slice_mut());
        split_fields(std::iter::once(&mut *self.mean).chain(columns), state_values, cells, lengths)
    }
}

/// The first `state_values` of each column as fields of `cells` values, cut at these lengths: for each piece the parts of the
/// first column's fields, then those of the second's …
pub(super) fn split_fields<'a>(
    columns: impl Iterator<Item = &'a mut [f64]>,
    state_values: usize,
    cells: usize,
    lengths: &[usize],
) -> Vec<Vec<&'a mut [f64]>> {
    let mut pieces: Vec<Vec<&mut [f64]>> = lengths.iter().map(|_| Vec::new()).collect();
    for column in columns {
        for mut field in column[..state_values].chunks_exact_mut(cells) {
            for (piece, &length) in pieces.iter_mut().zip(lengths) {
                piece.push(field.split_off_mut(..length).expect("the lengths sum up to a field"));
            }
        }
    }
    pieces
}

/// Standard deviation of each row of perturbations.
pub(super) fn spread(perturbations: &Mat<f64>) -> Vec<f64> {
    let mut squares = vec![0.0; perturbations.nrows()];
    for j in 0..perturbations.ncols() {
        squares.iter_mut().zip(perturbations.col_as_slice(j)).for_each(|(sum, value)| *sum += value * value);
    }
    let degrees = (perturbations.ncols() - 1) as f64;
    squares.iter().map(|square| (square / degrees).sqrt()).collect()
}

/// The standard deviation of each variable over the domain, for every value of the state that this rank has: the scales of a norm in
/// which no variable is lost beside another. `spread` may go on with that of parameters.
pub(super) fn variable_scales(bands: &Bands, fields: usize, spread: &[f64]) -> Vec<f64> {
    let own_cells = bands.own_cells().len();
    let (state, calibration) = spread.split_at(fields * own_cells);
    let sum_of_squares = |field: &[f64]| field.iter().map(|sigma| sigma * sigma).sum::<f64>();
    let mut sums: Vec<f64> = state.chunks_exact(own_cells).map(sum_of_squares).collect();
    bands.communicator().sum(&mut sums);
    let of_field = |sum: f64| {
        let mean_square = sum / bands.grid().cells() as f64;
        if mean_square > 0.0 { mean_square.sqrt() } else { 1.0 }
    };
    let state = sums.into_iter().flat_map(|sum| std::iter::repeat_n(of_field(sum), own_cells));
    state.chain(calibration.iter().map(|&sigma| if sigma > 0.0 { sigma } else { 1.0 })).collect()
}
