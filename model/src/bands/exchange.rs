//! Rows that a rank needs beside its own, from the ranks that have them.

use super::Bands;
use crate::grid::Boundary;
use crate::stored::{ColumnsMut, Stored};
use std::ops::Range;

/// A rank's rows with some on either side, and who has these.
#[derive(Clone, Debug)]
pub struct RowExchange {
    rows: Range<isize>,
    /// Where the rank's rows begin among these, and how many there are.
    own: Range<usize>,
    nx: usize,
    /// For each rank that needs some of this one's rows: which of these, counted from the first.
    outgoing: Vec<(usize, Vec<usize>)>,
    /// For each rank that has some of the rows: which they are, counted from the first of `rows`.
    incoming: Vec<(usize, Vec<usize>)>,
}

impl RowExchange {
    /// For `width` rows on either side of each band, fewer at walls.
    pub fn new(bands: &Bands, width: usize) -> Self {
        let (ny, width) = (bands.grid.ny as isize, width as isize);
        let rows_of = |rank: usize| {
            let Range { start, end } = bands.of_rank(rank);
            let (start, end) = (start as isize - width, end as isize + width);
            match bands.grid.boundary {
                Boundary::Periodic => start..end,
                Boundary::Channel => start.max(0)..end.min(ny),
            }
        };
        // What a rank needs from another: which of its rows, and where they are there.
        let needs = |rank: usize, from: usize| -> Vec<(usize, usize)> {
            let (rows, band, source) = (rows_of(rank), bands.of_rank(rank), bands.of_rank(from));
            let is_own = |row: isize| (band.start as isize..band.end as isize).contains(&row);
            let beside = rows.clone().enumerate().filter(|&(_, row)| !is_own(row));
            let there = |(place, row): (usize, isize)| (place, row.rem_euclid(ny) as usize);
            beside
                .map(there)
                .filter(|(_, row)| source.contains(row))
                .map(|(place, row)| (place, row - source.start))
                .collect()
        };
        let (rank, ranks) = (bands.communicator.rank(), bands.communicator.ranks());
        let (rows, band) = (rows_of(rank), bands.own());
        let first = (band.start as isize - rows.start) as usize;
        let among = |needs: &dyn Fn(usize) -> Vec<usize>| -> Vec<(usize, Vec<usize>)> {
            (0..ranks).map(|other| (other, needs(other))).filter(|(_, rows)| !rows.is_empty()).collect()
        };
        let incoming = among(&|from| needs(rank, from).into_iter().map(|(place, _)| place).collect());
        let outgoing = among(&|to| needs(to, rank).into_iter().map(|(_, row)| row).collect());
        Self { rows, own: first..first + band.len(), nx: bands.grid.nx, outgoing, incoming }
    }

    /// The rows, own ones and those on either side; beyond a periodic edge they go on counting.
    pub fn rows(&self) -> &Range<isize> {
        &self.rows
    }

    /// Where the own rows are among these.
    pub fn own(&self) -> &Range<usize> {
        &self.own
    }

