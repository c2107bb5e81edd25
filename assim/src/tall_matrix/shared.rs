//! Tall matrices whose rows several ranks have.

use super::{Precision, TallMatrix};
use crate::error::Error;
use crate::linalg::summed;
use crate::memory::{read, require, write};
use faer::Mat;
use isobar_model::{Bands, Stored};
use std::borrow::Cow;
use std::io::{Read, Write};
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

    /// Which of all rows this rank has.
    pub fn own_ranges(&self) -> Vec<Range<usize>> {
        match &self.bands {
            None => std::iter::once(0..self.rows).collect(),
            Some(bands) => bands.own_ranges(self.rows / bands.own_cells().len()).collect(),
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

    /// A vector of all rows, of which each rank has those right that it has. Collective.
    pub fn of_all_ranks(&self, y: Vec<f64>) -> Vec<f64> {
        match &self.bands {
            None => y,
            Some(bands) => bands.gather(bands.own_part(&y)),
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

    /// Writes the rows of all ranks, column by column; they are not in what another rank than 0 writes. Collective.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&(self.rows(), self.columns, self.precision()), to)?;
        for column in 0..self.columns {
            let own = self.own_column(column);
            let whole = match &self.bands {
                None => own,
                Some(bands) => bands.gather_to_first(own.into_owned()).into(),
            };
            match self.precision() {
                Precision::Double => write(&whole, to)?,
                Precision::Single => write(&whole.iter().map(|&value| f32::narrow(value)).collect::<Vec<_>>(), to)?,
            }
        }
        Ok(())
    }

    /// This rank's rows of a matrix that [`TallMatrix::save`] has written, with as many rows as this one and in its precision.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn read_like(&self, from: &mut dyn Read) -> Result<Self, Error> {
        let (rows, columns, precision): (usize, usize, Precision) = read(from)?;
        let mut matrix = self.zeros_like(0, precision);
        let fits = rows == self.rows() && precision == self.precision() && matrix.try_reserve(columns);
        require(fits, "the matrix of the factors")?;
        for column in 0..columns {
            let whole: Vec<f64> = match precision {
                Precision::Double => read(from)?,
                Precision::Single => read::<Vec<f32>>(from)?.into_iter().map(Stored::widen).collect(),
            };
            require(whole.len() == rows, "a column of the factors")?;
            matrix.append(1);
            matrix.set_column(column, &whole);
        }
        Ok(matrix)
    }
}
