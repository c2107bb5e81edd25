//! The factors of one tile, and what they have in the blocks.

use crate::errors::blocks::{BlockDiagonal, Blocks, Precision};
use crate::linalg::{entries_mut, product};
use crate::tall_matrix::TallMatrix;
use faer::{Mat, MatMut, MatRef};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// F_j: columns that are zero but for some block variables.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct LocalFactors {
    /// The block variables, ascending.
    pub variables: Vec<usize>,
    /// Their rows, `[variables, r]`.
    values: TallMatrix,
}

impl LocalFactors {
    /// Factors with these values, `[variables, r]`, rounded to a precision.
    pub fn new(variables: Vec<usize>, values: MatRef<'_, f64>, precision: Precision) -> Self {
        Self::filled(variables, values.ncols(), precision, |j, column| {
            column.iter_mut().zip(values.col(j).iter()).for_each(|(to, from)| *to = *from);
        })
    }

    /// Factors whose columns of zeros `fill` changes, given the number of each.
    pub fn filled(
        variables: Vec<usize>,
        columns: usize,
        precision: Precision,
        mut fill: impl FnMut(usize, &mut [f64]),
    ) -> Self {
        let mut values = TallMatrix::zeros(variables.len(), columns, precision);
        (0..columns).for_each(|j| values.edit_column(j, |column| fill(j, column)));
        Self { variables, values }
    }

    /// Number of factors r.
    pub fn columns(&self) -> usize {
        self.values.columns()
    }

    pub fn precision(&self) -> Precision {
        self.values.precision()
    }

