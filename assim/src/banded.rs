//! The Kalman filter with a banded error covariance: the Frobenius recursion of WO 97/18442.

mod analysis;
mod band;
mod forecast;
mod ordering;

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance::Covariance;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::estimated::EstimatedParameter;
use crate::problem::Problem;
use crate::saved::{Matrix, from_bytes, restore_bias, restore_state, to_bytes, unfit};
use band::Band;
use faer::{Mat, MatRef};
use isobar_model::{Duration, State};
use isobar_obs::{Calibration, ObservationWindow};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

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
pub struct BandedKalmanFilter {
    problem: Problem,
    /// The parameters that are estimated, c.
    calibration: Calibration,
    state: State,
    /// All parameters of the experiment.
    bias: Vec<f64>,
    /// The number of each value in the order of the band, and its place there.
    order: Vec<usize>,
    position: Vec<usize>,
    /// Q, in the order of the band.
    model_error: Band,
    /// What it is multiplied by.
    model_error_factor: f64,
    /// L, in the order of the band.
    root: Band,
    /// The Cholesky factor of W; `None` for I.
    information: Option<Band>,
    /// T, `[m, p]`.
    coupling: Mat<f64>,
    /// P_c, `[p, p]`.
    bias_covariance: Mat<f64>,
    /// What is to be added to it before the next forecast.
    widening: Mat<f64>,
    /// How far the last band was tapered to be a covariance, from 0 to 1.
    taper: f64,
}

#[derive(Serialize, Deserialize)]
struct Saved {
    state: Vec<f64>,
    bias: Vec<f64>,
    root: Vec<f64>,
    information: Option<Vec<f64>>,
    coupling: Matrix,
    bias_covariance: Matrix,
    widening: Matrix,
    taper: f64,
}

impl BandedKalmanFilter {
    /// A filter that starts from the background, with so many diagonals of the covariance beside the main one on either
    /// side; more than there are values are all of them.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the bands do not fit into the memory limit.
    pub fn new(problem: Problem, half_bandwidth: usize) -> Result<Self, Error> {
        let layout = problem.background.layout().clone();
        let m = layout.len();
        let half_bandwidth = half_bandwidth.min(m - 1);
        // L, Q, W or the next L, and a batch of columns.
        let needed_bytes = 8 * (3 * (half_bandwidth as u64 + 1) + 2 * forecast::BATCH as u64) * m as u64;
        if needed_bytes > problem.memory_limit_bytes {
            return Err(Error::TooLarge {
                what: format!("the bands of {half_bandwidth} diagonals for {m} values"),
                needed_bytes,
                limit_bytes: problem.memory_limit_bytes,
            });
        }
        let order = ordering::ordering(&layout);
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
        Ok(Self {
            state: problem.background.clone(),
            bias: vec![0.0; problem.calibration.len()],
            order,
            position,
            model_error,
            model_error_factor: 1.0,
            root,
            information: None,
            coupling: Mat::zeros(m, p),
            bias_covariance: Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j)),
            widening: Mat::zeros(p, p),
            taper,
            calibration,
            problem,
        })
    }

    /// The half-bandwidth of the forecast's covariance.
    pub fn half_bandwidth(&self) -> usize {
        self.root.half()
    }

    /// C⁻¹ Lᵀ a, for an a in the order of the band that is zero before `first`: its square is aᵀ L W⁻¹ Lᵀ a.
    fn whitened(&self, first: usize, a: &[f64]) -> Vec<f64> {
        let mut whitened = self.root.multiply_transposed(a);
        if let Some(information) = &self.information {
            information.solve_lower(self.root.first(first), &mut whitened);
        }
        whitened
    }

    fn in_band_order(&self, values: &[f64]) -> Vec<f64> {
        self.order.iter().map(|&index| values[index]).collect()
    }

    fn in_state_order(&self, values: &[f64]) -> Vec<f64> {
        self.position.iter().map(|&place| values[place]).collect()
    }

    /// T P_c.
    fn cross_covariance(&self) -> Mat<f64> {
        crate::linalg::product(self.coupling.as_ref(), self.bias_covariance.as_ref())
    }

    /// The estimate as it stands.
    fn estimate(&self) -> Result<Estimate, Error> {
        let m = self.state.values().len();
        let cross = self.cross_covariance();
        let given_biases: Vec<f64> = (0..m)
            .into_par_iter()
            .map_init(
                || vec![0.0; m],
                |row, i| {
                    let first = self.root.first(i);
                    row[first..].fill(0.0);
                    (first..=i).for_each(|j| row[j] = self.root.entry(i, j));
                    if let Some(information) = &self.information {
                        information.solve_lower(first, row);
                    }
                    row[first..].iter().map(|value| value * value).sum()
                },
            )
            .collect();
        let p = self.calibration.len();
        let mut variances: Vec<f64> = (0..m)
            .map(|i| {
                let with_biases: f64 = (0..p).map(|k| self.coupling[(i, k)] * cross[(i, k)]).sum();
                given_biases[self.position[i]] + with_biases
            })
            .collect();
        variances.extend((0..p).map(|k| self.bias_covariance[(k, k)] + self.widening[(k, k)]));
        let (state, bias) = (self.state.clone(), self.bias.clone());
        Estimate::with_variances(state, bias, &self.calibration, &variances, "the banded covariance")
    }
}

