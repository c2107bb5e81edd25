//! The Kalman filter with a banded error covariance: the Frobenius recursion of WO 97/18442.

mod analysis;
mod band;
mod forecast;
mod ordering;

use crate::augmented::Augmented;
use crate::covariance::Covariance;
use crate::error::Error;
use crate::estimated::EstimatedParameter;
use crate::filter::{Cycle, Errors, Filter, Fit};
use crate::linalg::product;
use crate::memory::{Matrix, read, require, write};
use crate::problem::{Innovations, Problem, require_memory};
use band::Band;
use faer::{Mat, MatRef};
use isobar_model::TangentLinear;
use isobar_model::vector::{axpy, dot};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::sync::Arc;

/// Columns that are propagated together.
const BATCH: usize = 128;

/// WO 97/18442, p. 11: *error covariance matrices of numerical weather forecasts are typically band-diagonal*; then one can
/// proceed *without merging state parameters s into the observational blocks*, and invert their covariance *as one large
/// block*, bordered by the calibration parameters by Frobenius' formula (26).
///
/// The covariance is that of `x = L χ + T c`, with independent χ and c:
///
/// ```text
/// Cov(x, c) = [L W⁻¹ Lᵀ + T P_c Tᵀ,  T P_c;  P_c Tᵀ,  P_c],
/// ```
///
/// L Lᵀ the banded covariance of the forecast given the biases and W = I. An observation touches few neighbours, so that
/// its row H L has a band as well, and so have the normal equations of (χ, c), bordered by c. With D = P_c⁻¹ + G̃ᵀ R⁻¹ G̃,
/// B = (H L)ᵀ R⁻¹ G̃ and G̃ = H T + G
///
/// ```text
/// [W, B; Bᵀ, D]⁻¹ = [W⁻¹ + W⁻¹ B S Bᵀ W⁻¹,  −W⁻¹ B S;  −S Bᵀ W⁻¹,  S],     W = I + (H L)ᵀ R⁻¹ H L,
/// S = (D − Bᵀ W⁻¹ B)⁻¹,     T ← T − L W⁻¹ B,     P_c ← S.
/// ```
///
/// The analysis is exact. What is dropped is dropped in the forecast: of A L W⁻¹ Lᵀ Aᵀ + Q only the band is kept, which need
/// be no covariance; its correlations are tapered until it is one (`Band::covariance_factor`), by how much is among the
/// [`EstimatedParameter`]s. Variances are kept in any case. With the full band it equals the Kalman filter, with no
/// diagonal beside the main one every value's errors are taken to be independent of all others' but for what they have
/// in common with the biases.
///
/// With m values, a half-bandwidth h and n observations: m h² + n h² operations for an analysis, m² h for its claimed
/// variances and for the forecast, whose m tangent-linear columns are made a few at a time; memory 3 m h.
pub type BandedKalmanFilter = Filter<Banded>;

/// A banded covariance, and the errors that the calibration parameters explain.
#[derive(Clone)]
pub struct Banded {
    /// The number of each value in the order of the band, and its place there.
    order: Arc<[usize]>,
    position: Arc<[usize]>,
    /// Q, in the order of the band.
    model_error: Arc<Band>,
    /// How far the band of B was tapered to be a covariance, from 0 to 1.
    first_taper: f64,
    memory: Memory,
}

/// What changes from cycle to cycle.
#[derive(Clone, Serialize, Deserialize)]
pub struct Memory {
    /// L, in the order of the band.
    root: Band,
    /// The Cholesky factor of W.
    information: Band,
    /// T, `[m, p]`.
    coupling: Matrix,
    /// P_c, `[p, p]`.
    bias_covariance: Matrix,
    /// What is to be added to it before the next forecast.
    widening: Matrix,
    /// How far the last band was tapered to be a covariance, from 0 to 1.
    taper: f64,
}

