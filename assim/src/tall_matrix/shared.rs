//! Tall matrices whose rows several ranks have.

use super::{Precision, TallMatrix};
use crate::linalg::summed;
use faer::Mat;
use isobar_model::Bands;
use std::borrow::Cow;
use std::ops::Range;

impl TallMatrix {
    /// This rank's rows of zeros, `[rows, columns]`, where columns are states of the bands' grid.
    pub fn zeros_in(bands: &Bands, rows: usize, columns: usize, precision: Precision) -> Self {
        if bands.is_whole() {
            return Self::zeros(rows, columns, precision);
        }
        let own_rows = rows / bands.grid().cells() * bands.own_cells().len();
        Self { bands: Some(bands.clone()), ..Self::zeros(own_rows, columns, precision) }
    }

    /// Zeros of other columns like these.
    pub fn zeros_like(&self, columns: usize, precision: Precision) -> Self {
        Self { bands: self.bands.clone(), ..Self::zeros(self.rows, columns, precision) }
    }

    /// Which rank has which rows, if not one has all.
    pub fn bands(&self) -> Option<&Bands> {
        self.bands.as_ref()
    }

    /// The number of rows of all ranks.
    pub fn rows(&self) -> usize {
        match &self.bands {
            None => self.rows,
            Some(bands) => self.rows / bands.own_cells().len() * bands.grid().cells(),
        }
    }

    /// The rows of this rank of a vector of all rows.
    pub(super) fn own_part<'a>(&self, whole: &'a [f64]) -> Cow<'a, [f64]> {
        self.bands.as_ref().map_or(Cow::Borrowed(whole), |bands| bands.own_part(whole).into())
    }

    /// Changes this rank's rows of a vector of all rows, y, and then has those of all ranks.
    pub(super) fn change_own(&self, y: &mut [f64], change: impl FnOnce(&mut [f64])) {
        match &self.bands {
            None => change(y),
            Some(bands) => {
                let mut own = bands.own_part(y);
                change(&mut own);
                y.copy_from_slice(&bands.gather(own));
            }
        }
    }

    /// The sum over the ranks of what each has found from its rows.
    pub(super) fn summed(&self, of_own: Mat<f64>) -> Mat<f64> {
        match &self.bands {
            None => of_own,
            Some(bands) => summed(bands.communicator(), of_own),
        }
    }

    /// A column, all of it.
    pub fn column(&self, column: usize) -> Cow<'_, [f64]> {
        match &self.bands {
            None => self.own_column(column),
            Some(bands) => bands.gather(self.own_column(column).into_owned()).into(),
        }
    }

    /// Applies `work` to a column, all of it.
    pub fn edit_column(&mut self, column: usize, work: impl FnOnce(&mut [f64])) {
        let Some(bands) = self.bands.clone() else { return self.edit_own_column(column, work) };
        let mut whole = self.column(column).into_owned();
        work(&mut whole);
        self.edit_own_column(column, |own| own.copy_from_slice(&bands.own_part(&whole)));
    }

    /// Sets a column to values that every rank has in full.
    pub fn set_column(&mut self, column: usize, values: &[f64]) {
        let part = self.own_part(values);
        self.edit_own_column(column, |own| own.copy_from_slice(&part));
    }

    /// Applies `work` to some of the columns, each whole on one of the ranks: to as many at a time as this one has threads.
    pub fn edit_whole_columns(&mut self, bands: &Bands, columns: Range<usize>, mut work: impl FnMut(&mut [Vec<f64>])) {
        let together = bands.communicator().ranks() * rayon::current_num_threads();
        // The same on all ranks, whose threads may differ in number.
        let together = bands.communicator().of_first(vec![together as f64])[0] as usize;
        for first in columns.clone().step_by(together) {
            let columns = first..columns.end.min(first + together);
            let parts: Vec<_> = columns.clone().map(|column| self.own_column(column)).collect();
            let mut whole = bands.collect(&parts);
            drop(parts);
            work(&mut whole);
            for (column, part) in columns.zip(bands.deal(whole)) {
                self.edit_own_column(column, |own| own.copy_from_slice(&part));
            }
        }
    }

    /// The rows of all ranks, on rank 0; no rows on the others.
    pub fn gathered(&self) -> Self {
        let Some(bands) = &self.bands else { return self.clone() };
        let mut whole =
            Self::zeros(if bands.communicator().rank() == 0 { self.rows() } else { 0 }, 0, self.precision());
        for column in 0..self.columns {
            let values = bands.gather_to_first(self.own_column(column).into_owned());
            whole.append(1);
            whole.edit_own_column(column, |own| own.copy_from_slice(&values));
        }
        whole
    }

    /// This rank's rows of a matrix with all rows; `None` if its columns are no states of the grid.
    pub fn in_bands(&self, bands: &Bands) -> Option<Self> {
        if bands.is_whole() {
            return Some(self.clone());
        }
        let fits = self.rows.is_multiple_of(bands.grid().cells()) && self.has_shape(self.rows, self.columns);
        fits.then(|| {
            let mut part = Self::zeros_in(bands, self.rows, self.columns, self.precision());
            (0..self.columns).for_each(|column| part.set_column(column, &self.own_column(column)));
            part
        })
    }
}
