//! The dense (extended) Kalman filter on the augmented state s = (x, c): the reference for every other method.

mod serial;

use crate::augmented::Augmented;
use crate::covariance;
use crate::error::Error;
use crate::filter::{Cycle, Errors, Filter, Fit};
use crate::fixed_lag::{FixedLag, PastAnalyses, Whitened};
use crate::innovation_covariance::InnovationCovariance;
use crate::linalg::{
    add_symmetric_product, column, entries_mut, for_each_chunk, mirror_lower, product, solve_lower,
    solve_lower_transposed, solved_lower, squared_norm,
};
use crate::memory::{Matrix, read, require, write};
use crate::problem::{Innovations, Problem, require_memory};
use crate::propagator::Propagator;
use faer::{Mat, MatMut, MatRef};
use isobar_model::TangentLinear;
use isobar_model::vector::{axpy, scale};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::sync::Arc;

/// The Kalman filter with the whole covariance.
///
/// Forecast (21), (24) of WO 93/22625: `s~ = M(ŝ)`, `P = A Cov(ŝ) Aᵀ + Q`, where A is applied to the columns of P and then to
/// its rows, in place. Analysis in gain form, `K = P Hᵀ (H P Hᵀ + R)⁻¹`: with the Cholesky factor L of H P Hᵀ + R, and
/// `W = P Hᵀ L⁻ᵀ`, it is
///
/// ```text
/// s ← s + W L⁻¹ d        P ← P − W Wᵀ        P ← P + (K R − P Hᵀ) Kᵀ
/// ```
///
/// Only one triangle of P is computed. In the last step, which makes it Joseph's form, K R − P Hᵀ is nothing but rounding,
/// but accurate observations may leave less of P than that.
///
/// [`KalmanFilter::serial`] takes one observation after the other: where their errors are uncorrelated, each is a scalar
/// measurement of what the ones before have left (Bierman 1977, Factorization Methods for Discrete Sequential Estimation,
/// chapter II; Maybeck 1979, Stochastic Models, Estimation and Control 1, section 5.3). With the row h of H, the variance
/// r, and P and δ as they stand,
///
/// ```text
/// v = P h        α = hᵀ v + r        δ ← δ + v (d − hᵀ δ)/α        P ← P − v vᵀ/α
/// ```
///
/// The α are the squared pivots of H P Hᵀ + R in LDLᵀ form, so Σ (d − hᵀ δ)²/α is the normalised innovation squared. Each
/// observation costs one sweep over half of P, n (m + p)² in all; nothing is cubic in n. One linearisation, about the
/// background, serves all observations of a cycle: the analysis is that of the gain form to rounding.
///
/// The downdate of one triangle keeps P symmetric, and α > hᵀ v keeps it positive as far as the rounding of its entries
/// allows: to r = 10⁻¹⁴ hᵀ P h in tests, where Joseph's form in two steps (Bierman's stabilised update) is already lost.
pub type KalmanFilter = Filter<Dense>;

/// The whole covariance P.
#[derive(Clone)]
pub struct Dense {
    /// Q of the state, `[m, m]`.
    model_error: Option<Arc<Mat<f64>>>,
    /// Whether the analysis takes one observation at a time.
    one_by_one: bool,
    memory: Memory,
}

/// What changes from cycle to cycle.
#[derive(Clone, Serialize, Deserialize)]
pub struct Memory {
    /// P, `[m + p, m + p]`.
    covariance: Matrix,
    smoother: Option<FixedLag>,
}

impl KalmanFilter {
    /// A filter that starts from the background, and analyses all observations of a cycle at once.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit.
    pub fn new(problem: impl Into<Problem<dyn TangentLinear>>) -> Result<Self, Error> {
        Self::with_inflated_errors(problem.into(), 1.0, false)
    }

    /// A filter that starts from the background, and analyses one observation at a time.
    ///
    /// # Errors
    /// As [`KalmanFilter::new`].
    pub fn serial(problem: impl Into<Problem<dyn TangentLinear>>) -> Result<Self, Error> {
        Self::with_inflated_errors(problem.into(), 1.0, true)
    }

    /// A filter that starts from the background, with the covariances of the state's errors at the start and of the
    /// model's errors multiplied by a factor; `one_by_one` takes one observation at a time.
    pub(crate) fn with_inflated_errors(
        problem: Problem<dyn TangentLinear>,
        factor: f64,
        one_by_one: bool,
    ) -> Result<Self, Error> {
        let calibration = problem.estimated_calibration();
        let (m, p) = (problem.background.values().len(), calibration.len());
        let size = Size { unknowns: m + p, observations: problem.most_observations, one_by_one, lag: None };
        size.require_memory(problem.memory_limit_bytes)?;
        let mut covariance = Mat::zeros(m + p, m + p);
        covariance::fill_dense(covariance.as_mut().get_mut(..m, ..m), &*problem.background_error, factor);
        let prior = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
        covariance.as_mut().get_mut(m.., m..).copy_from(prior);
        let model_error = problem.model_error.as_deref().map(|operator| {
            let mut model_error = Mat::zeros(m, m);
            covariance::fill_dense(model_error.as_mut(), operator, factor);
            Arc::new(model_error)
        });
        let memory = Memory { covariance: Matrix(covariance), smoother: None };
        Ok(Self::starting_with(problem, Dense { model_error, one_by_one, memory }))
    }