impl BandedKalmanFilter {
    /// A filter that starts from the background, with `half_bandwidth` diagonals of the covariance on either side of the
    /// main one; more than there are values are all of them.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the bands do not fit into the memory limit.
    pub fn new(problem: impl Into<Problem<dyn TangentLinear>>, half_bandwidth: usize) -> Result<Self, Error> {
        let problem = problem.into();
        let errors = Banded::new(&problem, half_bandwidth)?;
        Ok(Self::starting_with(problem, errors))
    }

    /// The half-bandwidth of the forecast's covariance.
    pub fn half_bandwidth(&self) -> usize {
        self.belief.errors.memory.root.half()
    }
}

impl Banded {
    fn new(problem: &Problem<dyn TangentLinear>, half_bandwidth: usize) -> Result<Self, Error> {
        let layout = problem.background.layout();
        let m = layout.len();
        let half_bandwidth = half_bandwidth.min(m - 1);
        let p = problem.estimated_calibration().len();
        let numbers = numbers(m, p, half_bandwidth, problem.most_observations);
        problem.require_memory(numbers, || in_words(m, half_bandwidth, problem.most_observations))?;
        let order = ordering::ordering(layout);
        let mut position = vec![0; m];
        order.iter().enumerate().for_each(|(place, &index)| position[index] = place);
        let banded = |covariance: &dyn Covariance| {
            let mut band = Band::zeros(m, half_bandwidth);
            band.values_mut().par_chunks_mut(half_bandwidth + 1).enumerate().for_each(|(j, column)| {
                for (d, entry) in column.iter_mut().enumerate().take(m - j) {
                    *entry = covariance.covariance(order[j + d], order[j]);
                }
            });
            band
        };
        let model_error = problem.model_error.as_deref().map_or_else(|| Band::zeros(m, half_bandwidth), banded);
        let (root, taper) = banded(&*problem.background_error).covariance_factor()?;
        let calibration = problem.estimated_calibration();
        let p = calibration.len();
        let memory = Memory {
            root,
            information: Band::identity(m),
            coupling: Matrix(Mat::zeros(m, p)),
            bias_covariance: Matrix(Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j))),
            widening: Matrix(Mat::zeros(p, p)),
            taper,
        };
        Ok(Self {
            order: order.into(),
            position: position.into(),
            model_error: Arc::new(model_error),
            first_taper: taper,
            memory,
        })
    }

    fn in_band_order(&self, values: &[f64]) -> Vec<f64> {
        self.order.iter().map(|&index| values[index]).collect()
    }

    fn in_state_order(&self, values: &[f64]) -> Vec<f64> {
        self.position.iter().map(|&place| values[place]).collect()
    }

    /// L W⁻¹ Lᵀ a, in the order of the state.
    fn given_biases(&self, a: &[f64]) -> Vec<f64> {
        let Memory { root, information, .. } = &self.memory;
        let a = self.in_band_order(a);
        let Some(first) = a.iter().position(|value| *value != 0.0) else { return a };
        let mut image = root.multiply_transposed(&a);
        information.solve_lower(root.first(first), &mut image);
        information.solve_lower_transposed(&mut image);
        self.in_state_order(&root.multiply(&image))
    }
}

impl Errors for Banded {
    type Memory = Memory;

    const NAME: &'static str = "the banded covariance";

    fn forecast(&mut self, s: &mut Augmented, cycle: &Cycle<'_>) -> Result<(), Error> {
        self.propagate(&mut s.state, cycle)
    }

    fn analyse(&mut self, s: &mut Augmented, d: &Innovations) -> Result<Fit, Error> {
        let analysis = self.take(d)?;
        s.add(&analysis.increment);
        Ok(Fit { chi2: analysis.chi2, partition: None })
    }