    /// Fills the rows on either side of fields `[y, x]` of these rows, each in a slice, in double or single precision, or of
    /// fields `[y, x, lane]`. Collective.
    ///
    /// # Panics
    /// If the ranks have fields of different numbers.
    pub fn fill(&self, bands: &Bands, fields: &mut [ColumnsMut<'_>]) {
        let row_len = |field: &ColumnsMut<'_>| field.len() / self.rows.len();
        let part = |row: usize, len: usize| row * len..(row + 1) * len;
        let row_lens: usize = fields.iter().map(row_len).sum();
        let message = |rows: &[usize]| {
            let mut values = Vec::with_capacity(row_lens * rows.len());
            for field in fields.iter() {
                let len = row_len(field);
                for part in rows.iter().map(|&row| part(self.own.start + row, len)) {
                    match field {
                        ColumnsMut::Double(field) => values.extend_from_slice(&field[part]),
                        ColumnsMut::Single(field) => values.extend(field[part].iter().map(|value| value.widen())),
                    }
                }
            }
            values
        };
        let outgoing = self.outgoing.iter().map(|(rank, rows)| (*rank, message(rows))).collect();
        let sources: Vec<usize> = self.incoming.iter().map(|(rank, _)| *rank).collect();
        let received = bands.communicator.exchange(outgoing, &sources);
        for ((_, rows), values) in self.incoming.iter().zip(received) {
            assert_eq!(values.len(), row_lens * rows.len(), "the ranks have fields of different numbers");
            let mut left = &values[..];
            for field in fields.iter_mut() {
                let len = row_len(field);
                for part in rows.iter().map(|&row| part(row, len)) {
                    let values = left.split_off(..len).expect("they are counted");
                    match field {
                        ColumnsMut::Double(field) => f64::narrow_all(values, &mut field[part]),
                        ColumnsMut::Single(field) => f32::narrow_all(values, &mut field[part]),
                    }
                }
            }
        }
    }

    /// The own rows of fields `[field, y, x]` of all these rows.
    pub fn narrow<S: Copy>(&self, wide: &[S], narrow: &mut [S]) {
        let (len, own) = (self.rows.len() * self.nx, self.own.start * self.nx..self.own.end * self.nx);
        for (wide, narrow) in wide.chunks_exact(len).zip(narrow.chunks_exact_mut(own.len())) {
            narrow.copy_from_slice(&wide[own.clone()]);
        }
    }

    /// Puts fields `[field, y, x]` of all these rows where they are in those of the whole grid.
    pub fn place(&self, bands: &Bands, wide: &[f64], whole: &mut [f64]) {
        let (nx, ny) = (self.nx, bands.grid.ny as isize);
        let fields = wide.chunks_exact(self.rows.len() * nx).zip(whole.chunks_exact_mut(bands.grid.cells()));
        for (wide, whole) in fields {
            for (values, row) in wide.chunks_exact(nx).zip(self.rows.clone()) {
                whole[row.rem_euclid(ny) as usize * nx..][..nx].copy_from_slice(values);
            }
        }
    }

    /// Fields `[field, y, x]` of all these rows get the own ones.
    pub fn widen<S: Copy>(&self, narrow: &[S], wide: &mut [S]) {
        let (len, own) = (self.rows.len() * self.nx, self.own.start * self.nx..self.own.end * self.nx);
        for (wide, narrow) in wide.chunks_exact_mut(len).zip(narrow.chunks_exact(own.len())) {
            wide[own.clone()].copy_from_slice(narrow);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::communicator::Communicator;
    use crate::grid::Grid;
    use crate::testing::on_ranks;
    use std::sync::Arc;

    /// Also where the rows beside a band are those of several others, or its own beyond a periodic edge.
    #[test]
    fn rows_beside_a_band_are_those_of_the_whole() {
        for (boundary, width, ranks) in [
            (Boundary::Periodic, 2, 3),
            (Boundary::Periodic, 9, 2),
            (Boundary::Channel, 3, 3),
            (Boundary::Channel, 5, 4),
            (Boundary::Periodic, 1, 1),
        ] {
            let grid = Grid { nx: 4, ny: 10, dx_m: 1.0, dy_m: 1.0, boundary };
            let whole: Vec<f64> = (0..80).map(f64::from).collect();
            on_ranks(ranks, |communicator| {
                let rank = communicator.rank();
                let bands = Bands::new(&grid, Arc::new(communicator));
                let exchange = RowExchange::new(&bands, width);
                let own = bands.own_part(&whole);
                let len = exchange.rows().len() * grid.nx;
                let mut wide = vec![0.0; 2 * len];
                exchange.widen(&own, &mut wide);
                exchange.fill(&bands, &mut wide.chunks_exact_mut(len).map(ColumnsMut::Double).collect::<Vec<_>>());
                assert_eq!(wide, grid.take_rows(exchange.rows(), &whole), "{boundary:?}, rank {rank} of {ranks}");
                let mut narrow = vec![0.0; own.len()];
                exchange.narrow(&wide, &mut narrow);
                assert_eq!(narrow, own);
            });
        }
    }
}