    /// The filter with a fixed-lag smoother of the last `lag` analyses before the newest.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if it does not fit into the memory limit beside the filter.
    pub fn smoothing(mut self, lag: usize) -> Result<Self, Error> {
        let size = Size { lag: Some(lag), ..self.belief.errors.size(self.problem.most_observations) };
        size.require_memory(self.problem.memory_limit_bytes)?;
        self.belief.errors.memory.smoother = Some(FixedLag::new(lag));
        Ok(self)
    }

    /// The covariance of the errors of (x, c), `[m + p, m + p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.belief.errors.memory.covariance.as_ref()
    }

    /// The covariance of the errors of (x, c), `[m + p, m + p]`.
    pub(crate) fn covariance_mut(&mut self) -> &mut Mat<f64> {
        &mut self.belief.errors.memory.covariance
    }
}

impl Dense {
    /// Rows and columns of the parameters, each multiplied by its φ.
    fn decay(&mut self, m: usize, kept: &[f64]) {
        let covariance = &mut self.memory.covariance;
        for (number, kept) in (m..).zip(kept).filter(|it| *it.1 != 1.0) {
            scale(covariance.col_as_slice_mut(number), *kept);
            (0..covariance.ncols()).for_each(|column| covariance[(number, column)] *= kept);
        }
    }

    fn size(&self, observations: usize) -> Size {
        let Memory { covariance, smoother } = &self.memory;
        let (unknowns, lag) = (covariance.nrows(), smoother.as_ref().map(PastAnalyses::lag));
        Size { unknowns, observations, one_by_one: self.one_by_one, lag }
    }
}

impl Errors for Dense {
    type Memory = Memory;

    const NAME: &'static str = "the covariance P";

    fn forecast(&mut self, s: &mut Augmented, cycle: &Cycle<'_>) -> Result<(), Error> {
        let m = s.state.values().len();
        let propagator = Propagator::new(cycle.model, &mut s.state, cycle.steps)?;
        let kept = cycle.kept();
        if let Some(kept) = &kept {
            self.decay(m, kept);
        }
        let Memory { covariance, smoother } = &mut self.memory;
        propagator.propagate(covariance.as_mut(), m)?;
        if let Some(model_error) = &self.model_error {
            let add = |first: usize, chunk: MatMut<'_, f64>| {
                for (j, column) in (first..).zip(chunk.col_iter_mut()) {
                    axpy(cycle.error_factor, &model_error.col_as_slice(j)[j..], &mut entries_mut(column)[j..]);
                }
            };
            for_each_chunk(covariance.as_mut().get_mut(..m, ..m), 0, &add);
        }
        (m..covariance.nrows()).for_each(|i| covariance[(i, i)] += cycle.drift(i - m));
        mirror_lower(covariance.as_mut());
        if let Some(smoother) = smoother {
            let a = propagator.matrix()?;
            smoother.forecast(MatRef::from_column_major_slice(&a, m, m), kept.as_deref());
        }
        Ok(())
    }

    fn analyse(&mut self, s: &mut Augmented, d: &Innovations) -> Result<Fit, Error> {
        let Memory { covariance, smoother } = &mut self.memory;
        let for_smoother = smoother.as_ref().map(|_| Whitened::new(covariance.as_ref(), d)).transpose()?;
        let analyse = if self.one_by_one { serial::analyse } else { in_gain_form };
        let (increment, chi2) = analyse(covariance, d)?;
        s.add(&increment);
        if let (Some(smoother), Some(whitened)) = (smoother, for_smoother) {
            smoother.add(s.clone(), covariance.as_ref(), whitened);
        }
        Ok(Fit { chi2, partition: None })
    }

    fn variances(&self) -> Vec<f64> {
        (0..self.memory.covariance.nrows()).map(|i| self.memory.covariance[(i, i)]).collect()
    }

    fn multiply(&self, h: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; h.len()];
        for (j, &weight) in h.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            axpy(weight, self.memory.covariance.col_as_slice(j), &mut product);
        }
        product
    }

    fn between(&self, a: &[(usize, f64)], b: &[(usize, f64)], _size: usize) -> f64 {
        let of_a = |&(i, weight): &(usize, f64)| {
            weight * b.iter().map(|&(j, other)| other * self.memory.covariance[(i, j)]).sum::<f64>()
        };
        a.iter().map(of_a).sum()
    }

    fn widen_calibration(&mut self, widening: MatRef<'_, f64>) {
        let m = self.memory.covariance.nrows() - widening.nrows();
        let mut of_calibration = self.memory.covariance.as_mut().get_mut(m.., m..);
        of_calibration += widening;
    }

    fn replace_calibration(&mut self, replacement: MatRef<'_, f64>) -> Result<(), Error> {
        let Memory { covariance, smoother } = &mut self.memory;
        let m = covariance.nrows() - replacement.nrows();
        if let Some(smoother) = smoother {
            smoother.clear();
        }
        covariance.as_mut().get_mut(m.., ..m).fill(0.0);
        covariance.as_mut().get_mut(..m, m..).fill(0.0);
        covariance.as_mut().get_mut(m.., m..).copy_from(replacement);
        Ok(())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.memory, to)
    }

    fn read(&self, from: &mut dyn Read) -> Result<Memory, Error> {
        read(from)
    }

    fn recall(&mut self, memory: Memory, s: &Augmented) -> Result<(), Error> {
        let size = self.memory.covariance.nrows();
        require(memory.covariance.has_shape(size, size), "the covariance P")?;
        match (&self.memory.smoother, &memory.smoother) {
            (None, None) => {}
            (Some(own), Some(recalled)) => recalled.require(own.lag(), s, size)?,
            _ => require(false, "the smoother")?,
        }
        self.memory = memory;
        Ok(())
    }

    fn require_memory(&self, observations: usize, _: usize, limit_bytes: u64) -> Result<(), Error> {
        self.size(observations).require_memory(limit_bytes)
    }

    fn smoother(&self) -> Option<&dyn PastAnalyses> {
        self.memory.smoother.as_ref().map(|smoother| smoother as _)
    }
}

