//! The leading local factors of a covariance.

use super::local_factors::LocalFactors;
use super::tiles::Tiles;
use crate::covariance::{Covariance, OVERSAMPLING};
use crate::error::Error;
use crate::errors::blocks::Precision;
use crate::linalg::{qr, singular_values};
use crate::spectral_cut;
use faer::{Mat, MatRef};
use isobar_model::random::standard_normals;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Applications of Uᵀ and U after the first; each sharpens the leading directions.
const POWER_ITERATIONS: usize = 2;

/// A covariance with the root U, its control vector shared out among tiles, and what a tile can see of it.
struct LocalRoot<'a> {
    covariance: &'a dyn Covariance,
    /// The values of the control vector that stand in each tile, ascending.
    controls: Vec<Vec<usize>>,
    /// The values of the state in each tile's support, ascending.
    supports: &'a [Vec<usize>],
    scales: &'a [f64],
    /// Groups of tiles so far apart that U can be applied to the controls of all of them at once.
    together: Vec<Vec<usize>>,
}

/// For each tile at most `rank` factors F_j with Σ_j F_j F_jᵀ ≤ U Uᵀ.
///
/// The control values of a tile make the part `U_j` of U, and Σ_j U_j U_jᵀ = U Uᵀ. Of each part the leading directions in the
/// norm of the scales are kept, F_j = U_j W_j w with orthonormal W_j and weights w ≤ 1 of a [`spectral_cut`], so that
/// `F_j F_jᵀ ≤ U_j U_jᵀ`. W_j are the right singular vectors of S⁻¹ U_j by a randomised range finder (Halko, Martinsson and
/// Tropp 2011, SIAM Review 53, algorithm 5.1).
/// U is applied to tiles of one colour at once, which are two supports apart: the cost is linear in the area.
///
/// # Errors
/// [`Error::Setting`] if the control vector of the covariance has no places.
pub(super) fn leading_local_factors(
    covariance: &dyn Covariance,
    tiles: &Tiles,
    supports: &[Vec<usize>],
    scales: &[f64],
    rank: usize,
    random: &mut ChaCha8Rng,
) -> Result<Vec<LocalFactors>, Error> {
    let cells = covariance.control_cells().ok_or_else(|| {
        Error::Setting("local factors need a covariance whose control vector stands on the grid".into())
    })?;
    let mut controls = vec![Vec::new(); tiles.count()];
    cells.iter().enumerate().for_each(|(control, &cell)| controls[tiles.tile_of(cell)].push(control));
    let colours = tiles.colours(2);
    let mut together = vec![Vec::new(); colours.count];
    colours.of_tile.iter().enumerate().for_each(|(tile, &colour)| together[colour].push(tile));
    let root = LocalRoot { covariance, controls, supports, scales, together };
    let drawn = |tile: usize| (rank + OVERSAMPLING).min(root.controls[tile].len());
    let mut directions: Vec<Mat<f64>> = (0..tiles.count())
        .map(|tile| {
            let (rows, columns) = (root.controls[tile].len(), drawn(tile));
            let normals = standard_normals(random, rows * columns);
            Mat::from_fn(rows, columns, |i, j| normals[j * rows + i])
        })
        .collect();
    let mut energies = vec![Vec::new(); tiles.count()];
    for _ in 0..=POWER_ITERATIONS {
        let basis: Vec<Mat<f64>> =
            root.images(&directions).into_par_iter().map(|image| orthonormal(image.as_ref())).collect();
        let images = root.transposed_images(&basis);
        (directions, energies) = images.into_par_iter().map(|image| leading_directions(image.as_ref())).unzip();
    }
    let directions: Vec<Mat<f64>> = directions
        .iter()
        .zip(&energies)
        .map(|(all, energies)| {
            let weights = spectral_cut::weights(energies, rank);
            Mat::from_fn(all.nrows(), weights.len(), |i, j| weights[j] * all[(i, j)])
        })
        .collect();
    let factors = root.images(&directions).into_iter().zip(supports).map(|(mut scaled, support)| {
        for column in 0..scaled.ncols() {
            let values = scaled.col_as_slice_mut(column).iter_mut();
            values.zip(support).for_each(|(value, &variable)| *value *= scales[variable]);
        }
        LocalFactors::new(support.clone(), scaled.as_ref(), Precision::Double)
    });
    Ok(factors.collect())
}

