//! Time steps as one pass over memory: a sweep over the rows of the grid with what it needs of the rows around in cache.
//!
//! A [`RowStream`] evaluates a tendency row by row. All stages of a Runge–Kutta step follow each other at a distance of
//! one row, so that a step reads and writes each value of the state once, in place. Bands of rows are swept in parallel,
//! each from copies of the rows around it; as every row is the same function of the same rows whatever the bands, the
//! bits are the same on any number of threads.
//!
//! ```text
//! row  j + 4   x read                       stage 1 has its slope up to row j + 3
//!      j + 3   stage 2 state
//!      j + 2   stage 3 state
//!      j + 1   stage 4 state
//!      j       all slopes known: x written
//! ```

use crate::grid::{Boundary, Grid};
use pulp::{Arch, Simd, WithSimd};

/// A tendency evaluated row by row from the south, for stencils that reach one row and one column.
///
/// A row holds `[variable, x]`, each variable with one cell of rim on either side.
pub trait RowStream: Send {
    /// Begins a sweep with its first row.
    fn begin(&mut self, first: &[f64]);

    /// The row beyond a wall, given the row beside it.
    fn beyond_wall(&self, x: &[f64], ghost: &mut [f64]);

    /// Takes row `row` of the grid (that beyond the northern wall being row `ny`), and says the tendency of the row
    /// south of it, of which it was told before; the first tendency of a sweep is not to be used. The rim of the
    /// tendency is not set.
    fn push(&mut self, row: usize, south: &[f64], north: &[f64], tendency: &mut [f64]);
}

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
    /// Rows of the first variables around the band, `[row, variable, x]`.
    south: Vec<f64>,
    north: Vec<f64>,
    reach: usize,
}

/// Cuts fields into as many bands as there are threads, if they are large enough; `reach` rows of the first `variables`
/// fields are copied on either side.
pub(crate) fn bands<'a>(grid: &'a Grid, x: &'a mut [f64], variables: usize, reach: usize) -> Vec<Band<'a>> {
    let (nx, ny, cells) = (grid.nx, grid.ny, grid.cells());
    let most = cells / LEAST_CELLS_PER_BAND;
    let count = if most < 2 { 1 } else { rayon::current_num_threads().min(most).min(ny / (2 * reach)).max(1) };
    let mut bands: Vec<Band<'a>> = (0..count)
        .map(|band| {
            let (first, end) = (band * ny / count, (band + 1) * ny / count);
            let around = |from: usize| -> Vec<f64> {
                let mut copy = Vec::with_capacity(reach * variables * nx);
                for row in from..from + reach {
                    for variable in 0..variables {
                        copy.extend_from_slice(&x[variable * cells + row % ny * nx..][..nx]);
                    }
                }
                copy
            };
            let (south, north) = (around(first + (reach / ny + 1) * ny - reach), around(end));
            Band { first, rows: end - first, fields: Vec::with_capacity(x.len() / cells), grid, south, north, reach }
        })
        .collect();
    for mut field in x.chunks_exact_mut(cells) {
        for band in &mut bands {
            let (own, rest) = field.split_at_mut(band.rows * nx);
            band.fields.push(own);
            field = rest;
        }
    }
    bands
}

impl Band<'_> {
    /// Whether a wall is south and north of the band.
    pub fn walls(&self) -> (bool, bool) {
        let channel = self.grid.boundary == Boundary::Channel;
        (channel && self.first == 0, channel && self.first + self.rows == self.grid.ny)
    }

    /// The rows to push: the band's, and those within reach where there is no wall.
    pub fn reached(&self, reach: usize) -> std::ops::Range<isize> {
        let (south, north) = self.walls();
        let (first, end, reach) = (self.first as isize, (self.first + self.rows) as isize, reach as isize);
        (if south { first } else { first - reach })..(if north { end } else { end + reach })
    }

    /// The number of a row that may be beyond a periodic edge.
    pub fn grid_row(&self, row: isize) -> usize {
        row.rem_euclid(self.grid.ny as isize) as usize
    }

    /// Copies a row of the first variables, with its rim.
    pub fn load(&self, row: isize, out: &mut [f64]) {
        let nx = self.grid.nx;
        for (variable, out) in out.chunks_exact_mut(nx + 2).enumerate() {
            let variables = self.south.len() / (nx * self.reach).max(1);
            let offset = row - self.first as isize;
            let source = if offset < 0 {
                &self.south[((offset + self.reach as isize) as usize * variables + variable) * nx..]
            } else if offset >= self.rows as isize {
                &self.north[((offset - self.rows as isize) as usize * variables + variable) * nx..]
            } else {
                &self.fields[variable][offset as usize * nx..]
            };
            out[1..=nx].copy_from_slice(&source[..nx]);
            out[0] = source[nx - 1];
            out[nx + 1] = source[0];
        }
    }
}