/// The analysis of all observations at once; returns K d, `[m + p]`, and dᵀ (H P Hᵀ + R)⁻¹ d.
fn in_gain_form(p: &mut Mat<f64>, d: &Innovations) -> Result<(Vec<f64>, f64), Error> {
    let InnovationCovariance { cross: mut w, root } = InnovationCovariance::new(p.as_ref(), d)?;
    solve_lower(root.as_ref(), w.as_mut().transpose_mut());
    let departures = solved_lower(root.as_ref(), column(&d.departures));
    let increment = product(w.as_ref(), departures.as_ref());
    add_symmetric_product(p.as_mut(), -1.0, w.as_ref(), w.transpose());
    let mut gain = w;
    solve_lower_transposed(root.as_ref(), gain.as_mut().transpose_mut());
    // K R − P Hᵀ.
    let mut rounding = Mat::<f64>::zeros(p.nrows(), d.len());
    rounding.par_col_iter_mut().enumerate().for_each(|(row, target)| {
        let target = entries_mut(target);
        axpy(d.variance[row], gain.col_as_slice(row), target);
        d.row(row).for_each(|(column, weight)| axpy(-weight, p.col_as_slice(column), target));
    });
    add_symmetric_product(p.as_mut(), 1.0, rounding.as_ref(), gain.transpose());
    Ok((increment.col_as_slice(0).to_vec(), squared_norm(departures.col_as_slice(0))))
}

/// What a dense filter has to hold.
#[derive(Clone, Copy)]
struct Size {
    /// m + p.
    unknowns: usize,
    /// n.
    observations: usize,
    /// Whether the analysis takes one observation at a time.
    one_by_one: bool,
    /// Analyses of a smoother before the newest, if there is one.
    lag: Option<usize>,
}

impl Size {
    /// P and Q, and for the forecast the propagator A and twice a band, or for the analysis twice P Hᵀ and H P Hᵀ + R; the
    /// smoother, if there is one.
    fn require_memory(self, limit_bytes: u64) -> Result<(), Error> {
        let Self { unknowns, observations, one_by_one, lag } = self;
        let (size, n) = (unknowns as f64, observations as f64);
        let of_analysis =
            if one_by_one { size * size.min(serial::DELAYED as f64) + n } else { 2.0 * size * n + 2.0 * n * n };
        let of_smoother = lag.map_or(0.0, |lag| FixedLag::numbers(lag, unknowns, observations));
        let numbers = 2.0 * size * size + f64::max(Propagator::numbers(size), of_analysis) + of_smoother;
        require_memory(limit_bytes, numbers, || {
            let smoother = lag.map_or_else(String::new, |lag| format!(" with a smoother of {lag} analyses"));
            let observations = match observations {
                0 => String::new(),
                n => format!(" and {n} observations"),
            };
            format!("the dense Kalman filter for {unknowns} unknowns{observations}{smoother}")
        })
    }
}
