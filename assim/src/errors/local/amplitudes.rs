//! What observations say of the amplitudes ξ of all tiles' factors, and of the border.

use crate::error::Error;
use crate::linalg::{cholesky, product, solve_lower, solve_lower_transposed};
use faer::prelude::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, MatRef, Par, Side};
use std::collections::BTreeMap;

/// What messages call M.
const INFORMATION: &str = "the information matrix of the local factors";

/// The normal equations of the amplitudes ξ_j ~ N(0, I) and of the border c ~ N(0, S),
///
/// ```text
/// M = I + Eᵀ T⁻¹ E       M_xc = Eᵀ T⁻¹ E_c       M_cc = S⁻¹ + E_cᵀ T⁻¹ E_c       right = [E E_c]ᵀ T⁻¹ d
/// ```
///
/// M has a block for each two tiles whose supports have an observation in common.
pub(super) struct Amplitudes {
    /// The first amplitude of each tile, and their number.
    firsts: Vec<usize>,
    /// Blocks (i, j) of EᵀT⁻¹E with i ≥ j.
    blocks: BTreeMap<(usize, usize), Mat<f64>>,
    /// M_xc, `[amplitudes, p]`.
    cross: Mat<f64>,
    /// E_cᵀ T⁻¹ E_c, `[p, p]`.
    border: Mat<f64>,
    /// `[amplitudes + p]`.
    right: Vec<f64>,
    /// dᵀ T⁻¹ d.
    squares: f64,
}

/// The solution of the normal equations.
pub(super) struct Solved {
    /// ξ̂, `[amplitudes]`.
    pub amplitudes: Vec<f64>,
    /// What is added to c, `[p]`.
    pub border: Vec<f64>,
    /// M⁻¹ M_xc, `[amplitudes, p]`.
    pub of_border: Mat<f64>,
    /// S of the analysis, `[p, p]`.
    pub shared: Mat<f64>,
    /// dᵀ Cov(d)⁻¹ d.
    pub chi2: f64,
}

impl Amplitudes {
    /// The equations without observations, for tiles with these numbers of factors and p border unknowns.
    pub fn new(factors: &[usize], p: usize) -> Self {
        let mut firsts = vec![0];
        factors.iter().for_each(|count| firsts.push(firsts[firsts.len() - 1] + count));
        let n = firsts[factors.len()];
        Self {
            firsts,
            blocks: BTreeMap::new(),
            cross: Mat::zeros(n, p),
            border: Mat::zeros(p, p),
            right: vec![0.0; n + p],
            squares: 0.0,
        }
    }

    /// The amplitudes of a tile.
    pub fn of(&self, tile: usize) -> std::ops::Range<usize> {
        self.firsts[tile]..self.firsts[tile + 1]
    }

    fn len(&self) -> usize {
        self.firsts[self.firsts.len() - 1]
    }

    /// Adds the Gram matrix of whitened rows \[E E_c d\], in which E has the columns of these tiles.
    pub fn add(&mut self, tiles: &[usize], gram: MatRef<'_, f64>) {
        let (p, n) = (self.border.nrows(), self.len());
        let mut columns = vec![0];
        tiles.iter().for_each(|&tile| columns.push(columns[columns.len() - 1] + self.of(tile).len()));
        let border = columns[tiles.len()];
        for (a, &tile) in tiles.iter().enumerate() {
            let rows = columns[a]..columns[a + 1];
            for (b, &other) in tiles.iter().enumerate().take(a + 1) {
                let part = gram.get(rows.clone(), columns[b]..columns[b + 1]);
                // The lists of tiles ascend.
                let block = self.blocks.entry((tile, other)).or_insert_with(|| Mat::zeros(part.nrows(), part.ncols()));
                *block += part;
            }
            let own = self.of(tile);
            let mut cross = self.cross.as_mut().get_mut(own.clone(), ..);
            cross += gram.get(rows.clone(), border..border + p);
            for (target, row) in own.zip(rows) {
                self.right[target] += gram[(row, border + p)];
            }
        }
        self.border += gram.get(border..border + p, border..border + p);
        (0..p).for_each(|i| self.right[n + i] += gram[(border + i, border + p)]);
        self.squares += gram[(border + p, border + p)];
    }

    /// Solves them, with the border's prior S, by a Cholesky factorisation of M: a sparse one if most blocks are zero.
    ///
    /// # Errors
    /// If M or S is not positive definite.
    pub fn solve(&self, shared: MatRef<'_, f64>) -> Result<Solved, Error> {
        let (p, n) = (self.border.nrows(), self.len());
        let right = Mat::from_fn(n, p + 1, |i, j| if j < p { self.cross[(i, j)] } else { self.right[i] });
        let solved = self.solved(right)?;
        let of_border = solved.get(.., ..p).to_owned();
        let without_border = solved.get(.., p..).to_owned();
        // With S = L Lᵀ: S_a = L (I + Lᵀ (M_cc − S⁻¹ − M_cx M⁻¹ M_xc) L)⁻¹ Lᵀ.
        let root = cholesky(shared.to_owned(), || "the covariance of the shared parameters".into())?;
        let information = &self.border - product(self.cross.transpose(), of_border.as_ref());
        let mut whitened = product(root.transpose(), product(information.as_ref(), root.as_ref()).as_ref());
        (0..p).for_each(|i| whitened[(i, i)] += 1.0);
        let whitened = cholesky(whitened, || "the information matrix of the border".into())?;
        let seen = product(self.cross.transpose(), without_border.as_ref());
        let seen = Mat::from_fn(p, 1, |i, _| self.right[n + i] - seen[(i, 0)]);
        let mut of_seen = product(root.transpose(), seen.as_ref());
        solve_lower(whitened.as_ref(), of_seen.as_mut());
        let explained = crate::linalg::squared_norm(of_seen.col_as_slice(0));
        solve_lower_transposed(whitened.as_ref(), of_seen.as_mut());
        let border = product(root.as_ref(), of_seen.as_ref());
        let mut spread = root.transpose().to_owned();
        solve_lower(whitened.as_ref(), spread.as_mut());
        let shared = product(spread.transpose(), spread.as_ref());
        let amplitudes = &without_border - product(of_border.as_ref(), border.as_ref());
        let of_amplitudes = isobar_model::vector::dot(&self.right[..n], without_border.col_as_slice(0));
        Ok(Solved {
            amplitudes: amplitudes.col_as_slice(0).to_vec(),
            border: border.col_as_slice(0).to_vec(),
            of_border,
            shared,
            chi2: (self.squares - of_amplitudes - explained).max(0.0),
        })
    }

