//! The grid in bands of rows, one for each of the ranks that compute a run together, and a model that they integrate together.

mod exchange;
mod model;

pub use exchange::RowExchange;
pub use model::BandedModel;

use crate::communicator::{Alone, Communicator};
use crate::grid::Grid;
use std::borrow::Cow;
use std::fmt::{self, Debug, Formatter};
use std::ops::Range;
use std::sync::Arc;

/// Which rank has which rows of a grid: bands of as equal numbers of rows as can be, in the order of ranks.
#[derive(Clone)]
pub struct Bands {
    grid: Grid,
    communicator: Arc<dyn Communicator>,
}

impl Debug for Bands {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "rank {} of {}", self.communicator.rank(), self.communicator.ranks())
    }
}

impl Bands {
    /// The bands of all ranks of a communicator.
    ///
    /// # Panics
    /// If there are more ranks than rows.
    pub fn new(grid: &Grid, communicator: Arc<dyn Communicator>) -> Self {
        assert!(communicator.ranks() <= grid.ny, "a rank would have no row");
        Self { grid: grid.clone(), communicator }
    }

    /// The whole grid in one process.
    pub fn whole(grid: &Grid) -> Self {
        Self::new(grid, Arc::new(Alone))
    }

    /// Whether this process has the whole grid.
    pub fn is_whole(&self) -> bool {
        self.communicator.ranks() == 1
    }

    /// What the ranks exchange numbers by.
    pub fn communicator(&self) -> &dyn Communicator {
        &*self.communicator
    }

    /// The grid that is divided.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The rows of a rank.
    pub fn of_rank(&self, rank: usize) -> Range<usize> {
        let (ny, ranks) = (self.grid.ny, self.communicator.ranks());
        rank * ny / ranks..(rank + 1) * ny / ranks
    }

    /// The rows of this rank.
    pub fn own(&self) -> Range<usize> {
        self.of_rank(self.communicator.rank())
    }

    /// The cells of this rank, which lie one after another.
    pub fn own_cells(&self) -> Range<usize> {
        self.cells_of(self.communicator.rank())
    }

    /// The rank of a row.
    pub fn rank_of(&self, row: usize) -> usize {
        let (ny, ranks) = (self.grid.ny, self.communicator.ranks());
        // The last rank whose first row is not beyond it.
        ((row + 1) * ranks - 1) / ny
    }

    /// Where a value of fields `[field, y, x]` is in this rank's part, if it is there.
    pub fn own_index(&self, index: usize) -> Option<usize> {
        let (cells, own) = (self.grid.cells(), self.own_cells());
        let (field, cell) = (index / cells, index % cells);
        own.contains(&cell).then(|| field * own.len() + cell - own.start)
    }

    /// Where this rank's part of fields `[field, y, x]` is in the whole, a range of each field.
    pub fn own_ranges(&self, fields: usize) -> impl Iterator<Item = Range<usize>> {
        let (cells, Range { start, end }) = (self.grid.cells(), self.own_cells());
        (0..fields).map(move |field| field * cells + start..field * cells + end)
    }

    /// This rank's part of fields `[field, y, x]`.
    pub fn own_part(&self, whole: &[f64]) -> Vec<f64> {
        self.part_of(self.communicator.rank(), whole)
    }

    fn part_of(&self, rank: usize, whole: &[f64]) -> Vec<f64> {
        let mut part = Vec::with_capacity(whole.len() / self.grid.ny * self.of_rank(rank).len());
        self.append_part(rank, whole, &mut part);
        part
    }

    /// The cells of a rank, which lie one after another.
    fn cells_of(&self, rank: usize) -> Range<usize> {
        let Range { start, end } = self.of_rank(rank);
        start * self.grid.nx..end * self.grid.nx
    }

    fn append_part(&self, rank: usize, whole: &[f64], part: &mut Vec<f64>) {
        whole.chunks_exact(self.grid.cells()).for_each(|field| part.extend_from_slice(&field[self.cells_of(rank)]));
    }

    /// Puts the part of a rank where it is in the whole.
    fn place(&self, rank: usize, part: &[f64], whole: &mut [f64]) {
        let cells = self.cells_of(rank);
        for (field, part) in whole.chunks_exact_mut(self.grid.cells()).zip(part.chunks_exact(cells.len())) {
            field[cells.clone()].copy_from_slice(part);
        }
    }

    /// Whole fields on all ranks, from the part that each has. Collective.
    pub fn gather(&self, own: Vec<f64>) -> Vec<f64> {
        if self.is_whole() {
            return own;
        }
        self.join(own.len() / self.own_cells().len(), &self.communicator.gather_all(&own))
    }

    /// Whole fields on rank 0, from the part that each rank has; nothing on the others. Collective.
    pub fn gather_to_first(&self, own: Vec<f64>) -> Vec<f64> {
        if self.is_whole() {
            return own;
        }
        let fields = own.len() / self.own_cells().len();
        let parts = self.communicator.gather_to_first(own);
        if self.communicator.rank() == 0 { self.join(fields, &parts) } else { Vec::new() }
    }

