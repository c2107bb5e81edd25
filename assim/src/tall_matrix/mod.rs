//! Tall matrices: factors, whose columns are increments.
//!
//! Millions of rows and some tens of columns: every operation goes through the rows in chunks of a fixed number, over
//! threads, and sums are taken in the order of a fixed tree, so that the bits are the same on any number of threads.
//! Nothing here allocates a second matrix of that size.
//!
//! They may be stored in single precision. Then a chunk is widened when it is read and rounded when it is written, and all
//! that is done with it is done in double precision.

mod products;
mod shared;

pub(crate) use products::{add_scaled_gram, cross_product, scaled_gram};

use isobar_model::{Bands, ColumnsMut, Stored};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// How factors are stored, and in what their tangent-linear forecasts are computed; sums and products of them are in double
/// precision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Precision {
    /// In 8 bytes.
    Double,
    /// In 4 bytes, with a relative error of 2⁻²⁴ whenever they are written, and in each operation of a forecast.
    Single,
}

impl Precision {
    /// Bytes of a number.
    pub(crate) fn bytes(self) -> u64 {
        match self {
            Precision::Double => 8,
            Precision::Single => 4,
        }
    }
}

/// All columns, one after another.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) enum Values {
    Double(Vec<f64>),
    Single(Vec<f32>),
}

impl From<Vec<f64>> for Values {
    fn from(values: Vec<f64>) -> Self {
        Values::Double(values)
    }
}

impl From<Vec<f32>> for Values {
    fn from(values: Vec<f32>) -> Self {
        Values::Single(values)
    }
}

/// The same code for [`Values`] of either precision.
macro_rules! stored {
    ($values:expr, $name:ident => $body:expr) => {
        match $values {
            $crate::tall_matrix::Values::Double($name) => $body,
            $crate::tall_matrix::Values::Single($name) => $body,
        }
    };
}
pub(crate) use stored;

/// A column-major matrix `[rows, columns]` without padding, so that its columns are increments one after another.
///
/// Where several ranks compute a run, the rows of a matrix whose columns are states are divided among them as these are. What is
/// asked of the matrix is asked of the whole then, and is collective, but for what says that it is about the rows of this rank.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct TallMatrix {
    /// The rows of this rank.
    rows: usize,
    columns: usize,
    values: Values,
    /// Which rows they are, if not all.
    #[serde(skip)]
    bands: Option<Bands>,
}

impl TallMatrix {
    pub fn zeros(rows: usize, columns: usize, precision: Precision) -> Self {
        let values = match precision {
            Precision::Double => vec![0_f64; rows * columns].into(),
            Precision::Single => vec![0_f32; rows * columns].into(),
        };
        Self { rows, columns, values, bands: None }
    }

    /// A matrix of the given values, one column after another.
    pub fn from_values(rows: usize, columns: usize, values: impl Into<Values>) -> Self {
        let values = values.into();
        assert_eq!(stored!(&values, values => values.len()), rows * columns);
        Self { rows, columns, values, bands: None }
    }

    /// Whether it has this shape, whatever was stored.
    pub fn has_shape(&self, rows: usize, columns: usize) -> bool {
        let len = stored!(&self.values, values => values.len());
        (self.rows(), self.columns) == (rows, columns) && self.rows.checked_mul(columns) == Some(len)
    }

    /// The number of rows that this rank has.
    pub fn own_rows(&self) -> usize {
        self.rows
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    pub fn precision(&self) -> Precision {
        match self.values {
            Values::Double(_) => Precision::Double,
            Values::Single(_) => Precision::Single,
        }
    }

    /// All columns, one after another, as they are stored.
    pub fn values(&self) -> &Values {
        &self.values
    }

    /// All columns, one after another, as they are stored.
    pub fn values_mut(&mut self) -> &mut Values {
        &mut self.values
    }

    /// An entry, if this rank has it, and zero if another one has.
    pub fn value(&self, row: usize, column: usize) -> f64 {
        let Some(row) = own_row(self.bands.as_ref(), row) else { return 0.0 };
        stored!(&self.values, values => values[column * self.rows..][..self.rows][row].widen())
    }

    /// Sets an entry, if this rank has it.
    pub fn set(&mut self, row: usize, column: usize, value: f64) {
        let Some(row) = own_row(self.bands.as_ref(), row) else { return };
        stored!(&mut self.values, values => values[column * self.rows..][..self.rows][row] = Stored::narrow(value));
    }

    /// The rows of a column that this rank has.
    pub fn own_column(&self, column: usize) -> Cow<'_, [f64]> {
        let part = column * self.rows..(column + 1) * self.rows;
        match &self.values {
            Values::Double(values) => Cow::Borrowed(&values[part]),
            Values::Single(values) => values[part].iter().map(|value| value.widen()).collect(),
        }
    }