/// Fills the rims of a row's variables, each of `length` values.
#[inline(always)]
pub(crate) fn wrap(x: &mut [f64], length: usize) {
    for x in x.chunks_exact_mut(length) {
        x[0] = x[length - 2];
        x[length - 1] = x[1];
    }
}

/// A ring of rows.
pub(crate) struct Ring {
    values: Vec<f64>,
    row_len: usize,
    depth: usize,
}

impl Ring {
    pub fn new(row_len: usize, depth: usize) -> Self {
        Self { values: vec![0.0; row_len * depth], row_len, depth }
    }

    fn start(&self, row: isize) -> usize {
        row.rem_euclid(self.depth as isize) as usize * self.row_len
    }

    pub fn row(&self, row: isize) -> &[f64] {
        let start = self.start(row);
        &self.values[start..start + self.row_len]
    }

    pub fn row_mut(&mut self, row: isize) -> &mut [f64] {
        let start = self.start(row);
        &mut self.values[start..start + self.row_len]
    }
}

/// out = x + Σ weight k, added up in the order of the terms (compiled for the processor's widest vectors).
pub(crate) fn combine(arch: Arch, out: &mut [f64], x: &[f64], terms: &[(f64, &[f64])]) {
    arch.dispatch(Combine { out, x, terms });
}

struct Combine<'a> {
    out: &'a mut [f64],
    x: &'a [f64],
    terms: &'a [(f64, &'a [f64])],
}

impl WithSimd for Combine<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let (out, n) = (self.out, self.x.len());
        let x = &self.x[..n];
        let out = &mut out[..n];
        match *self.terms {
            [(a, j)] => one_term(out, x, a, j),
            [(a, j), (b, k)] => two_terms(out, x, [a, b], j, k),
            [(a, j), (b, k), (c, l)] => {
                two_terms(out, x, [a, b], j, k);
                add_term(out, c, l);
            }
            [(a, j), (b, k), (c, l), (d, m)] => four_terms(out, x, [a, b, c, d], j, k, l, m),
            _ => {
                out.copy_from_slice(x);
                for &(weight, k) in self.terms {
                    add_term(out, weight, k);
                }
            }
        }
    }
}

#[inline(always)]
fn one_term(out: &mut [f64], x: &[f64], a: f64, j: &[f64]) {
    let (n, j) = (out.len(), &j[..out.len()]);
    for i in 0..n {
        out[i] = x[i] + a * j[i];
    }
}

#[inline(always)]
fn two_terms(out: &mut [f64], x: &[f64], [a, b]: [f64; 2], j: &[f64], k: &[f64]) {
    let (n, j, k) = (out.len(), &j[..out.len()], &k[..out.len()]);
    for i in 0..n {
        out[i] = (x[i] + a * j[i]) + b * k[i];
    }
}

#[inline(always)]
fn four_terms(out: &mut [f64], x: &[f64], [a, b, c, d]: [f64; 4], j: &[f64], k: &[f64], l: &[f64], m: &[f64]) {
    let (n, j, k) = (out.len(), &j[..out.len()], &k[..out.len()]);
    let (l, m) = (&l[..n], &m[..n]);
    for i in 0..n {
        out[i] = (((x[i] + a * j[i]) + b * k[i]) + c * l[i]) + d * m[i];
    }
}

#[inline(always)]
fn add_term(out: &mut [f64], weight: f64, k: &[f64]) {
    for (out, k) in out.iter_mut().zip(k) {
        *out += weight * k;
    }
}
