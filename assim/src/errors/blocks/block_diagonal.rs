//! A block-diagonal matrix: one small square matrix for each block, all in one array.

use super::factors::Factors;
use super::grid_blocks::Blocks;
use crate::covariance::{self, Covariance};
use crate::error::Error;
use crate::linalg::add_product;
use crate::memory::{read, require, write};
use crate::tall_matrix::stored;
use faer::{Mat, MatMut, MatRef};
use isobar_model::{Bands, Stored};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::ops::Range;

/// Values of the matrices that one thread works on at a time.
const VALUES: usize = 8192;

/// The largest block for which a loop over its entries is faster than a matrix product.
const SMALL: usize = 12;

/// blkdiag(C_1 … C_K).
///
/// Where several ranks compute a run, each has the blocks in its rows. What an analysis does to the blocks that it sees, wherever they
/// are, every rank does for itself, with copies that the others have lent it: see [`BlockDiagonal::lend`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::errors) struct BlockDiagonal {
    values: Vec<f64>,
    /// Which blocks these are.
    own: Range<usize>,
    /// Copies of others.
    #[serde(skip)]
    lent: BTreeMap<usize, Vec<f64>>,
}

impl BlockDiagonal {
    pub fn zeros(blocks: &Blocks) -> Self {
        Self::zeros_of(blocks, 0..blocks.count())
    }

    fn zeros_of(blocks: &Blocks, own: Range<usize>) -> Self {
        Self { values: vec![0.0; blocks.matrices_of(&own).len()], own, lent: BTreeMap::new() }
    }

    /// The blocks of a covariance of states, those in this rank's rows; zero for local parameters.
    pub fn of(operator: &dyn Covariance, blocks: &Blocks, bands: &Bands) -> Self {
        let mut result = Self::zeros_of(blocks, blocks.in_rows(bands, &bands.own()));
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

    /// Which blocks this rank has.
    pub fn own(&self) -> &Range<usize> {
        &self.own
    }

    /// Whether it has the same blocks as another, whatever was stored.
    pub fn is_like(&self, other: &BlockDiagonal) -> bool {
        self.own == other.own && self.values.len() == other.values.len()
    }

    /// A block that this rank has, or a copy that another has lent it.
    pub fn block(&self, blocks: &Blocks, block: usize) -> MatRef<'_, f64> {
        let (size, place) = (blocks.size(block), self.place(blocks, block));
        MatRef::from_column_major_slice(place.map_or_else(|| &self.lent[&block][..], |at| &self.values[at]), size, size)
    }

    /// As [`BlockDiagonal::block`].
    pub fn block_mut(&mut self, blocks: &Blocks, block: usize) -> MatMut<'_, f64> {
        let (size, place) = (blocks.size(block), self.place(blocks, block));
        let matrix = match place {
            Some(place) => &mut self.values[place],
            None => self.lent.get_mut(&block).expect("a block of another rank is used once it is lent"),
        };
        MatMut::from_column_major_slice_mut(matrix, size, size)
    }

    /// Where a block of this rank lies in the values.
    fn place(&self, blocks: &Blocks, block: usize) -> Option<Range<usize>> {
        let (first, Range { start, end }) = (blocks.matrices_of(&self.own).start, blocks.matrix(block));
        self.own.contains(&block).then(|| start - first..end - first)
    }

    /// Copies some blocks, ascending, from the ranks that have them to all. Collective.
    pub fn lend(&mut self, blocks: &Blocks, wanted: &[usize], bands: &Bands) {
        self.lent.clear();
        if bands.is_whole() {
            return;
        }
        let own = wanted.iter().filter_map(|&block| self.place(blocks, block));
        let own: Vec<f64> = own.flat_map(|place| &self.values[place]).copied().collect();
        let all = bands.communicator().gather_all(&own).concat();
        let mut left = &all[..];
        for &block in wanted {
            let matrix = left.split_off(..blocks.matrix(block).len()).expect("each rank sends those that it has");
            if !self.own.contains(&block) {
                self.lent.insert(block, matrix.to_vec());
            }
        }
    }

    /// Gives up the copies of other ranks' blocks.
    pub fn give_back(&mut self) {
        self.lent.clear();
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
        let mut chunks = Vec::with_capacity(self.own.len().div_ceil(count));
        let mut rest = self.values.as_mut_slice();
        for first in self.own.clone().step_by(count) {
            let last = (first + count).min(self.own.end) - 1;
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

    /// C_k += sign Φ_k Φ_kᵀ, the block diagonal of what the factors hold.
    pub fn add_factors(&mut self, blocks: &Blocks, sign: f64, factors: &Factors) {
        let (m, own_rows) = (factors.state.rows(), factors.state.own_rows());
        // Where each variable is among the rows of this rank; nowhere in particular if it is elsewhere, as is its block.
        let places: Option<Vec<u32>> = factors.state.bands().map(|_| {
            let mut places = vec![0; m];
            let own = factors.state.own_ranges().into_iter().flatten();
            own.enumerate().for_each(|(place, variable)| places[variable] = place as u32);
            places
        });
        self.for_each_chunk(blocks, |first, matrices| {
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

    /// Applies `work` to the block of a variable and the variable's position in it, if this rank has the block.
    pub fn edit(&mut self, blocks: &Blocks, variable: usize, work: impl FnOnce(MatMut<'_, f64>, usize)) {
        let (block, position) = blocks.place(variable);
        if self.own.contains(&block) {
            work(self.block_mut(blocks, block), position);
        }
    }

    /// Sets the row and column of a variable to zero, if this rank has its block.
    pub fn clear(&mut self, blocks: &Blocks, variable: usize) {
        self.edit(blocks, variable, clear);
    }

    /// Multiplies the row and the column of a variable, if this rank has its block.
    pub fn scale(&mut self, blocks: &Blocks, variable: usize, factor: f64) {
        self.edit(blocks, variable, |matrix, position| scale_row_and_column(matrix, position, factor));
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

    /// Adds the diagonals of the blocks that this rank has to the variances of the block variables.
    pub fn add_variances(&self, blocks: &Blocks, variances: &mut [f64]) {
        let first = blocks.matrices_of(&self.own).start;
        variances.par_iter_mut().enumerate().for_each(|(variable, variance)| {
            let (block, position) = blocks.place(variable);
            if self.own.contains(&block) {
                *variance += self.values[blocks.matrix(block).start - first + position * (blocks.size(block) + 1)];
            }
        });
    }

    /// Writes the blocks of all ranks; what another rank than 0 writes lacks them. Collective.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn save(&self, bands: &Bands, to: &mut dyn Write) -> Result<(), Error> {
        if bands.is_whole() {
            return write(&self.values, to);
        }
        write(&bands.communicator().gather_to_first(self.values.clone()).concat(), to)
    }

    /// This rank's blocks of those that [`BlockDiagonal::save`] has written.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn read_like(&self, blocks: &Blocks, from: &mut dyn Read) -> Result<Self, Error> {
        let mut values: Vec<f64> = read(from)?;
        require(values.len() == blocks.matrices_len(), "the covariance of the blocks")?;
        values.truncate(blocks.matrices_of(&self.own).end);
        values.drain(..blocks.matrices_of(&self.own).start);
        Ok(Self { values, own: self.own.clone(), lent: BTreeMap::new() })
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