    /// Applies `work` to the rows of a column that this rank has.
    pub fn edit_own_column(&mut self, column: usize, work: impl FnOnce(&mut [f64])) {
        let part = column * self.rows..(column + 1) * self.rows;
        stored!(&mut self.values, values => Stored::in_double(&mut values[part], &mut Vec::new(), work));
    }

    /// Applies `work` to each column, in parallel; to none if they have no rows.
    pub fn edit_columns(&mut self, work: impl Fn(&mut [f64]) + Sync) {
        if let Some(bands) = self.bands.clone() {
            return self.edit_whole_columns(&bands, 0..self.columns, |columns| {
                columns.par_iter_mut().for_each(|column| work(column));
            });
        }
        let rows = self.rows.max(1);
        stored!(&mut self.values, values => {
            values.par_chunks_exact_mut(rows).for_each_init(Vec::new, |scratch, column| {
                Stored::in_double(column, scratch, &work);
            });
        });
    }

    /// The columns, each to be changed here and there.
    pub fn columns_mut(&mut self) -> Vec<ColumnMut<'_>> {
        let bands = self.bands.as_ref();
        let column = |values| ColumnMut { values, bands };
        if self.rows == 0 {
            return (0..self.columns).map(|_| column(ColumnsMut::Double(&mut []))).collect();
        }
        match &mut self.values {
            Values::Double(values) => values.chunks_exact_mut(self.rows).map(ColumnsMut::Double).map(column).collect(),
            Values::Single(values) => values.chunks_exact_mut(self.rows).map(ColumnsMut::Single).map(column).collect(),
        }
    }

    /// A ← factor A.
    pub fn scale(&mut self, factor: f64) {
        stored!(&mut self.values, values => {
            values.iter_mut().for_each(|value| *value = Stored::narrow(value.widen() * factor));
        });
    }

    /// A ← diag(scales) A.
    pub fn scale_rows(&mut self, scales: &[f64]) {
        let (scales, rows) = (self.own_part(scales).into_owned(), self.rows.max(1));
        stored!(&mut self.values, values => values.par_chunks_exact_mut(rows).for_each(|column| {
            let scaled = column.iter_mut().zip(&scales);
            scaled.for_each(|(value, scale)| *value = Stored::narrow(value.widen() * scale));
        }));
    }

    /// Makes room for `columns` columns in all, and no more.
    pub fn reserve(&mut self, columns: usize) {
        let wanted = self.rows * columns;
        stored!(&mut self.values, values => values.reserve_exact(wanted.saturating_sub(values.len())));
    }

    /// Makes room for `columns` columns in all, if there is any: a file may say any number.
    pub fn try_reserve(&mut self, columns: usize) -> bool {
        let Some(wanted) = self.rows.checked_mul(columns) else { return false };
        stored!(&mut self.values, values => values.try_reserve_exact(wanted.saturating_sub(values.len())).is_ok())
    }

    /// Appends columns of zeros.
    pub fn append(&mut self, columns: usize) {
        self.reserve(self.columns + columns);
        self.columns += columns;
        let len = self.rows * self.columns;
        stored!(&mut self.values, values => values.resize(len, 0.0));
    }

    /// Puts columns of zeros before the others, in place.
    pub fn prepend(&mut self, columns: usize) {
        self.append(columns);
        let added = self.rows * columns;
        stored!(&mut self.values, values => values.rotate_right(added));
    }

    /// Takes the first columns out.
    pub fn take_front(&mut self, columns: usize) -> TallMatrix {
        let cut = self.rows * columns;
        let front = stored!(&mut self.values, values => {
            let front = values[..cut].to_vec();
            values.copy_within(cut.., 0);
            Self { bands: self.bands.clone(), ..Self::from_values(self.rows, columns, front) }
        });
        self.truncate(self.columns - columns);
        front
    }

    /// Keeps the first columns only; their memory stays reserved.
    pub fn truncate(&mut self, columns: usize) {
        self.columns = self.columns.min(columns);
        let len = self.rows * self.columns;
        stored!(&mut self.values, values => values.truncate(len));
    }

    /// Returns what is reserved beyond the columns.
    pub fn shrink_to_fit(&mut self) {
        stored!(&mut self.values, values => values.shrink_to_fit());
    }
}