impl Assimilator for BandedKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.forecast_covariance(window)?;
        self.estimate()
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        if self.information.is_some() {
            return Err(Error::Setting("an analysis needs a forecast before it".into()));
        }
        let innovations = self.problem.innovations(observed, &self.state, &self.bias)?;
        let innovation_chi2 = self.take(&innovations)?;
        let estimate = self.estimate()?;
        self.problem.resolved_analysis(observed, innovations, estimate, innovation_chi2)
    }

    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        let (m, p) = (self.state.values().len(), self.calibration.len());
        let cross = self.cross_covariance();
        let column: Vec<f64> = match unknown {
            Unknown::Parameter(_) if p == 0 => return None,
            Unknown::Parameter(number) => {
                let own = (0..p).map(|k| self.bias_covariance[(k, number)] + self.widening[(k, number)]);
                cross.col_as_slice(number).iter().copied().chain(own).collect()
            }
            Unknown::Value(number) => {
                let (mut unit, place) = (vec![0.0; m], self.position[number]);
                unit[place] = 1.0;
                let mut column = self.whitened(place, &unit);
                if let Some(information) = &self.information {
                    information.solve_lower_transposed(&mut column);
                }
                let mut column = self.in_state_order(&self.root.multiply(&column));
                for (k, row) in (0..p).map(|k| (k, cross[(number, k)])) {
                    column.iter_mut().zip(self.coupling.col_as_slice(k)).for_each(|(value, t)| *value += t * row);
                }
                column.extend((0..p).map(|k| cross[(number, k)]));
                column
            }
        };
        Some(CovarianceColumn::of_augmented(column, m, &self.problem.calibration))
    }

    fn parameters(&self) -> Vec<EstimatedParameter> {
        let verdict = match self.taper {
            0.0 => "the band is a covariance as it is",
            _ => "how far the band is tapered to be a covariance, from 0 to 1",
        };
        vec![EstimatedParameter {
            name: "band/taper".into(),
            unit: "1".into(),
            value: self.taper,
            sigma: None,
            verdict: verdict.into(),
        }]
    }

    fn set_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let p = self.calibration.len();
        if estimate.len() != p || covariance.nrows() != p {
            return Err(Error::Setting("the calibration is not the one that the method estimates".into()));
        }
        self.bias.copy_from_slice(estimate);
        self.bias_covariance = covariance.to_owned();
        self.coupling.fill(0.0);
        self.widening.fill(0.0);
        Ok(())
    }

    fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        let (m, p) = (self.state.values().len(), self.calibration.len());
        if p == 0 {
            return None;
        }
        let cells = self.state.layout().grid.cells();
        let v = m / cells;
        let mut mean = vec![0.0; m];
        let means: Vec<(Vec<f64>, Vec<f64>)> = (0..v)
            .map(|variable| {
                mean.fill(0.0);
                mean[variable * cells..][..cells].fill(1.0 / cells as f64);
                let of_biases = (0..p).map(|k| {
                    self.coupling.col_as_slice(k)[variable * cells..][..cells].iter().sum::<f64>() / cells as f64
                });
                (self.whitened(0, &self.in_band_order(&mean)), of_biases.collect())
            })
            .collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let with_biases = |mean: usize, k: usize| dot(&means[mean].1, self.bias_covariance.col_as_slice(k));
        let joint = Mat::from_fn(p + v, p + v, |i, j| match (i.max(j), i.min(j)) {
            (i, j) if i < p => self.bias_covariance[(i, j)] + self.widening[(i, j)],
            (i, j) if j < p => with_biases(i - p, j),
            (i, j) => {
                let common: f64 = (0..p).map(|k| with_biases(i - p, k) * means[j - p].1[k]).sum();
                dot(&means[i - p].0, &means[j - p].0) + common
            }
        });
        Some(CalibrationAccuracy::new(joint, p))
    }

    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.widening += covariance;
        Ok(())
    }

    fn set_error_factor(&mut self, factor: f64) -> Result<(), Error> {
        self.model_error_factor = factor;
        Ok(())
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        to_bytes(&Saved {
            state: self.state.values().to_vec(),
            bias: self.bias.clone(),
            root: self.root.values().to_vec(),
            information: self.information.as_ref().map(|it| it.values().to_vec()),
            coupling: (&self.coupling).into(),
            bias_covariance: (&self.bias_covariance).into(),
            widening: (&self.widening).into(),
            taper: self.taper,
        })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let saved: Saved = from_bytes(saved)?;
        let (m, p) = (self.state.values().len(), self.calibration.len());
        restore_state(&mut self.state, &saved.state)?;
        restore_bias(&mut self.bias, &saved.bias)?;
        let band = |values: Vec<f64>| Band::from_values(m, values).ok_or_else(|| unfit("a banded covariance"));
        let root = band(saved.root)?;
        if root.half() != self.root.half() {
            return Err(unfit("the bandwidth"));
        }
        self.root = root;
        self.information = saved.information.map(band).transpose()?;
        self.coupling = saved.coupling.restored(m, Some(p), "the covariance of state and calibration")?;
        self.bias_covariance = saved.bias_covariance.restored(p, Some(p), "the covariance of the calibration")?;
        self.widening = saved.widening.restored(p, Some(p), "the covariance of the calibration")?;
        self.taper = saved.taper;
        Ok(())
    }
}
