//! The augmented state s = (x, c) with its dense covariance: what the dense filters share but for their analyses.

use crate::assimilator::Estimate;
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::fixed_lag::{FixedLag, Whitened};
use crate::linalg::{add_symmetric_product, product};
use crate::problem::Problem;
use crate::propagator::propagator;
use crate::saved::{Matrix, from_bytes, restore_bias, restore_state, to_bytes, unfit};
use faer::{Mat, MatRef, Scale};
use isobar_model::{Duration, State};
use isobar_obs::{Calibration, Jacobian};
use serde::{Deserialize, Serialize};

/// Estimate and covariance in a checkpoint.
#[derive(Serialize, Deserialize)]
struct Saved {
    state: Vec<f64>,
    bias: Vec<f64>,
    covariance: Matrix,
    smoother: Option<Vec<u8>>,
}

/// An estimate of (x, c) and the covariance of its errors, on which calibration parameters are unknowns like others.
pub(crate) struct AugmentedState {
    pub problem: Problem,
    /// The parameters that are estimated, c.
    calibration: Calibration,
    pub state: State,
    /// All parameters of the experiment.
    pub bias: Vec<f64>,
    /// P, `[m + p, m + p]`.
    pub covariance: Mat<f64>,
    /// Q of the state, `[m, m]`.
    model_error: Option<Mat<f64>>,
    pub smoother: Option<FixedLag>,
    /// What Q is multiplied by.
    pub model_error_factor: f64,
}

impl AugmentedState {
    /// The background, with its covariance and that of the parameters' priors.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit.
    pub fn new(problem: Problem) -> Result<Self, Error> {
        let calibration = problem.estimated_calibration();
        let (m, p) = (problem.background.values().len(), calibration.len());
        check_memory(&problem, m + p, None)?;
        let mut covariance = Mat::zeros(m + p, m + p);
        covariance.as_mut().get_mut(..m, ..m).copy_from(covariance::dense(&*problem.background_error));
        let prior = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
        covariance.as_mut().get_mut(m.., m..).copy_from(prior);
        let model_error = problem.model_error.as_deref().map(covariance::dense);
        let state = problem.background.clone();
        let bias = vec![0.0; problem.calibration.len()];
        let (smoother, model_error_factor) = (None, 1.0);
        Ok(Self { problem, calibration, state, bias, covariance, model_error, smoother, model_error_factor })
    }

    /// Adds a smoother of the last `lag` analyses before the newest.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if it does not fit into the memory limit beside the filter.
    pub fn smoothing(mut self, lag: usize) -> Result<Self, Error> {
        let size = self.covariance.nrows();
        check_memory(&self.problem, size, Some(lag))?;
        self.smoother = Some(FixedLag::new(lag));
        Ok(self)
    }

    /// Multiplies the covariances of the state's errors at the start and of the model's errors.
    pub fn inflate(&mut self, factor: f64) {
        let m = self.state.values().len();
        let mut own = self.covariance.as_mut().get_mut(..m, ..m);
        own *= Scale(factor);
        self.model_error.iter_mut().for_each(|model_error| *model_error *= Scale(factor));
    }

