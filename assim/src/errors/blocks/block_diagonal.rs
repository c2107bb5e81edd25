//! A block-diagonal matrix: one small square matrix for each block, all in one array.

use super::factors::Factors;
use super::grid_blocks::Blocks;
use crate::covariance::{self, Covariance};
use crate::linalg::add_product;
use crate::tall_matrix::{own_row, stored};
use faer::{Mat, MatMut, MatRef};
use isobar_model::{Bands, Stored};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Values of the matrices that one thread works on at a time.
const VALUES: usize = 8192;

/// The largest block for which a loop over its entries is faster than a matrix product.
const SMALL: usize = 12;

/// blkdiag(C_1 … C_K).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::errors) struct BlockDiagonal {
    values: Vec<f64>,
}

impl BlockDiagonal {
    pub fn zeros(blocks: &Blocks) -> Self {
        Self { values: vec![0.0; blocks.matrices_len()] }
    }

    /// The blocks of a covariance of states; zero for local parameters.
    pub fn of(operator: &dyn Covariance, blocks: &Blocks) -> Self {
        let mut result = Self::zeros(blocks);
        result.for_each_block(blocks, |block, mut matrix| {
            let members = blocks.members(block);
            let on_grid = &members[..members.partition_point(|&variable| variable < operator.len())];
            if on_grid.len() > SMALL {
                let own = covariance::block(operator, on_grid);
                return matrix.get_mut(..on_grid.len(), ..on_grid.len()).copy_from(own);
            }
            for (j, &column) in on_grid.iter().enumerate() {
                for (i, &row) in on_grid.iter().enumerate().skip(j) {
                    let value = operator.covariance(row, column);
                    (matrix[(i, j)], matrix[(j, i)]) = (value, value);
                }
            }
        });
        result
    }

    /// All matrices, one after another.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// All matrices, one after another.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    pub fn block(&self, blocks: &Blocks, block: usize) -> MatRef<'_, f64> {
        let size = blocks.size(block);
        MatRef::from_column_major_slice(&self.values[blocks.matrix(block)], size, size)
    }

    pub fn block_mut(&mut self, blocks: &Blocks, block: usize) -> MatMut<'_, f64> {
        let size = blocks.size(block);
        MatMut::from_column_major_slice_mut(&mut self.values[blocks.matrix(block)], size, size)
    }

    /// Applies `work` to each block's number and matrix, in parallel.
    pub fn for_each_block(&mut self, blocks: &Blocks, work: impl Fn(usize, MatMut<'_, f64>) + Sync) {
        self.for_each_chunk(blocks, |first, matrices| {
            for_each_matrix(blocks, first, matrices, |block, own| {
                let size = blocks.size(block);
                work(block, MatMut::from_column_major_slice_mut(own, size, size));
            });
        });
    }

    /// Applies `work` to the number of the first block and the matrices of each chunk of blocks, in parallel.
    fn for_each_chunk(&mut self, blocks: &Blocks, work: impl Fn(usize, &mut [f64]) + Sync) {
        let count = (VALUES * blocks.count() / blocks.matrices_len().max(1)).max(1);
        let mut chunks = Vec::with_capacity(blocks.count().div_ceil(count));
        let mut rest = self.values.as_mut_slice();
        for first in (0..blocks.count()).step_by(count) {
            let last = (first + count).min(blocks.count()) - 1;
            let (own, others) = rest.split_at_mut(blocks.matrix(last).end - blocks.matrix(first).start);
            chunks.push((first, own));
            rest = others;
        }
        chunks.into_par_iter().for_each(|(first, matrices)| work(first, matrices));
    }

    /// C_k += M_k.
    pub fn add(&mut self, other: &BlockDiagonal) {
        self.values.par_iter_mut().zip(&other.values).for_each(|(own, other)| *own += other);
    }

    /// Has the blocks of each rank's rows as that rank has them, on all.
    pub fn share(&mut self, blocks: &Blocks, bands: &Bands) {
        if bands.is_whole() {
            return;
        }
        // They lie one after another, as the rows do.
        let Range { start, end } = blocks.in_rows(bands, &bands.own());
        let own = &self.values[blocks.matrix(start).start..blocks.matrix(end - 1).end];
        self.values = bands.communicator().gather_all(own).concat();
    }

    /// C_k += sign Φ_k Φ_kᵀ, the block diagonal of what the factors hold. Where several ranks have the rows of Φ, only the blocks in
    /// this one's rows are right afterwards: see [`BlockDiagonal::share`].
    pub fn add_factors(&mut self, blocks: &Blocks, sign: f64, factors: &Factors) {
        let (m, own_rows, bands) = (factors.state.rows(), factors.state.own_rows(), factors.state.bands());
        let own_blocks = bands.map_or(0..blocks.count(), |bands| blocks.in_rows(bands, &bands.own()));
        // Where each variable is among the rows of this rank; nowhere in particular if it is elsewhere, as is its block.
        let place = |variable| own_row(bands, variable).unwrap_or(0) as u32;
        let places: Option<Vec<u32>> = bands.map(|_| (0..m).into_par_iter().map(place).collect());
        self.for_each_chunk(blocks, |first, matrices| {
            if first >= own_blocks.end || first + matrices.len() <= own_blocks.start {
                return;
            }
            for_each_matrix(blocks, first, matrices, |block, own| {
                let (members, size) = (blocks.members(block), blocks.size(block));
                if size > SMALL {
                    let rows = Mat::from_fn(size, factors.columns(), |i, j| factors.own_value(members[i], j));
                    let own = MatMut::from_column_major_slice_mut(own, size, size);
                    add_product(own, sign, rows.as_ref(), rows.transpose());
                }
            });
            // Factor by factor: a column of Φ is contiguous in memory, the rows of a block are not.
            for column in 0..factors.columns() {
                stored!(factors.state.values(), values => {
                    let of_state = &values[column * own_rows..][..own_rows];
                    let of_local = |variable: usize| factors.local.value(variable - m, column);
                    match &places {
                        None => add_squares(blocks, first, matrices, sign, |variable| match of_state.get(variable) {
                            Some(value) => value.widen(),
                            None => of_local(variable),
                        }),
                        Some(places) => add_squares(blocks, first, matrices, sign, |variable| match places.get(variable) {
                            Some(&place) => of_state[place as usize].widen(),
                            None => of_local(variable),
                        }),
                    }
                });
            }
        });
    }

    /// C_k += sign (A Aᵀ)_kk of columns A, `[block variables, n]`.
    pub fn add_columns(&mut self, blocks: &Blocks, sign: f64, columns: MatRef<'_, f64>) {
        self.for_each_block(blocks, |block, matrix| {
            let members = blocks.members(block);
            let rows = Mat::from_fn(members.len(), columns.ncols(), |i, j| columns[(members[i], j)]);
            add_product(matrix, sign, rows.as_ref(), rows.transpose());
        });
    }

    /// Sets the row and column of a variable to zero.
    pub fn clear(&mut self, blocks: &Blocks, variable: usize) {
        let (block, position) = blocks.place(variable);
        clear(self.block_mut(blocks, block), position);
    }

    /// Multiplies the row and the column of a variable.
    pub fn scale(&mut self, blocks: &Blocks, variable: usize, factor: f64) {
        let (block, position) = blocks.place(variable);
        scale_row_and_column(self.block_mut(blocks, block), position, factor);
    }

    /// Sets to zero the rows and columns of variables whose variance is at most `share` of what it was taken from: a difference
    /// that is nothing but rounding, which may be negative and would pile up from cycle to cycle.
    pub fn clear_rounding(&mut self, blocks: &Blocks, taken_from: &[f64], share: f64) {
        self.for_each_block(blocks, |block, mut matrix| {
            for (i, &variable) in blocks.members(block).iter().enumerate() {
                if matrix[(i, i)] <= share * taken_from[variable] {
                    clear(matrix.as_mut(), i);
                }
            }
        });
    }

    /// Adds the diagonals to the variances of the block variables.
    pub fn add_variances(&self, blocks: &Blocks, variances: &mut [f64]) {
        variances.par_iter_mut().enumerate().for_each(|(variable, variance)| {
            let (block, position) = blocks.place(variable);
            *variance += self.values[blocks.matrix(block).start + position * (blocks.size(block) + 1)];
        });
    }
}

