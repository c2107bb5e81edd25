//! What a method carries from cycle to cycle, as bytes for a checkpoint.

use crate::error::Error;
use faer::Mat;
use serde::de::DeserializeOwned;
use serde::ser::{SerializeSeq, SerializeStruct};
use serde::{Deserialize, Serialize, Serializer};
use std::ops::{Deref, DerefMut};

/// A dense matrix that can be part of a memory. It is stored column by column.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(try_from = "Stored")]
pub(crate) struct Matrix(pub Mat<f64>);

#[derive(Deserialize)]
struct Stored {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

/// As [`Stored`], without a copy of the matrix.
impl Serialize for Matrix {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut stored = serializer.serialize_struct("Stored", 3)?;
        stored.serialize_field("rows", &self.nrows())?;
        stored.serialize_field("columns", &self.ncols())?;
        stored.serialize_field("values", &Values(self))?;
        stored.end()
    }
}

/// The entries of a matrix column by column.
struct Values<'a>(&'a Mat<f64>);

impl Serialize for Values<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self(matrix) = self;
        let mut values = serializer.serialize_seq(Some(matrix.nrows() * matrix.ncols()))?;
        for j in 0..matrix.ncols() {
            matrix.col_as_slice(j).iter().try_for_each(|value| values.serialize_element(value))?;
        }
        values.end()
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
