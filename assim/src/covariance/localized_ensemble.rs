//! The localised covariance of an ensemble, as an operator.

use super::homogeneous_filter::HomogeneousFilter;
use super::taper::{MOST_HEIGHTS, is_wide};
use super::{Covariance, Spectrum};
use crate::error::Error;
use crate::linalg::{eigen, product};
use faer::Mat;
use isobar_model::{Grid, Layout};

/// ρ ∘ (X' X'ᵀ)/(N−1), with a Gaussian correlation ρ = C Cᵀ between cells that all variables share:
///
/// ```text
/// U α = Σ_k X'_k ∘ (C α_k) / √(N−1),
/// ```
///
/// with a field α_k for each member (Lorenc 2003; Buehner 2005). Without localisation α_k is one number.
pub struct LocalizedEnsemble {
    /// X'/√(N−1), `[m, N]`.
    factors: Mat<f64>,
    cells: usize,
    filter: Option<HomogeneousFilter>,
}

/// The length of the Gaussian that is nearest to Gaspari and Cohn's function, over the radius where that ends: the
/// function has √0.3 of half the radius (Gaspari and Cohn 1999, eq. 4.13 ff.).
const LENGTH_OVER_RADIUS: f64 = 0.273_861_278_752_583_05;

impl LocalizedEnsemble {
    /// The covariance of perturbations `[m, N]` whose rows have sum zero, localised as by Gaspari and Cohn's function with
    /// this radius; infinite for none.
    ///
    /// # Errors
    /// [`Error::Setting`] for a radius that needs too much padding in a channel.
    ///
    /// # Panics
    /// If the perturbations are not those of states of this layout.
    pub fn new(layout: &Layout, perturbations: &Mat<f64>, localization_radius_m: f64) -> Result<Self, Error> {
        assert_eq!(perturbations.nrows(), layout.len(), "perturbations have one row for each value of the state");
        let root = ((perturbations.ncols() - 1) as f64).sqrt();
        let lengths = lengths_m(&layout.grid, localization_radius_m);
        let filter = lengths.map(|lengths| HomogeneousFilter::gaussian(&layout.grid, lengths)).transpose()?;
        Ok(Self { factors: perturbations * faer::Scale(1.0 / root), cells: layout.grid.cells(), filter })
    }

    /// The length of the control vector for a given number of members.
    ///
    /// # Errors
    /// As [`LocalizedEnsemble::new`].
    pub(crate) fn control_len_of(grid: &Grid, members: usize, localization_radius_m: f64) -> Result<usize, Error> {
        Ok(match lengths_m(grid, localization_radius_m) {
            None => members,
            Some([_, length_y_m]) => members * grid.nx * HomogeneousFilter::gaussian_rows(grid, length_y_m)?,
        })
    }

    /// Length of each α_k.
    fn part(&self) -> usize {
        self.filter.as_ref().map_or(1, HomogeneousFilter::len)
    }
}

/// The lengths of the Gaussian for a radius, along the channel or plane and across; `None` if nothing is localised.
fn lengths_m(grid: &Grid, radius_m: f64) -> Option<[f64; 2]> {
    let length_m = LENGTH_OVER_RADIUS * radius_m;
    (!is_wide(grid, radius_m)).then(|| [length_m, length_m.min(MOST_HEIGHTS * grid.height_m())])
}

impl Covariance for LocalizedEnsemble {
    fn len(&self) -> usize {
        self.factors.nrows()
    }

    fn control_len(&self) -> usize {
        self.part() * self.factors.ncols()
    }

    fn spectrum(&self, scales: &[f64]) -> Option<Spectrum> {
        if self.filter.is_some() {
            return None;
        }
        let scaled = Mat::from_fn(self.len(), self.factors.ncols(), |i, j| self.factors[(i, j)] / scales[i]);
        let (values, _) = eigen(product(scaled.transpose(), scaled.as_ref()).as_ref());
        // The perturbations add up to zero: of one direction there is nothing but rounding.
        Some(Spectrum::new(values.into_iter().skip(1), 1.0))
    }

    fn covariance(&self, first: usize, second: usize) -> f64 {
        let products = (0..self.factors.ncols()).map(|k| self.factors[(first, k)] * self.factors[(second, k)]);
        let taper = |filter: &HomogeneousFilter| filter.correlation(first % self.cells, second % self.cells);
        products.sum::<f64>() * self.filter.as_ref().map_or(1.0, taper)
    }

    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        for (k, alpha) in control.chunks_exact(self.part()).enumerate() {
            let factor = self.factors.col_as_slice(k);
            match &self.filter {
                None => increment.iter_mut().zip(factor).for_each(|(value, factor)| *value += alpha[0] * factor),
                Some(filter) => {
                    let mut weights = alpha.to_vec();
                    filter.apply(&mut weights);
                    for (values, factors) in increment.chunks_exact_mut(self.cells).zip(factor.chunks_exact(self.cells))
                    {
                        for ((value, factor), weight) in values.iter_mut().zip(factors).zip(&weights) {
                            *value += factor * weight;
                        }
                    }
                }
            }
        }
    }

    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        for (k, alpha) in control.chunks_exact_mut(self.part()).enumerate() {
            let factor = self.factors.col_as_slice(k);
            match &self.filter {
                None => alpha[0] += increment.iter().zip(factor).map(|(value, factor)| value * factor).sum::<f64>(),
                Some(filter) => {
                    let mut weights = vec![0.0; filter.len()];
                    for (values, factors) in increment.chunks_exact(self.cells).zip(factor.chunks_exact(self.cells)) {
                        for ((weight, value), factor) in weights.iter_mut().zip(values).zip(factors) {
                            *weight += value * factor;
                        }
                    }
                    filter.apply(&mut weights);
                    alpha.iter_mut().zip(weights).for_each(|(alpha, weight)| *alpha += weight);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::dense;
    use crate::testing::check_covariance;
    use isobar_model::random::{standard_normals, stream};
    use isobar_model::{Boundary, Grid};

    #[test]
    fn it_is_the_tapered_covariance_of_the_members() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            let grid = Grid { nx: 8, ny: 6, dx_m: 1.0, dy_m: 1.0, boundary };
            let layout = isobar_model::shallow_water::layout(grid);
            let normals = standard_normals(&mut stream(1, "members"), layout.len() * 5);
            let perturbations = Mat::from_fn(layout.len(), 5, |i, j| normals[j * layout.len() + i]);
            let plain = LocalizedEnsemble::new(&layout, &perturbations, f64::INFINITY).unwrap();
            assert_eq!(check_covariance(&plain).rank, 5);
            let radius = 4.0;
            let localized = LocalizedEnsemble::new(&layout, &perturbations, radius).unwrap();
            assert!(check_covariance(&localized).rank > 50);
            let (plain, localized) = (dense(&plain), dense(&localized));
            // The taper at the place itself is one, and near a Gaussian at a distance of two cells in y.
            let expected = (-0.5 * (2.0 / (LENGTH_OVER_RADIUS * radius)).powi(2)).exp();
            for (i, j, taper) in [(20, 20, 1.0), (20, 48 + 20, 1.0), (20, 20 + 16, expected)] {
                let found = localized[(i, j)] / plain[(i, j)];
                assert!((found - taper).abs() < 0.01, "{boundary:?}: {found}, not {taper}");
            }
        }
    }
}
