//! The dense (extended) Kalman filter on the augmented state s = (x, c): the reference for every other method.

use super::serial;
use crate::augmented::Augmented;
use crate::covariance;
use crate::error::Error;
use crate::filter::{Cycle, Errors, Filter, Fit};
use crate::fixed_lag::{FixedLag, PastAnalyses, Whitened};
use crate::innovation_covariance::InnovationCovariance;
use crate::linalg::{add_product, add_symmetric_product, column, product, solve_lower_transposed, solved_lower};
use crate::memory::{Matrix, require};
use crate::problem::{Innovations, Problem, require_memory};
use crate::propagator::propagator;
use faer::{Mat, MatRef, Scale};
use isobar_model::TangentLinear;
use isobar_model::vector::{axpy, scale};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The Kalman filter with the whole covariance.
///
/// Forecast (21), (24) of WO 93/22625: `s~ = M(ŝ)`, `P = A Cov(ŝ) Aᵀ + Q`; analysis in gain form,
/// `K = P Hᵀ (H P Hᵀ + R)⁻¹`, with the covariance in Joseph's form `(I − K H) P (I − K H)ᵀ + K R Kᵀ`.
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
        let of_state = covariance::dense(&*problem.background_error) * Scale(factor);
        covariance.as_mut().get_mut(..m, ..m).copy_from(of_state);
        let prior = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
        covariance.as_mut().get_mut(m.., m..).copy_from(prior);
        let model_error = problem.model_error.as_deref();
        let model_error = model_error.map(|operator| Arc::new(covariance::dense(operator) * Scale(factor)));
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
        let a = propagator(cycle.model, &mut s.state, cycle.steps)?;
        let a = MatRef::from_column_major_slice(&a, m, m);
        let kept = cycle.kept();
        if let Some(kept) = &kept {
            self.decay(m, kept);
        }
        let p = self.memory.covariance.as_ref();
        // A P_xx and A P_xc.
        let rows = product(a, p.get(..m, ..));
        let mut forecast = Mat::zeros(p.nrows(), p.nrows());
        if let Some(model_error) = &self.model_error {
            forecast.as_mut().get_mut(..m, ..m).copy_from(&**model_error * Scale(cycle.error_factor));
        }
        add_symmetric_product(forecast.as_mut().get_mut(..m, ..m), 1.0, rows.as_ref().get(.., ..m), a.transpose());
        forecast.as_mut().get_mut(..m, m..).copy_from(rows.as_ref().get(.., m..));
        forecast.as_mut().get_mut(m.., ..m).copy_from(rows.as_ref().get(.., m..).transpose());
        forecast.as_mut().get_mut(m.., m..).copy_from(p.get(m.., m..));
        (m..p.nrows()).for_each(|i| forecast[(i, i)] += cycle.drift(i - m));
        self.memory.covariance = Matrix(forecast);
        if let Some(smoother) = &mut self.memory.smoother {
            smoother.forecast(a, kept.as_deref());
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

    fn memory(&self) -> &Memory {
        &self.memory
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
    let innovation = InnovationCovariance::new(p.as_ref(), d)?;
    let chi2 = innovation.normalised_square(&d.departures);
    let InnovationCovariance { cross, root } = innovation;
    let mut transposed_gain = solved_lower(root.as_ref(), cross.transpose().to_owned());
    solve_lower_transposed(root.as_ref(), transposed_gain.as_mut());
    let gain = transposed_gain.transpose();
    let increment = product(gain, column(&d.departures).as_ref());
    // Joseph's form in two rank-n steps: P ← P − K (H P), then P ← P − (P Hᵀ) Kᵀ + K R Kᵀ.
    add_product(p.as_mut(), -1.0, gain, cross.transpose());
    // p is now (I − K H) P; left is −(I − K H) P Hᵀ + K R.
    let mut left = Mat::zeros(p.nrows(), d.len());
    for row in 0..d.len() {
        let target = left.col_as_slice_mut(row);
        for (column, weight) in d.row(row) {
            axpy(-weight, p.col_as_slice(column), target);
        }
        for (i, value) in target.iter_mut().enumerate() {
            *value += d.variance[row] * gain[(i, row)];
        }
    }
    add_symmetric_product(p.as_mut(), 1.0, left.as_ref(), gain.transpose());
    Ok((increment.col_as_slice(0).to_vec(), chi2))
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
    /// P and Q, and for the forecast the propagator A and two products of the same size, or for the analysis P Hᵀ, twice the
    /// gain and H P Hᵀ + R; the smoother, if there is one.
    fn require_memory(self, limit_bytes: u64) -> Result<(), Error> {
        let Self { unknowns, observations, one_by_one, lag } = self;
        let (size, n) = (unknowns as f64, observations as f64);
        let of_analysis = if one_by_one { size + n } else { 3.0 * size * n + n * n };
        let of_smoother = lag.map_or(0.0, |lag| FixedLag::numbers(lag, unknowns, observations));
        let numbers = 2.0 * size * size + f64::max(3.0 * size * size, of_analysis) + of_smoother;
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