    /// The whole fields of the parts of all ranks.
    fn join(&self, fields: usize, parts: &[Vec<f64>]) -> Vec<f64> {
        let mut whole = vec![0.0; fields * self.grid.cells()];
        parts.iter().enumerate().for_each(|(rank, part)| self.place(rank, part, &mut whole));
        whole
    }

    /// Which of a number of columns each rank makes, in order: those of this one.
    pub fn share(&self, columns: usize) -> Range<usize> {
        self.share_of(self.communicator.rank(), columns)
    }

    fn share_of(&self, rank: usize, columns: usize) -> Range<usize> {
        let ranks = self.communicator.ranks();
        rank * columns / ranks..(rank + 1) * columns / ranks
    }

    /// The whole columns of this rank's share, from the part of each column that each rank has: the inverse of [`Bands::deal`].
    /// Collective.
    pub fn collect(&self, parts: &[Cow<'_, [f64]>]) -> Vec<Vec<f64>> {
        if self.is_whole() {
            return parts.iter().map(|part| part.to_vec()).collect();
        }
        let ranks: Vec<usize> = (0..self.communicator.ranks()).collect();
        let to = |&rank: &usize| (rank, parts[self.share_of(rank, parts.len())].concat());
        let received = self.communicator.exchange(ranks.iter().map(to).collect(), &ranks);
        let fields = parts.first().map_or(0, |part| part.len() / self.own_cells().len());
        let mut columns = vec![vec![0.0; fields * self.grid.cells()]; self.share(parts.len()).len()];
        for (rank, values) in received.iter().enumerate() {
            let part_len = fields * self.of_rank(rank).len() * self.grid.nx;
            for (column, part) in columns.iter_mut().zip(values.chunks_exact(part_len.max(1))) {
                self.place(rank, part, column);
            }
        }
        columns
    }

    /// Columns `[field, y, x]` that each rank has made whole, `own` of them here, as parts of all columns: those of rank 0, then
    /// those of rank 1 …, `[field, own y, x]` each. Collective.
    pub fn deal(&self, own: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        if self.is_whole() {
            return own;
        }
        let ranks: Vec<usize> = (0..self.communicator.ranks()).collect();
        let to = |&rank: &usize| {
            let mut values =
                Vec::with_capacity(own.iter().map(Vec::len).sum::<usize>() / self.grid.ny * self.of_rank(rank).len());
            own.iter().for_each(|column| self.append_part(rank, column, &mut values));
            (rank, values)
        };
        let outgoing = ranks.iter().map(to).collect();
        let counts = self.communicator.gather_all(&[own.len() as f64]);
        let received = self.communicator.exchange(outgoing, &ranks);
        let of_rank = |(values, count): (Vec<f64>, Vec<f64>)| match values.len().checked_div(count[0] as usize) {
            Some(len) => values.chunks_exact(len).map(<[f64]>::to_vec).collect(),
            None => Vec::new(),
        };
        received.into_iter().zip(counts).flat_map(of_rank).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Boundary;
    use crate::testing::on_ranks;

    fn grid() -> Grid {
        Grid { nx: 3, ny: 11, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic }
    }

    #[test]
    fn parts_of_all_ranks_are_the_whole() {
        let whole: Vec<f64> = (0..2 * 33).map(f64::from).collect();
        let columns: Vec<Vec<f64>> =
            (0..5).map(|j| whole.iter().map(|value| value + 100.0 * f64::from(j)).collect()).collect();
        for ranks in [1, 2, 3, 4, 11] {
            on_ranks(ranks, |communicator| {
                let rank = communicator.rank();
                let bands = Bands::new(&grid(), Arc::new(communicator));
                assert!(bands.own().all(|row| bands.rank_of(row) == rank));
                let own = bands.own_part(&whole);
                assert_eq!(own.len(), 2 * bands.own_cells().len());
                let there = (0..whole.len()).filter_map(|index| Some((bands.own_index(index)?, whole[index])));
                assert!(there.eq(own.iter().copied().enumerate()));
                let first = bands.gather_to_first(own.clone());
                assert_eq!(first, if rank == 0 { whole.clone() } else { Vec::new() });
                assert_eq!(bands.gather(own), whole);
                let parts: Vec<_> = columns.iter().map(|column| bands.own_part(column).into()).collect();
                assert_eq!(bands.collect(&parts), columns[bands.share(columns.len())]);
                // Column j is made by rank j modulo the number of ranks.
                let made = |rank: usize| columns.iter().skip(rank).step_by(ranks);
                let dealt = bands.deal(made(rank).cloned().collect());
                let expected: Vec<_> = (0..ranks).flat_map(made).map(|column| bands.own_part(column)).collect();
                assert_eq!(dealt, expected);
            });
        }
    }
}