    /// M⁻¹ B.
    fn solved(&self, right: Mat<f64>) -> Result<Mat<f64>, Error> {
        let below: usize = self.blocks.values().map(|block| block.nrows() * block.ncols()).sum();
        if 4 * below > self.len().pow(2) { self.solved_as_dense(right) } else { self.solved_as_sparse(right) }
    }

    fn solved_as_dense(&self, mut right: Mat<f64>) -> Result<Mat<f64>, Error> {
        let mut matrix = Mat::<f64>::identity(self.len(), self.len());
        let tiles: Vec<usize> = (0..self.firsts.len() - 1).collect();
        // The lower triangle is read.
        self.for_each_entry(&tiles, |row, column, value| matrix[(row, column)] += value);
        let root = cholesky(matrix, || INFORMATION.into())?;
        solve_lower(root.as_ref(), right.as_mut());
        solve_lower_transposed(root.as_ref(), right.as_mut());
        Ok(right)
    }

    fn solved_as_sparse(&self, right: Mat<f64>) -> Result<Mat<f64>, Error> {
        let n = self.len();
        let mut entries: Vec<Triplet<usize, usize, f64>> = (0..n).map(|i| Triplet::new(i, i, 1.0)).collect();
        for (&(tile, other), block) in &self.blocks {
            for (j, column) in self.of(other).enumerate() {
                let rows = self.of(tile).enumerate().filter(|(_, row)| *row >= column);
                entries.extend(rows.map(|(i, row)| Triplet::new(row, column, block[(i, j)])));
            }
        }
        let not_positive = || Error::NotPositiveDefinite { matrix: INFORMATION.into(), pivot: 0, size: n };
        faer::set_global_parallelism(Par::Seq);
        let matrix = SparseColMat::try_new_from_triplets(n, n, &entries).map_err(|_| not_positive())?;
        let factor = matrix.sp_cholesky(Side::Lower).map_err(|_| not_positive())?;
        Ok(factor.solve(right))
    }

    /// Calls `set` with row, column and value of M − I as these tiles have it: whole blocks on and below the diagonal.
    pub fn for_each_entry(&self, tiles: &[usize], mut set: impl FnMut(usize, usize, f64)) {
        let mut first_row = 0;
        for (a, &row) in tiles.iter().enumerate() {
            let mut first_column = 0;
            for &column in &tiles[..=a] {
                if let Some(block) = self.blocks.get(&(row, column)) {
                    for j in 0..block.ncols() {
                        let values = block.col_as_slice(j).iter().enumerate();
                        values.for_each(|(i, &value)| set(first_row + i, first_column + j, value));
                    }
                }
                first_column += self.of(column).len();
            }
            first_row += self.of(row).len();
        }
    }

    /// A bound on the eigenvalues of M: its largest sum of a row's absolute values.
    pub fn bound(&self) -> f64 {
        let mut sums = vec![1.0; self.len()];
        for (&(tile, other), block) in &self.blocks {
            let (rows, columns) = (self.of(tile), self.of(other));
            for (j, column) in columns.enumerate() {
                for (row, value) in rows.clone().zip(block.col_as_slice(j)) {
                    sums[row] += value.abs();
                    if tile != other {
                        sums[column] += value.abs();
                    }
                }
            }
        }
        sums.into_iter().fold(1.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    #[test]
    fn a_sparse_factorisation_solves_what_a_dense_one_does() {
        let counts = [3, 2, 3, 3, 2, 3, 3, 3];
        let mut amplitudes = Amplitudes::new(&counts, 0);
        for tile in 0..counts.len() - 1 {
            let columns = counts[tile] + counts[tile + 1] + 1;
            let normals = standard_normals(&mut stream(tile as u64, "rows"), 4 * columns);
            let rows = Mat::from_fn(4, columns, |i, j| normals[4 * j + i]);
            amplitudes.add(&[tile, tile + 1], product(rows.transpose(), rows.as_ref()).as_ref());
        }
        let n = amplitudes.len();
        let right = Mat::from_fn(n, 2, |i, j| (1 + i + n * j) as f64);
        let [dense, sparse] = [Amplitudes::solved_as_dense, Amplitudes::solved_as_sparse]
            .map(|solved| solved(&amplitudes, right.clone()).unwrap());
        assert!((&dense - &sparse).norm_max() < 1e-12 * dense.norm_max());
        let mut image = dense.clone();
        let tiles: Vec<usize> = (0..counts.len()).collect();
        amplitudes.for_each_entry(&tiles, |row, column, value| {
            for j in 0..2 {
                if row >= column {
                    image[(row, j)] += value * dense[(column, j)];
                }
                if row > column {
                    image[(column, j)] += value * dense[(row, j)];
                }
            }
        });
        assert!((image - &right).norm_max() < 1e-11 * right.norm_max());
    }
}
