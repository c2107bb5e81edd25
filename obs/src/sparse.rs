//! A matrix with few entries in each row.

use serde::{Deserialize, Serialize};

/// A sparse matrix, row by row; the row length is that of the space it acts on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SparseRows {
    offsets: Vec<usize>,
    entries: Vec<(usize, f64)>,
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