/// Calls `work` with the number and the matrix of each block from `first` on.
fn for_each_matrix(blocks: &Blocks, first: usize, matrices: &mut [f64], mut work: impl FnMut(usize, &mut [f64])) {
    let (mut rest, mut block) = (matrices, first);
    while !rest.is_empty() {
        let size = blocks.size(block);
        let (own, others) = rest.split_at_mut(size * size);
        work(block, own);
        (rest, block) = (others, block + 1);
    }
}

/// C_k += sign f_k f_kᵀ of each small block from `first` on, for a factor f with these entries.
fn add_squares(blocks: &Blocks, first: usize, matrices: &mut [f64], sign: f64, entry: impl Fn(usize) -> f64) {
    for_each_matrix(blocks, first, matrices, |block, own| {
        let members = blocks.members(block);
        match members.len() {
            // The variables of a cell.
            1 => add_square::<1>(own, members, sign, &entry),
            2 => add_square::<2>(own, members, sign, &entry),
            3 => add_square::<3>(own, members, sign, &entry),
            4 => add_square::<4>(own, members, sign, &entry),
            size if size <= SMALL => {
                let mut values = [0.0; SMALL];
                let values = &mut values[..size];
                values.iter_mut().zip(members).for_each(|(value, &variable)| *value = entry(variable));
                for (own, right) in own.chunks_exact_mut(size).zip(&*values) {
                    own.iter_mut().zip(&*values).for_each(|(own, left)| *own += sign * (left * right));
                }
            }
            _ => {}
        }
    });
}

/// [`add_squares`] of one block whose size is known at compile time.
#[inline(always)]
fn add_square<const N: usize>(own: &mut [f64], members: &[usize], sign: f64, entry: impl Fn(usize) -> f64) {
    let (own, members) = (&mut own[..N * N], &members[..N]);
    let values: [f64; N] = std::array::from_fn(|i| entry(members[i]));
    for (j, right) in values.iter().enumerate() {
        values.iter().enumerate().for_each(|(i, left)| own[j * N + i] += sign * (left * right));
    }
}

/// Multiplies a row and the column of the same number.
pub(super) fn scale_row_and_column(mut matrix: MatMut<'_, f64>, number: usize, factor: f64) {
    for other in 0..matrix.nrows() {
        matrix[(number, other)] *= factor;
        matrix[(other, number)] *= factor;
    }
}

/// Sets a row and the column of the same number to zero.
fn clear(mut matrix: MatMut<'_, f64>, number: usize) {
    for other in 0..matrix.nrows() {
        (matrix[(number, other)], matrix[(other, number)]) = (0.0, 0.0);
    }
}