    fn variances(&self) -> Vec<f64> {
        let Memory { root, information, coupling, bias_covariance, widening, .. } = &self.memory;
        let (m, p) = (coupling.nrows(), coupling.ncols());
        let given_biases: Vec<f64> = (0..m)
            .into_par_iter()
            .map_init(
                || vec![0.0; m],
                |row, i| {
                    let first = root.first(i);
                    row[first..].fill(0.0);
                    (first..=i).for_each(|j| row[j] = root.entry(i, j));
                    information.solve_lower(first, row);
                    row[first..].iter().map(|value| value * value).sum()
                },
            )
            .collect();
        // T P_c.
        let cross = product(coupling.as_ref(), bias_covariance.as_ref());
        let mut variances: Vec<f64> = (0..m)
            .map(|i| {
                let with_biases: f64 = (0..p).map(|k| coupling[(i, k)] * cross[(i, k)]).sum();
                given_biases[self.position[i]] + with_biases
            })
            .collect();
        variances.extend((0..p).map(|k| bias_covariance[(k, k)] + widening[(k, k)]));
        variances
    }

    fn multiply(&self, h: &[f64]) -> Vec<f64> {
        let Memory { coupling, bias_covariance, widening, .. } = &self.memory;
        let (of_state, of_bias) = h.split_at(coupling.nrows());
        let p = of_bias.len();
        // Tᵀ a + b, and P_c of it.
        let explained: Vec<f64> = (0..p).map(|k| dot(coupling.col_as_slice(k), of_state) + of_bias[k]).collect();
        let mut biases = vec![0.0; p];
        (0..p).for_each(|k| axpy(explained[k], bias_covariance.col_as_slice(k), &mut biases));
        let mut image = self.given_biases(of_state);
        (0..p).for_each(|k| axpy(biases[k], coupling.col_as_slice(k), &mut image));
        (0..p).for_each(|k| axpy(of_bias[k], widening.col_as_slice(k), &mut biases));
        image.extend(biases);
        image
    }

    fn widen_calibration(&mut self, widening: MatRef<'_, f64>) {
        *self.memory.widening += widening;
    }

    fn replace_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.memory.bias_covariance = Matrix(covariance.to_owned());
        self.memory.coupling.fill(0.0);
        self.memory.widening.fill(0.0);
        Ok(())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.memory, to)
    }

    fn read(&self, from: &mut dyn Read) -> Result<Memory, Error> {
        read(from)
    }

    fn recall(&mut self, memory: Memory, _: &Augmented) -> Result<(), Error> {
        let (m, p) = (self.memory.coupling.nrows(), self.memory.coupling.ncols());
        let half = Some(self.memory.root.half());
        require(memory.root.half_of(m) == half && memory.information.half_of(m).is_some(), "a banded covariance")?;
        require(memory.coupling.has_shape(m, p), "the covariance of state and calibration")?;
        let of_biases = memory.bias_covariance.has_shape(p, p) && memory.widening.has_shape(p, p);
        require(of_biases, "the covariance of the calibration")?;
        self.memory = memory;
        Ok(())
    }

    fn require_memory(&self, observations: usize, m: usize, limit_bytes: u64) -> Result<(), Error> {
        let (half, p) = (self.memory.root.half(), self.memory.bias_covariance.nrows());
        require_memory(limit_bytes, numbers(m, p, half, observations), || in_words(m, half, observations))
    }

    fn estimated_parameters(&self) -> Vec<EstimatedParameter> {
        let parameter = |name: &str, taper: f64| EstimatedParameter {
            name: name.into(),
            unit: "1".into(),
            value: taper,
            sigma: None,
            verdict: match taper {
                0.0 => "the band is a covariance as it is",
                _ => "how far the band is tapered to be a covariance, from 0 to 1",
            }
            .into(),
        };
        vec![parameter("band/taper", self.memory.taper), parameter("band/first_taper", self.first_taper)]
    }
}

/// L, Q, W or the next L, and a batch of columns; T, P_c and what an analysis makes of them; the rows of n observations.
fn numbers(m: usize, p: usize, half_bandwidth: usize, observations: usize) -> f64 {
    let [m, p, width, n] = [m, p, half_bandwidth + 1, observations].map(|size| size as f64);
    (3.0 * width + 2.0 * BATCH as f64) * m + 4.0 * m * p + 5.0 * p * p + n * (p + width)
}

fn in_words(m: usize, half_bandwidth: usize, observations: usize) -> String {
    format!("the bands of {half_bandwidth} diagonals for {m} values and {observations} observations")
}
