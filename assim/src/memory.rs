//! What a method carries from cycle to cycle, as bytes for a checkpoint.

use crate::error::Error;
use faer::Mat;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::ops::{Deref, DerefMut};

/// A dense matrix that can be part of a memory. It is stored column by column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "Stored", try_from = "Stored")]
pub(crate) struct Matrix(pub Mat<f64>);

#[derive(Serialize, Deserialize)]
struct Stored {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl From<Matrix> for Stored {
    fn from(Matrix(matrix): Matrix) -> Self {
        let values = (0..matrix.ncols()).flat_map(|j| matrix.col_as_slice(j)).copied().collect();
        Self { rows: matrix.nrows(), columns: matrix.ncols(), values }
    }
}

impl TryFrom<Stored> for Matrix {
    type Error = String;
    fn try_from(Stored { rows, columns, values }: Stored) -> Result<Self, String> {
        if rows.checked_mul(columns) != Some(values.len()) {
            return Err(format!("{} values for a matrix of {rows} rows and {columns} columns", values.len()));
        }
        Ok(Self(Mat::from_fn(rows, columns, |i, j| values[j * rows + i])))
    }
}

impl From<Mat<f64>> for Matrix {
    fn from(matrix: Mat<f64>) -> Self {
        Self(matrix)
    }
}

impl Deref for Matrix {
    type Target = Mat<f64>;
    fn deref(&self) -> &Mat<f64> {
        &self.0
    }
}

impl DerefMut for Matrix {
    fn deref_mut(&mut self) -> &mut Mat<f64> {
        &mut self.0
    }
}

impl Matrix {
    /// Whether it has this shape.
    pub fn has_shape(&self, rows: usize, columns: usize) -> bool {
        (self.nrows(), self.ncols()) == (rows, columns)
    }
}

/// Fails if a part of a memory does not fit the method that recalls it.
///
/// # Errors
/// [`Error::Memory`] with the name of the part.
pub(crate) fn require(fits: bool, part: &str) -> Result<(), Error> {
    if fits {
        return Ok(());
    }
    Err(Error::Memory { reason: format!("{part} does not fit the experiment") })
}

/// The bytes of a memory.
///
/// # Errors
/// [`Error::Memory`].
pub(crate) fn to_bytes<S: Serialize>(memory: &S) -> Result<Vec<u8>, Error> {
    postcard::to_stdvec(memory).map_err(|error| Error::Memory { reason: error.to_string() })
}

/// A memory from its bytes.
///
/// # Errors
/// [`Error::Memory`].
pub(crate) fn from_bytes<S: DeserializeOwned>(bytes: &[u8]) -> Result<S, Error> {
    match postcard::take_from_bytes(bytes) {
        Ok((memory, [])) => Ok(memory),
        Ok(_) => Err(Error::Memory { reason: "it is too long".into() }),
        Err(error) => Err(Error::Memory { reason: error.to_string() }),
    }
}