    /// The rows of one factor.
    pub fn column(&self, j: usize) -> Cow<'_, [f64]> {
        self.values.column(j)
    }

    /// Applies `work` to the rows of one factor.
    pub fn edit_column(&mut self, j: usize, work: impl FnOnce(&mut [f64])) {
        self.values.edit_column(j, work);
    }

    /// All rows, `[variables, r]`: as they are stored, or their copy in the scratch.
    pub fn rows<'a>(&'a self, scratch: &'a mut Vec<f64>) -> MatRef<'a, f64> {
        self.values.part(0, self.variables.len(), 0, scratch)
    }

    /// All rows, `[variables, r]`.
    pub fn to_matrix(&self) -> Mat<f64> {
        self.rows(&mut Vec::new()).to_owned()
    }

    /// Whether each variable has a row of its values, whatever was stored.
    pub fn is_whole(&self) -> bool {
        self.values.has_shape(self.variables.len(), self.columns())
    }

    /// Where a variable's row is.
    pub fn row(&self, variable: usize) -> Option<usize> {
        self.variables.binary_search(&variable).ok()
    }

    /// The entry of a row in a column.
    pub fn value(&self, row: usize, column: usize) -> f64 {
        self.values.value(row, column)
    }

    /// Adds F_j x to a vector of all block variables.
    pub fn multiply_add(&self, x: &[f64], of_blocks: &mut [f64]) {
        for (j, x) in x.iter().enumerate().filter(|(_, x)| **x != 0.0) {
            self.variables.iter().zip(&*self.column(j)).for_each(|(&variable, value)| of_blocks[variable] += x * value);
        }
    }

    /// F_jᵀ h of a vector of all block variables.
    pub fn transposed_product(&self, of_blocks: &[f64]) -> Vec<f64> {
        let of =
            |j| self.variables.iter().zip(&*self.column(j)).map(|(&variable, value)| value * of_blocks[variable]).sum();
        (0..self.columns()).map(of).collect()
    }

    /// Adds the sum of the squares of each row to a vector of all block variables.
    pub fn add_squared_rows(&self, of_blocks: &mut [f64]) {
        self.add_squared_rows_from(0, of_blocks);
    }

    /// Adds the sum of the squares of each row from the column `first` on to a vector of all block variables.
    pub fn add_squared_rows_from(&self, first: usize, of_blocks: &mut [f64]) {
        for j in first..self.columns() {
            let rows = self.column(j);
            self.variables.iter().zip(&*rows).for_each(|(&variable, value)| of_blocks[variable] += value * value);
        }
    }

    /// Subtracts F_j T from the rows of a matrix that has one for each block variable, `[at least all of them, columns of T]`.
    pub fn subtract_products(&self, t: MatRef<'_, f64>, from: &mut Mat<f64>) {
        let products = product(self.rows(&mut Vec::new()), t);
        for j in 0..t.ncols() {
            let (values, changes) = (from.col_as_slice_mut(j), products.col_as_slice(j));
            self.variables.iter().zip(changes).for_each(|(&variable, change)| values[variable] -= change);
        }
    }

    /// Multiplies the row of a variable, if it is among these.
    pub fn scale_row(&mut self, variable: usize, factor: f64) {
        if let Some(row) = self.row(variable) {
            (0..self.columns()).for_each(|j| self.values.set(row, j, factor * self.values.value(row, j)));
        }
    }

    /// Multiplies each row by what belongs to its variable among all block variables.
    pub fn scale_rows(&mut self, of_blocks: &[f64]) {
        let Self { variables, values } = self;
        for j in 0..values.columns() {
            values.edit_column(j, |column| {
                column.iter_mut().zip(&*variables).for_each(|(value, &variable)| *value *= of_blocks[variable]);
            });
        }
    }

    /// Subtracts changes, `[places, r]`, from the rows at these places.
    pub fn subtract_rows(&mut self, places: &[usize], changes: MatRef<'_, f64>) {
        for (j, mut column) in self.values.columns_mut().into_iter().enumerate() {
            places.iter().zip(changes.col(j).iter()).for_each(|(&place, &change)| column.subtract(place, change));
        }
    }

    /// Adds the rows, times `t` if there is one, to those of a matrix of some ascending variables. Rows of other variables
    /// are left out.
    pub fn add_to(&self, variables: &[usize], mut values: MatMut<'_, f64>, t: Option<MatRef<'_, f64>>) {
        let rows: Vec<(usize, usize)> =
            places(&self.variables, variables).enumerate().filter_map(|(from, to)| Some((from, to?))).collect();
        let mut add = |j: usize, column: &[f64]| {
            let to = entries_mut(values.as_mut().col_mut(j));
            rows.iter().for_each(|&(from, place)| to[place] += column[from]);
        };
        match t {
            Some(t) => {
                let multiplied = product(self.rows(&mut Vec::new()), t);
                (0..multiplied.ncols()).for_each(|j| add(j, multiplied.col_as_slice(j)));
            }
            None => (0..self.columns()).for_each(|j| add(j, &self.column(j))),
        }
    }

    /// The same factors on more variables, which include these.
    pub fn extended(&self, variables: &[usize], precision: Precision) -> Self {
        let rows: Vec<usize> =
            places(&self.variables, variables).map(|place| place.expect("it is among these")).collect();
        Self::filled(variables.to_vec(), self.columns(), precision, |j, column| {
            rows.iter().zip(&*self.column(j)).for_each(|(&row, value)| column[row] = *value);
        })
    }

    /// The same factors, and after them the `further` ones, times a factor, with the same variables.
    pub fn joined(&self, further: &Self, factor: f64) -> Self {
        let (r, columns) = (self.columns(), self.columns() + further.columns());
        Self::filled(self.variables.clone(), columns, self.precision(), |j, column| {
            if j < r {
                column.copy_from_slice(&self.column(j));
            } else {
                column.iter_mut().zip(&*further.column(j - r)).for_each(|(to, from)| *to = factor * from);
            }
        })
    }

    /// The rows of the variables that a support holds, which are among these, and the rows of the others.
    pub fn split(self, support: &[usize]) -> (Self, Self) {
        if self.variables == support {
            let nothing = Self::filled(Vec::new(), self.columns(), self.precision(), |_, _| ());
            return (self, nothing);
        }
        Self::parts(&self.variables, support, self.columns(), self.precision(), |j| self.column(j))
    }

    /// Factors with these columns on the variables: their rows in a support, which is among these, and the others.
    pub fn parts<'a>(
        variables: &[usize],
        support: &[usize],
        columns: usize,
        precision: Precision,
        values: impl Fn(usize) -> Cow<'a, [f64]>,
    ) -> (Self, Self) {
        let mut rows = [Vec::new(), Vec::new()];
        for (row, place) in places(variables, support).enumerate() {
            rows[usize::from(place.is_none())].push(row);
        }
        let [inside, outside] = rows.map(|rows| {
            let variables = rows.iter().map(|&row| variables[row]).collect();
            Self::filled(variables, columns, precision, |j, column| {
                let from = values(j);
                column.iter_mut().zip(&rows).for_each(|(value, &row)| *value = from[row]);
            })
        });
        (inside, outside)
    }

    /// The block diagonal of F_j F_jᵀ: number of the block, positions in it, and the matrix of these.
    fn in_blocks(&self, blocks: &Blocks) -> Vec<(usize, Vec<usize>, Mat<f64>)> {
        let mut rows: Vec<usize> = (0..self.variables.len()).collect();
        // The rows of one variable of the model are a run that a stable sort finds.
        rows.sort_by_key(|&row| blocks.position(self.variables[row]));
        let transposed = self.rows(&mut Vec::new()).transpose().to_owned();
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
