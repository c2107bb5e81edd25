//! What a method carries from cycle to cycle, written to a checkpoint and read from it.
//!
//! It is written part by part, so that what is large need never be there a second time as bytes.

use crate::error::Error;
use faer::Mat;
use serde::de::DeserializeOwned;
use serde::ser::{SerializeSeq, SerializeStruct};
use serde::{Deserialize, Serialize, Serializer};
use std::fmt::Display;
use std::io::{Read, Write};
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

/// Writes a part of a memory, with the number of its bytes before it.
///
/// # Errors
/// [`Error::Memory`].
pub(crate) fn write<S: Serialize>(part: &S, to: &mut dyn Write) -> Result<(), Error> {
    let bytes = postcard::to_stdvec(part).map_err(unusable)?;
    to.write_all(&(bytes.len() as u64).to_le_bytes()).and_then(|()| to.write_all(&bytes)).map_err(unusable)
}

/// Reads a part of a memory that [`write()`] has written.
///
/// # Errors
/// [`Error::Memory`].
pub(crate) fn read<S: DeserializeOwned>(from: &mut dyn Read) -> Result<S, Error> {
    let mut length = [0; 8];
    from.read_exact(&mut length).map_err(unusable)?;
    let (length, mut bytes) = (u64::from_le_bytes(length), Vec::new());
    from.take(length).read_to_end(&mut bytes).map_err(unusable)?;
    if bytes.len() as u64 != length {
        return Err(Error::Memory { reason: "it is cut off".into() });
    }
    match postcard::take_from_bytes(&bytes) {
        Ok((part, [])) => Ok(part),
        Ok(_) => Err(Error::Memory { reason: "a part of it is too long".into() }),
        Err(error) => Err(unusable(error)),
    }
}

fn unusable(error: impl Display) -> Error {
    Error::Memory { reason: error.to_string() }
}
