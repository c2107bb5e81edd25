//! The propagator A of one cycle: the linearised forecast, as a matrix or as runs of the tangent-linear model.

use crate::error::Error;
use crate::linalg::{add_product, copy_transposed, entries, entries_mut};
use faer::prelude::ReborrowMut;
use faer::{MatMut, MatRef};
use isobar_model::forecast::{self, ForecastError, require_finite_increments};
use isobar_model::{ColumnsMut, State, TangentLinear};
use rayon::prelude::*;
use std::borrow::Cow;

/// Forecasts `state` by `steps` steps and returns the tangent-linear propagator along that trajectory, column-major
/// `[m, m]`.
///
/// # Errors
/// If the forecast leaves the finite numbers.
pub(crate) fn propagator(model: &dyn TangentLinear, state: &mut State, steps: usize) -> Result<Vec<f64>, Error> {
    let m = state.values().len();
    let mut columns = vec![0.0; m * m];
    columns.iter_mut().step_by(m + 1).for_each(|diagonal| *diagonal = 1.0);
    forecast::forecast_tl(model, state, &mut columns, steps)?;
    Ok(columns)
}

/// Columns or rows of a covariance that are propagated at a time.
const BAND: usize = 256;

/// Columns of A or rows of a band that one thread copies at a time.
const COPIED: usize = 64;

/// Below this number of values per step of a run, products with A take less time than runs. It was measured with linear
/// shallow water and four stages per step.
const VALUES_PER_STEP: usize = 200;

/// The propagator A of one cycle, for the forecast of a covariance.
pub(crate) enum Propagator<'a> {
    /// The tangent-linear model advances what A multiplies: P ← A P Aᵀ takes 2m of its runs.
    Runs { model: &'a dyn TangentLinear, at: State, steps: usize },
    /// Column-major `[m, m]`: m runs, and products of 3m³ operations, which take less time where a run has many steps and
    /// few values.
    Matrix(Vec<f64>),
}

impl<'a> Propagator<'a> {
    /// Forecasts `state` by `steps` steps, and linearises along that trajectory.
    ///
    /// # Errors
    /// If the forecast leaves the finite numbers.
    pub fn new(model: &'a dyn TangentLinear, state: &mut State, steps: usize) -> Result<Self, Error> {
        if state.values().len() < VALUES_PER_STEP * steps * model.substeps() {
            return Ok(Self::Matrix(propagator(model, state, steps)?));
        }
        let at = state.clone();
        forecast::forecast(model, state, steps)?;
        Ok(Self::Runs { model, at, steps })
    }

    /// How many numbers [`Propagator::propagate`] holds beside a P of this size, m + p: A, and twice a band.
    pub fn numbers(size: f64) -> f64 {
        size * size + 2.0 * size * size.min(BAND as f64)
    }

