//! A matrix with few entries in each row.

use serde::{Deserialize, Serialize};

/// A sparse matrix, row by row; the row length is that of the space it acts on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SparseRows {
    offsets: Vec<usize>,
    entries: Vec<(usize, f64)>,
}

impl Default for SparseRows {
    fn default() -> Self {
        Self::new()
    }
}

impl SparseRows {
    /// A matrix without rows.
    pub fn new() -> Self {
        Self { offsets: vec![0], entries: Vec::new() }
    }

    /// Appends a row of (column, value) entries.
    pub fn push_row(&mut self, entries: impl IntoIterator<Item = (usize, f64)>) {
        self.entries.extend(entries);
        self.offsets.push(self.entries.len());
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether it is a matrix of this size; one that has been read from a file may not be.
    pub fn has_shape(&self, rows: usize, columns: usize) -> bool {
        self.offsets.len() == rows + 1
            && self.offsets[0] == 0
            && self.offsets.is_sorted()
            && self.offsets[rows] == self.entries.len()
            && self.entries.iter().all(|entry| entry.0 < columns)
    }

    /// The (column, value) entries of a row.
    pub fn row(&self, row: usize) -> &[(usize, f64)] {
        &self.entries[self.offsets[row]..self.offsets[row + 1]]
    }

    /// Row `row` times the vector `x`.
    pub fn row_dot(&self, row: usize, x: &[f64]) -> f64 {
        self.row(row).iter().map(|&(column, value)| value * x[column]).sum()
    }

    /// y += M x.
    pub fn multiply_add(&self, x: &[f64], y: &mut [f64]) {
        for (row, value) in y.iter_mut().enumerate() {
            *value += self.row_dot(row, x);
        }
    }

    /// x += Mᵀ y.
    pub fn transpose_multiply_add(&self, y: &[f64], x: &mut [f64]) {
        for (row, &value) in y.iter().enumerate() {
            for &(column, weight) in self.row(row) {
                x[column] += weight * value;
            }
        }
    }
}
