//! What a method must remember from one cycle to the next, as bytes for a checkpoint.

use crate::error::Error;
use faer::Mat;
use isobar_model::State;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A dense matrix, column by column.
#[derive(Serialize, Deserialize)]
pub(crate) struct Matrix {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl From<&Mat<f64>> for Matrix {
    fn from(matrix: &Mat<f64>) -> Self {
        let values = (0..matrix.ncols()).flat_map(|j| matrix.col_as_slice(j)).copied().collect();
        Self { rows: matrix.nrows(), columns: matrix.ncols(), values }
    }
}

impl Matrix {
    /// Its number of rows, as it says.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The matrix, if it has so many rows; `columns` as well unless that is `None`.
    ///
    /// # Errors
    /// [`Error::Saved`].
    pub fn restored(self, rows: usize, columns: Option<usize>, name: &str) -> Result<Mat<f64>, Error> {
        let length = self.rows.checked_mul(self.columns);
        let fits = self.rows == rows && columns.is_none_or(|columns| columns == self.columns);
        if !fits || length != Some(self.values.len()) {
            return Err(unfit(name));
        }
        Ok(Mat::from_fn(self.rows, self.columns, |i, j| self.values[j * self.rows + i]))
    }
}

/// The error that a part does not fit the method.
pub(crate) fn unfit(name: &str) -> Error {
    Error::Saved { reason: format!("{name} does not fit the experiment") }
}

/// The bytes of a state.
pub(crate) fn to_bytes<S: Serialize>(saved: &S) -> Result<Vec<u8>, Error> {
    postcard::to_stdvec(saved).map_err(|error| Error::Saved { reason: error.to_string() })
}

/// A state from its bytes.
pub(crate) fn from_bytes<S: DeserializeOwned>(bytes: &[u8]) -> Result<S, Error> {
    match postcard::take_from_bytes(bytes) {
        Ok((saved, [])) => Ok(saved),
        Ok(_) => Err(Error::Saved { reason: "it is too long".into() }),
        Err(error) => Err(Error::Saved { reason: error.to_string() }),
    }
}

/// Takes back the values of a state.
pub(crate) fn restore_state(state: &mut State, values: &[f64]) -> Result<(), Error> {
    if values.len() != state.values().len() {
        return Err(unfit("the state"));
    }
    state.values_mut().copy_from_slice(values);
    Ok(())
}

/// Takes back the estimates of the calibration parameters.
pub(crate) fn restore_bias(bias: &mut [f64], saved: &[f64]) -> Result<(), Error> {
    if bias.len() != saved.len() {
        return Err(unfit("the calibration"));
    }
    bias.copy_from_slice(saved);
    Ok(())
}