/// A column that is changed here and there.
pub(crate) struct ColumnMut<'a> {
    values: ColumnsMut<'a>,
    bands: Option<&'a Bands>,
}

impl ColumnMut<'_> {
    /// Subtracts from an entry, if this rank has it.
    pub fn subtract(&mut self, row: usize, change: f64) {
        let Some(row) = own_row(self.bands, row) else { return };
        match &mut self.values {
            ColumnsMut::Double(values) => values[row] -= change,
            ColumnsMut::Single(values) => values[row] = f32::narrow(values[row].widen() - change),
        }
    }
}

/// Which of this rank's rows one of all is, if it has it.
fn own_row(bands: Option<&Bands>, row: usize) -> Option<usize> {
    bands.map_or(Some(row), |bands| bands.own_index(row))
}

#[cfg(test)]
mod tests {
    use super::products::tests::{PRECISIONS, dense, random};
    use super::{Precision, TallMatrix};
    use std::io::{self, Write};

    /// What was written, and the longest piece of it.
    #[derive(Default)]
    struct Pieces {
        bytes: Vec<u8>,
        longest: usize,
    }

    impl Write for Pieces {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.longest = self.longest.max(bytes.len());
            self.bytes.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_matrix_is_saved_column_by_column_and_read_again() {
        for (precision, _) in PRECISIONS {
            let matrix = random(700, 5, 6, precision);
            let mut saved = Pieces::default();
            matrix.save(&mut saved).unwrap();
            assert!(saved.longest <= 700 * precision.bytes() as usize + 8, "{} bytes at once", saved.longest);
            let like = TallMatrix::zeros(700, 1, precision);
            let again = like.read_like(&mut &saved.bytes[..]).unwrap();
            assert!(dense(&again) == dense(&matrix) && again.precision() == precision);
            assert!(like.read_like(&mut &saved.bytes[..saved.bytes.len() - 1]).is_err());
            assert!(TallMatrix::zeros(699, 1, precision).read_like(&mut &saved.bytes[..]).is_err());
        }
        let mut saved = Vec::new();
        random(9, 2, 6, Precision::Single).save(&mut saved).unwrap();
        assert!(TallMatrix::zeros(9, 2, Precision::Double).read_like(&mut &saved[..]).is_err());
    }

    #[test]
    fn columns_are_edited_added_and_taken_out_in_either_precision() {
        for (precision, rounded) in PRECISIONS {
            let mut matrix = random(700, 3, 4, precision);
            let before = dense(&matrix);
            matrix.prepend(2);
            matrix.append(1);
            assert!(matrix.column(0).iter().chain(&*matrix.column(5)).all(|&value| value == 0.0));
            matrix.edit_column(1, |column| column.copy_from_slice(before.col_as_slice(2)));
            matrix.edit_columns(|column| column.iter_mut().for_each(|value| *value *= 3.0));
            matrix.scale(0.5);
            matrix.columns_mut().iter_mut().for_each(|column| column.subtract(699, 1.0));
            matrix.set(3, 4, 0.1);
            let front = matrix.take_front(2);
            assert_eq!((front.columns(), matrix.columns(), front.precision()), (2, 4, precision));
            let expected =
                |i: usize, j: usize| if i == 699 { 1.5 * before[(i, j)] - 1.0 } else { 1.5 * before[(i, j)] };
            for i in 0..700 {
                assert!((front.value(i, 1) - expected(i, 2)).abs() < rounded);
                for j in 0..3 {
                    let expected = if (i, j) == (3, 2) { 0.1 } else { expected(i, j) };
                    assert!((matrix.value(i, j) - expected).abs() < rounded, "{precision:?} ({i}, {j})");
                }
            }
        }
    }
}