    /// Forecast (21), (24) of WO 93/22625: `s~ = M(ŝ)`, `P = A Cov(ŝ) Aᵀ + Q`; the parameters persist but for their
    /// random walks.
    pub fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        let steps = self.problem.steps(window)?;
        let a = propagator(&*self.problem.model, &mut self.state, steps)?;
        let a = MatRef::from_column_major_slice(&a, self.state.values().len(), self.state.values().len());
        let (m, s) = (a.nrows(), self.covariance.nrows());
        // A P_xx Aᵀ and A P_xc.
        let rows = product(a, self.covariance.as_ref().get(..m, ..));
        let mut forecast = Mat::zeros(s, s);
        if let Some(model_error) = &self.model_error {
            forecast.as_mut().get_mut(..m, ..m).copy_from(model_error * Scale(self.model_error_factor));
        }
        add_symmetric_product(forecast.as_mut().get_mut(..m, ..m), 1.0, rows.as_ref().get(.., ..m), a.transpose());
        forecast.as_mut().get_mut(..m, m..).copy_from(rows.as_ref().get(.., m..));
        forecast.as_mut().get_mut(m.., ..m).copy_from(rows.as_ref().get(.., m..).transpose());
        forecast.as_mut().get_mut(m.., m..).copy_from(self.covariance.as_ref().get(m.., m..));
        for (i, parameter) in self.calibration.parameters.iter().enumerate() {
            forecast[(m + i, m + i)] += parameter.sigma_drift_per_sqrt_day.powi(2) * window.days();
        }
        self.covariance = forecast;
        if let Some(smoother) = &mut self.smoother {
            smoother.forecast(a);
        }
        self.estimate()
    }

    /// Takes an analysis into the smoother, if there is one, once state and covariance are analysed.
    pub fn smooth(&mut self, whitened: Option<Whitened>) {
        if let (Some(smoother), Some(whitened)) = (&mut self.smoother, whitened) {
            let estimate = self.state.values().iter().chain(&self.bias).copied().collect();
            smoother.add(estimate, self.covariance.as_ref(), whitened);
        }
    }

    /// An earlier analysis given all observations so far.
    ///
    /// # Errors
    /// [`Error::NegativeVariance`].
    pub fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        let Some(smoother) = &self.smoother else { return Ok(None) };
        let m = self.state.values().len();
        let estimate = smoother.estimate(analyses_ago).map(|(values, variances)| {
            let (state, calibration) = values.split_at(m);
            let state = State::from_values(self.state.layout(), state.to_vec());
            let covariance = "the covariance of a smoothed estimate";
            Estimate::with_variances(state, calibration.to_vec(), &self.calibration, variances, covariance)
        });
        estimate.transpose()
    }

    /// What is known of the parameters, and of the state's means with them; `None` if they are not estimated.
    pub fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        let (m, p) = (self.state.values().len(), self.calibration.len());
        if p == 0 {
            return None;
        }
        let cells = self.state.layout().grid.cells();
        let v = m / cells;
        let mean_row = |variable: usize, j: usize| {
            let column = &self.covariance.col_as_slice(j)[variable * cells..][..cells];
            column.iter().sum::<f64>() / cells as f64
        };
        // Covariances of the means with everything, then of the means with each other.
        let with_all: Vec<Vec<f64>> = (0..v).map(|it| (0..m + p).map(|j| mean_row(it, j)).collect()).collect();
        let joint = Mat::from_fn(p + v, p + v, |i, j| match (i.max(j), i.min(j)) {
            (i, j) if i < p => self.covariance[(m + i, m + j)],
            (i, j) if j < p => with_all[i - p][m + j],
            (i, j) => with_all[i - p][(j - p) * cells..][..cells].iter().sum::<f64>() / cells as f64,
        });
        Some(CalibrationAccuracy::new(joint, p))
    }

    /// Adds a covariance to that of the parameters.
    pub fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) {
        let m = self.state.values().len();
        let mut own = self.covariance.as_mut().get_mut(m.., m..);
        own += covariance;
    }

    /// What a checkpoint holds of it.
    pub fn save(&self) -> Result<Vec<u8>, Error> {
        to_bytes(&Saved {
            state: self.state.values().to_vec(),
            bias: self.bias.clone(),
            covariance: (&self.covariance).into(),
            smoother: self.smoother.as_ref().map(FixedLag::save).transpose()?,
        })
    }

    /// Takes back what [`AugmentedState::save`] gave.
    pub fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let Saved { state, bias, covariance, smoother } = from_bytes(saved)?;
        restore_state(&mut self.state, &state)?;
        restore_bias(&mut self.bias, &bias)?;
        let size = self.covariance.nrows();
        self.covariance = covariance.restored(size, Some(size), "the covariance P")?;
        let (m, p) = (self.state.values().len(), self.calibration.len());
        match (&mut self.smoother, smoother) {
            (None, None) => Ok(()),
            (Some(own), Some(saved)) => own.restore(&saved, m, p, self.bias.len()),
            _ => Err(unfit("the smoother")),
        }
    }

    /// A column of P.
    pub fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        let m = self.state.values().len();
        let number = match unknown {
            Unknown::Value(number) => number,
            Unknown::Parameter(_) if self.calibration.is_empty() => return None,
            Unknown::Parameter(number) => m + number,
        };
        let column = self.covariance.col_as_slice(number).to_vec();
        Some(CovarianceColumn::of_augmented(column, m, &self.problem.calibration))
    }

    /// Takes over the calibration of [`Assimilator::set_calibration`](crate::Assimilator::set_calibration).
    pub fn set_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let (m, p) = (self.state.values().len(), self.calibration.len());
        if estimate.len() != p || covariance.nrows() != p {
            return Err(Error::Setting("the calibration is not the one that the method estimates".into()));
        }
        if let Some(smoother) = &mut self.smoother {
            smoother.clear();
        }
        self.bias.copy_from_slice(estimate);
        self.covariance.as_mut().get_mut(m.., ..m).fill(0.0);
        self.covariance.as_mut().get_mut(..m, m..).fill(0.0);
        self.covariance.as_mut().get_mut(m.., m..).copy_from(covariance);
        Ok(())
    }

    /// s ← s + δs.
    pub fn add(&mut self, increment: &[f64]) {
        let (state, bias) = increment.split_at(self.state.values().len());
        self.state.values_mut().iter_mut().zip(state).for_each(|(value, change)| *value += change);
        self.bias.iter_mut().zip(bias).for_each(|(value, change)| *value += change);
    }

    /// The estimate as it stands.
    ///
    /// # Errors
    /// [`Error::NegativeVariance`] if P has lost its meaning.
    pub fn estimate(&self) -> Result<Estimate, Error> {
        let variances: Vec<f64> = (0..self.covariance.nrows()).map(|i| self.covariance[(i, i)]).collect();
        let (state, bias) = (self.state.clone(), self.bias.clone());
        Estimate::with_variances(state, bias, &self.calibration, &variances, "the covariance P")
    }
}

/// The entries of a row of H = (X, G) on the augmented state, whose first `m` values are the state's.
pub(crate) fn entries(jacobian: &Jacobian, row: usize, m: usize) -> impl Iterator<Item = (usize, f64)> {
    let state = jacobian.state.row(row).iter().copied();
    state.chain(jacobian.calibration.row(row).iter().map(move |&(parameter, weight)| (m + parameter, weight)))
}

fn check_memory(problem: &Problem, size: usize, lag: Option<usize>) -> Result<(), Error> {
    // P, Q, the propagator A and two products of the same size.
    let needed_bytes = 5 * 8 * (size as u64).pow(2) + lag.map_or(0, |lag| FixedLag::bytes(lag, size));
    if needed_bytes > problem.memory_limit_bytes {
        let smoother = lag.map_or_else(String::new, |lag| format!(" with a smoother of {lag} analyses"));
        return Err(Error::TooLarge {
            what: format!("the dense Kalman filter for {size} unknowns{smoother}"),
            needed_bytes,
            limit_bytes: problem.memory_limit_bytes,
        });
    }
    Ok(())
}