impl LocalRoot<'_> {
    /// S⁻¹ U_j x of each tile's columns x on its support.
    fn images(&self, x: &[Mat<f64>]) -> Vec<Mat<f64>> {
        let (controls, state) = (self.covariance.control_len(), self.covariance.len());
        self.apply(x, (&self.controls, controls), (self.supports, state), |control, state| {
            self.covariance.root_add(control, state);
            state.iter_mut().zip(self.scales).for_each(|(value, scale)| *value /= scale);
        })
    }

    /// U_jᵀ S⁻¹ y of each tile's columns y on its support.
    fn transposed_images(&self, y: &[Mat<f64>]) -> Vec<Mat<f64>> {
        let (controls, state) = (self.covariance.control_len(), self.covariance.len());
        self.apply(y, (self.supports, state), (&self.controls, controls), |state, control| {
            let scaled: Vec<f64> = state.iter().zip(self.scales).map(|(value, scale)| value / scale).collect();
            self.covariance.root_transpose_add(&scaled, control);
        })
    }

    /// Applies `operator` to the columns of all tiles of a colour at once, from the values at `from` to those at `to`, in
    /// vectors of these lengths.
    fn apply(
        &self,
        columns: &[Mat<f64>],
        (from, from_len): (&[Vec<usize>], usize),
        (to, to_len): (&[Vec<usize>], usize),
        operator: impl Fn(&[f64], &mut [f64]) + Sync,
    ) -> Vec<Mat<f64>> {
        let mut results: Vec<Mat<f64>> =
            columns.iter().zip(to).map(|(columns, to)| Mat::zeros(to.len(), columns.ncols())).collect();
        for tiles in &self.together {
            let count = tiles.iter().map(|&tile| columns[tile].ncols()).max().unwrap_or(0);
            let applied: Vec<Vec<Vec<f64>>> = (0..count)
                .into_par_iter()
                .map(|column| {
                    let (mut packed, mut image) = (vec![0.0; from_len], vec![0.0; to_len]);
                    let own = || tiles.iter().filter(|&&tile| column < columns[tile].ncols());
                    for &tile in own() {
                        let values = columns[tile].col_as_slice(column);
                        from[tile].iter().zip(values).for_each(|(&place, value)| packed[place] = *value);
                    }
                    operator(&packed, &mut image);
                    own().map(|&tile| to[tile].iter().map(|&place| image[place]).collect()).collect()
                })
                .collect();
            for (column, images) in applied.into_iter().enumerate() {
                let own = tiles.iter().filter(|&&tile| column < columns[tile].ncols());
                for (&tile, image) in own.zip(images) {
                    results[tile].col_as_slice_mut(column).copy_from_slice(&image);
                }
            }
        }
        results
    }
}

/// An orthonormal basis of the range of the columns; there may be more columns than rows.
fn orthonormal(columns: MatRef<'_, f64>) -> Mat<f64> {
    if columns.ncols() == 0 {
        return columns.to_owned();
    }
    qr(columns).compute_thin_Q()
}

/// The left singular vectors of the columns by descending singular values, and the squares of these.
fn leading_directions(columns: MatRef<'_, f64>) -> (Mat<f64>, Vec<f64>) {
    if columns.ncols() == 0 {
        return (columns.to_owned(), Vec::new());
    }
    let (u, values, _) = singular_values(columns);
    // An orthonormal basis whatever was lost to rounding.
    (orthonormal(u.as_ref()), values.iter().map(|value| value * value).collect())
}
