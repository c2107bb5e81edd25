//! The factors of one tile, and what they have in the blocks.

use crate::errors::blocks::{BlockDiagonal, Blocks};
use crate::linalg::product;
use crate::memory::Matrix;
use faer::{Mat, MatRef};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// F_j: columns that are zero but for some block variables.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct LocalFactors {
    /// The block variables, ascending.
    pub variables: Vec<usize>,
    /// Their rows, `[variables, r]`.
    pub values: Matrix,
}

impl LocalFactors {
    pub fn new(variables: Vec<usize>, values: Mat<f64>) -> Self {
        Self { variables, values: Matrix(values) }
    }

    /// Number of factors r.
    pub fn columns(&self) -> usize {
        self.values.ncols()
    }

    /// Where a variable's row is.
    pub fn row(&self, variable: usize) -> Option<usize> {
        self.variables.binary_search(&variable).ok()
    }

    /// Adds the rows, times `t` if there is one, to those of a matrix whose ascending variables include these.
    pub fn add_to(&self, variables: &[usize], mut values: faer::MatMut<'_, f64>, t: Option<MatRef<'_, f64>>) {
        let multiplied = t.map(|t| product(self.values.as_ref(), t));
        let own = multiplied.as_ref().unwrap_or(&self.values.0);
        let rows: Vec<usize> = places(&self.variables, variables).map(|it| it.expect("it is among these")).collect();
        for column in 0..own.ncols() {
            let (from, to) = (own.col_as_slice(column), values.as_mut().col_mut(column));
            let to = to.try_as_col_major_mut().expect("columns are contiguous").as_slice_mut();
            rows.iter().zip(from).for_each(|(&row, value)| to[row] += value);
        }
    }

    /// The same factors on more variables, which include these.
    pub fn extended(&self, variables: &[usize]) -> Self {
        let mut values = Mat::zeros(variables.len(), self.columns());
        self.add_to(variables, values.as_mut(), None);
        Self::new(variables.to_vec(), values)
    }

    /// The rows of the variables that a support holds, which are among these, and those of the others.
    pub fn split(self, support: &[usize]) -> (Self, Self) {
        let mut rows = [Vec::new(), Vec::new()];
        for (row, place) in places(&self.variables, support).enumerate() {
            rows[usize::from(place.is_none())].push(row);
        }
        let [inside, outside] = rows.map(|rows| {
            let mut values = Mat::zeros(rows.len(), self.columns());
            for j in 0..self.columns() {
                let from = self.values.col_as_slice(j);
                values.col_as_slice_mut(j).iter_mut().zip(&rows).for_each(|(value, &row)| *value = from[row]);
            }
            Self::new(rows.iter().map(|&row| self.variables[row]).collect(), values)
        });
        (inside, outside)
    }

    /// The block diagonal of F_j F_jᵀ: number of the block, positions in it, and the matrix of these.
    fn in_blocks(&self, blocks: &Blocks) -> Vec<(usize, Vec<usize>, Mat<f64>)> {
        let mut rows: Vec<usize> = (0..self.variables.len()).collect();
        // The rows of one variable of the model are a run that a stable sort finds.
        rows.sort_by_key(|&row| blocks.position(self.variables[row]));
        let transposed = self.values.transpose().to_owned();
        let block_of = |row: usize| blocks.place(self.variables[row]).0;
        rows.chunk_by(|&a, &b| block_of(a) == block_of(b))
            .map(|rows| {
                let positions = rows.iter().map(|&row| blocks.place(self.variables[row]).1).collect();
                let dot = |i: usize, j: usize| {
                    let (a, b) = (transposed.col_as_slice(rows[i]), transposed.col_as_slice(rows[j]));
                    isobar_model::vector::dot(a, b)
                };
                (block_of(rows[0]), positions, Mat::from_fn(rows.len(), rows.len(), dot))
            })
            .collect()
    }
}

/// Parts whose blocks are held at a time.
const PARTS: usize = 64;

/// C_k += sign Σ_j (F_j F_jᵀ)_kk.
pub(super) fn add_to_blocks(own: &mut BlockDiagonal, blocks: &Blocks, sign: f64, parts: &[LocalFactors]) {
    for parts in parts.chunks(PARTS) {
        let all: Vec<_> = parts.par_iter().map(|part| part.in_blocks(blocks)).collect();
        for (block, positions, matrix) in all.into_iter().flatten() {
            let mut own = own.block_mut(blocks, block);
            for (j, &column) in positions.iter().enumerate() {
                for (i, &row) in positions.iter().enumerate() {
                    own[(row, column)] += sign * matrix[(i, j)];
                }
            }
        }
    }
}

/// Where the entries of an ascending list are in another, which has not all of them.
pub(super) fn places<'a>(of: &'a [usize], within: &'a [usize]) -> impl Iterator<Item = Option<usize>> + 'a {
    let mut place = 0;
    of.iter().map(move |variable| {
        while within.get(place).is_some_and(|other| other < variable) {
            place += 1;
        }
        (within.get(place) == Some(variable)).then_some(place)
    })
}

/// The variables of several ascending lists, ascending.
pub(super) fn union<'a>(lists: impl IntoIterator<Item = &'a [usize]>) -> Vec<usize> {
    let mut all: Vec<usize> = lists.into_iter().flatten().copied().collect();
    // Merges the lists: they are runs that a stable sort finds.
    all.sort();
    all.dedup();
    all
}

/// The rows of a matrix, each divided by what belongs to its variable.
pub(super) fn divided(values: &Mat<f64>, variables: &[usize], by: impl Fn(usize) -> f64) -> Mat<f64> {
    let factors: Vec<f64> = variables.iter().map(|&variable| by(variable).recip()).collect();
    multiplied(values, &factors)
}

/// The rows of a matrix, each multiplied by its factor.
pub(super) fn multiplied(values: &Mat<f64>, factors: &[f64]) -> Mat<f64> {
    let mut result = Mat::zeros(values.nrows(), values.ncols());
    for j in 0..values.ncols() {
        let pairs = values.col_as_slice(j).iter().zip(factors);
        result.col_as_slice_mut(j).iter_mut().zip(pairs).for_each(|(result, (value, factor))| *result = value * factor);
    }
    result
}
