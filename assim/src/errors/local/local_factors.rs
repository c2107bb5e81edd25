//! The factors of one tile, and what they have in the blocks.

use crate::errors::blocks::{BlockDiagonal, Blocks, Precision};
use crate::linalg::{entries, product};
use crate::tall_matrix::TallMatrix;
use faer::{Mat, MatRef};
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

    /// Adds the rows of F_j T to those of a matrix of some ascending variables. Rows of other variables are left out.
    pub fn add_products(&self, t: MatRef<'_, f64>, variables: &[usize], values: &mut Mat<f64>) {
        let rows: Vec<(usize, usize)> =
            places(&self.variables, variables).enumerate().filter_map(|(from, to)| Some((from, to?))).collect();
        let products = product(self.rows(&mut Vec::new()), t);
        for j in 0..t.ncols() {
            let (to, from) = (values.col_as_slice_mut(j), products.col_as_slice(j));
            rows.iter().for_each(|&(row, place)| to[place] += from[row]);
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

    /// The same factors, and after them columns with these values of some variables, on the variables of both.
    pub fn with_columns(&self, further: &[Vec<(usize, f64)>]) -> Self {
        let mut others: Vec<usize> = further.iter().flatten().map(|entry| entry.0).collect();
        others.sort_unstable();
        let own = self.extended(&union([self.variables.as_slice(), &others]), self.precision());
        let r = own.columns();
        Self::filled(own.variables.clone(), r + further.len(), own.precision(), |j, column| {
            if j < r {
                column.copy_from_slice(&own.column(j));
            } else {
                let row = |variable| own.row(variable).expect("it is among these");
                further[j - r].iter().for_each(|&(variable, value)| column[row(variable)] = value);
            }
        })
    }

    /// The first columns, and the others.
    pub fn split(&self, first: usize) -> (Self, Self) {
        let part = |columns: std::ops::Range<usize>| {
            Self::filled(self.variables.clone(), columns.len(), self.precision(), |j, column| {
                column.copy_from_slice(&self.column(columns.start + j));
            })
        };
        (part(0..first), part(first..self.columns()))
    }

    /// The block diagonal of F_j F_jᵀ: where its entries are among those of all blocks, and what they are.
    fn in_blocks(&self, blocks: &Blocks) -> Vec<(usize, f64)> {
        let mut rows: Vec<usize> = (0..self.variables.len()).collect();
        // The rows of one variable of the model are a run that a stable sort finds.
        rows.sort_by_key(|&row| blocks.position(self.variables[row]));
        let places: Vec<(usize, usize)> = rows.iter().map(|&row| blocks.place(self.variables[row])).collect();
        let r = self.columns();
        let mut values = vec![0.0; rows.len() * r];
        for j in 0..r {
            let column = self.column(j);
            values.chunks_exact_mut(r).zip(&rows).for_each(|(values, &row)| values[j] = column[row]);
        }
        let mut entries = Vec::with_capacity(4 * rows.len());
        let mut first = 0;
        for places in places.chunk_by(|a, b| a.0 == b.0) {
            let values = &values[first * r..][..places.len() * r];
            let (start, size) = (blocks.matrix(places[0].0).start, blocks.size(places[0].0));
            for (j, &(_, column)) in places.iter().enumerate() {
                for (i, &(_, row)) in places.iter().enumerate().skip(j) {
                    let value = inner(&values[i * r..][..r], &values[j * r..][..r]);
                    entries.push((start + size * column + row, value));
                    if i > j {
                        entries.push((start + size * row + column, value));
                    }
                }
            }
            first += places.len();
        }
        entries
    }
}

/// Σ aᵢ bᵢ, in sums of its own for each of four neighbours.
fn inner(a: &[f64], b: &[f64]) -> f64 {
    let ((fours_a, rest_a), (fours_b, rest_b)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (a, b) in fours_a.iter().zip(fours_b) {
        (0..4).for_each(|i| sums[i] += a[i] * b[i]);
    }
    let rest: f64 = rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Parts whose blocks are held at a time.
const PARTS: usize = 64;

/// C_k += sign Σ_j (F_j F_jᵀ)_kk.
pub(super) fn add_to_blocks(own: &mut BlockDiagonal, blocks: &Blocks, sign: f64, parts: &[LocalFactors]) {
    for parts in parts.chunks(PARTS) {
        let all: Vec<_> = parts.par_iter().map(|part| part.in_blocks(blocks)).collect();
        let own = own.values_mut();
        all.into_iter().flatten().for_each(|(entry, value)| own[entry] += sign * value);
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

/// Rows that follow each other in two matrices.
pub(super) struct Run {
    pub from: usize,
    pub to: usize,
    pub len: usize,
}

/// The runs of the places of the rows 0, 1 …: the rows of a support are a few for each row of cells, and copied as such.
pub(super) fn runs(places: impl IntoIterator<Item = usize>) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (from, to) in places.into_iter().enumerate() {
        match runs.last_mut() {
            Some(run) if run.to + run.len == to => run.len += 1,
            _ => runs.push(Run { from, to, len: 1 }),
        }
    }
    runs
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
pub(super) fn divided(values: MatRef<'_, f64>, variables: &[usize], by: impl Fn(usize) -> f64) -> Mat<f64> {
    let factors: Vec<f64> = variables.iter().map(|&variable| by(variable).recip()).collect();
    let mut result = Mat::zeros(values.nrows(), values.ncols());
    for (j, column) in values.col_iter().enumerate() {
        let pairs = entries(column).iter().zip(&factors);
        result.col_as_slice_mut(j).iter_mut().zip(pairs).for_each(|(result, (value, factor))| *result = value * factor);
    }
    result
}