    /// A, column-major `[m, m]`.
    ///
    /// # Errors
    /// If an increment leaves the finite numbers.
    pub fn matrix(&self) -> Result<Cow<'_, [f64]>, Error> {
        Ok(match self {
            Self::Runs { model, at, steps } => Cow::Owned(propagator(*model, &mut at.clone(), *steps)?),
            Self::Matrix(a) => Cow::Borrowed(a),
        })
    }

    /// P_xx ← A P_xx Aᵀ, P_xc ← A P_xc and P_cx ← P_xcᵀ in the lower triangle of P, `[m + p, m + p]`; what is above the
    /// diagonal is lost. First come the columns of P_x·, then the rows of A P_xx, which are the columns of P_xx Aᵀ, in
    /// bands: beside P there is no second matrix of its size.
    ///
    /// # Errors
    /// If an increment leaves the finite numbers.
    pub fn propagate(&self, mut p: MatMut<'_, f64>, m: usize) -> Result<(), Error> {
        let (mut band, mut scratch) = (Vec::new(), Vec::new());
        let size = p.ncols();
        for first in (0..size).step_by(BAND) {
            let mut columns = p.rb_mut().get_mut(..m, first..size.min(first + BAND));
            band.resize(m * columns.ncols(), 0.0);
            band.par_chunks_exact_mut(m).zip(columns.as_ref().par_col_iter()).for_each(|(target, source)| {
                target.copy_from_slice(entries(source));
            });
            self.multiply(&mut band, &mut scratch, m, (m, first))?;
            band.par_chunks_exact(m).zip(columns.rb_mut().par_col_iter_mut()).for_each(|(source, target)| {
                entries_mut(target).copy_from_slice(source);
            });
        }
        let (above, mut below) = p.rb_mut().split_at_row_mut(m);
        copy_transposed(below.rb_mut().get_mut(.., ..m), above.as_ref().get(.., m..));
        for first in (0..m).step_by(BAND) {
            let last = m.min(first + BAND);
            let mut rows = p.rb_mut().get_mut(first..last, ..m);
            band.resize(m * (last - first), 0.0);
            let columns = MatMut::from_column_major_slice_mut(&mut band, m, last - first);
            let chunks = columns.par_row_chunks_mut(COPIED).zip(rows.as_ref().par_col_chunks(COPIED));
            chunks.for_each(|(target, source)| copy_transposed(target, source));
            // The result is symmetric: each row is needed up to the diagonal only.
            self.multiply(&mut band, &mut scratch, m, (last, first))?;
            let columns = MatRef::from_column_major_slice(&band, m, last - first);
            let rows = rows.rb_mut().get_mut(.., ..last);
            let chunks = columns.get(..last, ..).par_row_chunks(COPIED).zip(rows.par_col_chunks_mut(COPIED));
            chunks.for_each(|(source, target)| copy_transposed(target, source));
        }
        Ok(())
    }

    /// Multiplies the columns of `band`, each of m values, by A; at least the first `wanted` values of each are found. `first`
    /// is the number of the first column, for messages.
    fn multiply(
        &self,
        band: &mut Vec<f64>,
        scratch: &mut Vec<f64>,
        m: usize,
        (wanted, first): (usize, usize),
    ) -> Result<(), Error> {
        match self {
            Self::Runs { model, at, steps } => {
                model.steps_tl(at, ColumnsMut::Double(band), *steps);
                require_finite_increments(model.layout(), &band[..], *steps).map_err(|error| match error {
                    ForecastError::IncrementNotFinite { step, column, place } => {
                        ForecastError::IncrementNotFinite { step, column: first + column, place }
                    }
                    other => other,
                })?;
            }
            Self::Matrix(a) => {
                let columns = band.len() / m;
                scratch.clear();
                scratch.resize(band.len(), 0.0);
                let a = MatRef::from_column_major_slice(a, m, m).get(..wanted, ..);
                let before = MatRef::from_column_major_slice(band, m, columns);
                let after = MatMut::from_column_major_slice_mut(scratch, m, columns).get_mut(..wanted, ..);
                // Transposed, so that threads divide the rows of A among them.
                add_product(after.transpose_mut(), 1.0, before.transpose(), a.transpose());
                std::mem::swap(band, scratch);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Mat;
    use isobar_model::random::{standard_normals, stream};
    use isobar_model::{
        Boundary, Duration, Grid, LinearShallowWater, Model, ShallowWater, ShallowWaterParameters, Stepped, TimeScheme,
        VectorInvariant,
    };

    /// 363 values: more than a band.
    fn shallow_water() -> Stepped<LinearShallowWater> {
        let grid = Grid { nx: 11, ny: 11, dx_m: 2e5, dy_m: 2e5, boundary: Boundary::Periodic };
        let parameters =
            ShallowWaterParameters { gravity_m_per_s2: 9.8, coriolis_per_s: 1e-4, ..ShallowWaterParameters::default() };
        let equations = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).unwrap();
        let equations = LinearShallowWater::about_uniform_flow(equations, 1000.0, 20.0).unwrap();
        Stepped::new(equations, Duration::from_seconds(600), TimeScheme::Rk4).unwrap()
    }

    #[test]
    fn runs_of_the_model_and_the_matrix_propagate_a_covariance_as_dense_algebra_does() {
        let model = shallow_water();
        let (m, p, steps) = (model.layout().len(), 4, 5);
        let mut state = State::zeros(model.layout());
        let a = propagator(&model, &mut state.clone(), steps).unwrap();
        let normals = standard_normals(&mut stream(1, "covariance"), (m + p) * (m + p));
        let half = Mat::from_fn(m + p, m + p, |i, j| normals[j * (m + p) + i]);
        let before = &half + half.transpose();
        let whole = Mat::from_fn(m + p, m + p, |i, j| match (i < m, j < m) {
            (true, true) => a[j * m + i],
            _ => f64::from(u8::from(i == j)),
        });
        let expected = &whole * &before * whole.transpose();
        let at = state.clone();
        let runs = Propagator::Runs { model: &model, at, steps };
        assert_eq!(*runs.matrix().unwrap(), *a);
        assert!(matches!(Propagator::new(&model, &mut state, 1).unwrap(), Propagator::Runs { .. }));
        assert!(matches!(Propagator::new(&model, &mut state, 2).unwrap(), Propagator::Matrix(_)));
        for propagator in [runs, Propagator::Matrix(a)] {
            let mut found = before.clone();
            propagator.propagate(found.as_mut(), m).unwrap();
            for j in 0..m + p {
                for i in j..m + p {
                    let difference = (found[(i, j)] - expected[(i, j)]).abs();
                    assert!(difference < 1e-13 * expected.norm_max(), "({i}, {j}): {difference:e}");
                }
            }
        }
    }
}
