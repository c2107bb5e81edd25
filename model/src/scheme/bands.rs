//! Bands of rows, swept in parallel.

use super::ends::{End, needed};
use super::rows::Row;
use crate::grid::Grid;
use std::ops::Range;

/// Below this number of cells one thread is faster than the start of two.
const LEAST_CELLS_PER_BAND: usize = 1 << 15;

/// Some rows of the fields to be swept, and copies of the rows around them.
pub(crate) struct Band<'a> {
    /// Number of the first row.
    pub first: usize,
    /// Number of rows.
    pub rows: usize,
    /// The band of each variable.
    pub fields: Vec<&'a mut [f64]>,
    grid: &'a Grid,
    ends: [End; 2],
    variables: usize,
    /// Values of a variable's row.
    row_len: usize,
    /// Rows of the first variables around the band, `[row, variable, x]`.
    south: Vec<f64>,
    north: Vec<f64>,
    reach: usize,
}

/// Cuts fields into as many bands as there are threads, if they are large enough; `reach` rows of the first `variables`
/// fields are copied on either side. A place has `lanes` values.
pub(crate) fn bands<'a>(
    (grid, ends): (&'a Grid, [End; 2]),
    x: &'a mut [f64],
    variables: usize,
    lanes: usize,
    reach: usize,
) -> Vec<Band<'a>> {
    let (row_len, ny, field_len) = (grid.nx * lanes, grid.ny, grid.cells() * lanes);
    let most = field_len / LEAST_CELLS_PER_BAND;
    let count = if most < 2 { 1 } else { rayon::current_num_threads().min(most).min(ny / (2 * reach)).max(1) };
    let mut bands: Vec<Band<'a>> = (0..count)
        .map(|band| {
            let (first, end) = (band * ny / count, (band + 1) * ny / count);
            let around = |from: usize| -> Vec<f64> {
                let mut copy = Vec::with_capacity(reach * variables * row_len);
                for row in from..from + reach {
                    for variable in 0..variables {
                        copy.extend_from_slice(&x[variable * field_len + row % ny * row_len..][..row_len]);
                    }
                }
                copy
            };
            let (south, north) = (around(first + (reach / ny + 1) * ny - reach), around(end));
            let fields = Vec::with_capacity(x.len() / field_len);
            Band { first, rows: end - first, fields, grid, ends, variables, row_len, south, north, reach }
        })
        .collect();
    for mut field in x.chunks_exact_mut(field_len) {
        for band in &mut bands {
            let (own, rest) = field.split_at_mut(band.rows * row_len);
            band.fields.push(own);
            field = rest;
        }
    }
    bands
}

impl Band<'_> {
    /// Whether a wall is south and north of the band.
    #[inline]
    pub fn walls(&self) -> (bool, bool) {
        let [south, north] = self.ends.map(|end| end == End::Wall);
        (south && self.first == 0, north && self.first + self.rows == self.grid.ny)
    }

    /// The rows to push: the band's, and those within reach.
    pub fn reached(&self, reach: usize) -> Range<isize> {
        needed(&(self.first..self.first + self.rows), self.grid.ny, self.ends, reach)
    }

    /// The number of a row that may be beyond a periodic edge.
    #[inline]
    pub fn grid_row(&self, row: isize) -> usize {
        let ny = self.grid.ny as isize;
        if (0..ny).contains(&row) { row as usize } else { row.rem_euclid(ny) as usize }
    }

    /// A row of the first variables.
    #[inline]
    pub fn row(&self, row: isize) -> Row<'_> {
        let nx = self.row_len;
        let offset = row - self.first as isize;
        let len = self.variables * nx;
        if offset < 0 {
            return Row::of(&self.south[(offset + self.reach as isize) as usize * len..][..len], nx);
        }
        if offset >= self.rows as isize {
            return Row::of(&self.north[(offset - self.rows as isize) as usize * len..][..len], nx);
        }
        let mut out = Row::default();
        for (out, field) in out.0.iter_mut().zip(&self.fields[..self.variables]) {
            *out = &field[offset as usize * nx..][..nx];
        }
        out
    }
}
