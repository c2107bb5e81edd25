//! A method with what is known of its sensors: earlier calibrations, announced recalibrations, frozen parameters.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::error::Error;
use crate::linalg::{add_symmetric_product, eigen};
use crate::saved::{Matrix, from_bytes, to_bytes, unfit};
use faer::{Mat, MatRef};
use isobar_model::{Duration, State, Time};
use isobar_obs::{Calibration, ObservationWindow};
use serde::{Deserialize, Serialize};

/// A sensor's announced recalibration: from a time on its bias is another, b ← b + u, with u known to a standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recalibration {
    /// From when on.
    pub time: Time,
    /// Number of the calibration parameter.
    pub parameter: usize,
    /// u, in the parameter's unit.
    pub step: f64,
    /// Standard deviation of the error of u, at least 0.
    pub sigma: f64,
}

/// What is known of the calibration parameters beside their prior covariance.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorKnowledge {
    /// The prior mean of each parameter at the start.
    pub mean: Vec<f64>,
    /// Recalibrations after the start, in any order.
    pub recalibrations: Vec<Recalibration>,
}

/// Gives any method the term B u and the prior mean of the calibration's recursion (20) of WO 93/22625,
/// `c_t = A_c c_{t−1} + B u_c + ε`, and keeps parameters from being adjusted.
///
/// *Mean.* The method itself estimates c' = c − o with prior mean zero, where the offset o is the prior mean and the steps
/// of all recalibrations so far. It is given the observations y − G o, and what it says of c' is told with o added. That
/// is exact, whatever the method, and for a window of several cycles as well: c' has no steps.
///
/// *Variance.* What is not known of a step, diag(σ²), is added to the covariance of c by
/// [`Assimilator::widen_calibration`].
///
/// *Frozen parameters.* With the gain's rows of frozen parameters F set to zero (Schmidt's consider filter), Joseph's form
/// gives the optimal covariance but for its F × F block, which stays that of the forecast:
/// `P⁺ = P⁺_optimal + K_F S K_Fᵀ`, `K_F S K_Fᵀ = P⁻_FF − P⁺_optimal,FF`. So the optimal analysis is made, o_F takes back what
/// it did to c_F, and the difference of the blocks is added. The state's errors stay correlated with those of c_F.
pub struct Calibrated {
    method: Box<dyn Assimilator>,
    /// What follows is empty where the method does not estimate biases.
    knowledge: SensorKnowledge,
    drift: Vec<f64>,
    memory: Memory,
    /// P_c as it would be now without any observation, `[p, p]`.
    prior: Mat<f64>,
    /// Of the last forecast.
    background: Option<State>,
    /// Its length; no forecast, no analysis whose estimate could be smoothed.
    window: Option<Duration>,
}

/// What is remembered from cycle to cycle.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Memory {
    seconds: i64,
    /// o.
    offset: Vec<f64>,
    /// The mean of c as it would be now without any observation.
    prior_mean: Vec<f64>,
    /// ĉ'.
    estimate: Vec<f64>,
    frozen: Vec<bool>,
}

impl From<Box<dyn Assimilator>> for Calibrated {
    /// The method as it is, with nothing known of any sensor.
    fn from(method: Box<dyn Assimilator>) -> Self {
        let (offset, prior_mean, estimate, frozen) = Default::default();
        let memory = Memory { seconds: 0, offset, prior_mean, estimate, frozen };
        Self {
            method,
            knowledge: SensorKnowledge::default(),
            drift: Vec::new(),
            memory,
            prior: Mat::zeros(0, 0),
            background: None,
            window: None,
        }
    }
}

impl Calibrated {
    /// A method that estimates the parameters of `calibration`, whose prior covariance it has, from `start` on.
    ///
    /// # Panics
    /// If the knowledge is of other parameters.
    pub fn new(
        method: Box<dyn Assimilator>,
        calibration: &Calibration,
        start: Time,
        knowledge: SensorKnowledge,
    ) -> Self {
        let p = calibration.len();
        assert!(knowledge.mean.len() == p && knowledge.recalibrations.iter().all(|it| it.parameter < p));
        let memory = Memory {
            seconds: start.seconds(),
            offset: knowledge.mean.clone(),
            prior_mean: knowledge.mean.clone(),
            estimate: vec![0.0; p],
            frozen: vec![false; p],
        };
        let drift = calibration.parameters.iter().map(|parameter| parameter.sigma_drift_per_sqrt_day).collect();
        let prior = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
        Self { method, knowledge, drift, memory, prior, background: None, window: None }
    }

    /// The covariance that the parameters would have now without any observation, `[p, p]`; without rows if the method
    /// does not estimate them.
    pub fn prior_covariance(&self) -> MatRef<'_, f64> {
        self.prior.as_ref()
    }

    /// The present estimate of the parameters.
    pub fn calibration(&self) -> Vec<f64> {
        let Memory { estimate, offset, .. } = &self.memory;
        estimate.iter().zip(offset).map(|(estimate, offset)| estimate + offset).collect()
    }

    /// Which parameters are frozen.
    pub fn frozen(&self) -> &[bool] {
        &self.memory.frozen
    }

    /// Takes parameters back to their prior, and adjusts them no more.
    ///
    /// # Errors
    /// [`Error::Setting`] for a method without a covariance of the biases, or with a smoother.
    pub fn freeze(&mut self, parameters: &[usize]) -> Result<(), Error> {
        let fresh: Vec<usize> = parameters.iter().copied().filter(|&number| !self.memory.frozen[number]).collect();
        if fresh.is_empty() {
            return Ok(());
        }
        if self.method.smoother_lag().is_some() {
            let message = "the fixed-lag smoother would go on adjusting what frozen parameters were";
            return Err(Error::Setting(message.into()));
        }
        let accuracy = self.method.calibration_accuracy().ok_or_else(no_accuracy)?;
        fresh.iter().for_each(|&number| self.memory.frozen[number] = true);
        let widening = widening(self.prior.as_ref(), accuracy.covariance(), |number| fresh.contains(&number));
        self.method.widen_calibration(widening.as_ref())?;
        for number in fresh {
            self.memory.offset[number] = self.memory.prior_mean[number] - self.memory.estimate[number];
        }
        Ok(())
    }

    /// Whether the method is not to see the observations as they are.
    fn is_shifted(&self) -> bool {
        self.memory.offset.iter().any(|&offset| offset != 0.0)
    }

    fn is_plain(&self) -> bool {
        self.drift.is_empty()
    }

    /// Takes up the recalibrations in the window that ends at `end`.
    fn recalibrate(&mut self, end: i64) -> Result<(), Error> {
        let p = self.drift.len();
        let mut added = Mat::<f64>::zeros(p, p);
        let due = |it: &&Recalibration| (self.memory.seconds + 1..=end).contains(&it.time.seconds());
        for it in self.knowledge.recalibrations.iter().filter(due) {
            self.memory.offset[it.parameter] += it.step;
            self.memory.prior_mean[it.parameter] += it.step;
            added[(it.parameter, it.parameter)] += it.sigma * it.sigma;
        }
        if (0..p).any(|i| added[(i, i)] > 0.0) {
            self.method.widen_calibration(added.as_ref())?;
            self.prior += added;
        }
        Ok(())
    }

    /// What the recalibrations from a time until now have added to the parameters.
    fn steps_since(&self, seconds: i64) -> Vec<f64> {
        let mut steps = vec![0.0; self.drift.len()];
        let since = |it: &&Recalibration| (seconds + 1..=self.memory.seconds).contains(&it.time.seconds());
        self.knowledge.recalibrations.iter().filter(since).for_each(|it| steps[it.parameter] += it.step);
        steps
    }

    /// The observations y − G o.
    fn shifted(&self, observed: &ObservationWindow, at: &State) -> ObservationWindow {
        let rows = observed.operator.linearize(at, &self.memory.offset).calibration;
        let mut shifted = observed.clone();
        for (row, value) in shifted.values.iter_mut().enumerate() {
            *value -= rows.row_dot(row, &self.memory.offset);
        }
        shifted
    }

    /// Tells what the method says of c' as what it means for c.
    fn told(&mut self, estimate: &mut Estimate) {
        self.memory.estimate.clone_from(&estimate.calibration);
        estimate.calibration.iter_mut().zip(&self.memory.offset).for_each(|(value, offset)| *value += offset);
    }

    /// The analysis, where some parameters are frozen.
    fn analyse_frozen(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let before = self.method.calibration_accuracy().ok_or_else(no_accuracy)?;
        let estimate = self.memory.estimate.clone();
        let mut analysis = self.method.analyse(observed)?;
        let after = self.method.calibration_accuracy().ok_or_else(no_accuracy)?;
        let frozen = self.memory.frozen.clone();
        let widening = widening(before.covariance(), after.covariance(), |number| frozen[number]);
        self.method.widen_calibration(widening.as_ref())?;
        for number in (0..frozen.len()).filter(|&number| frozen[number]) {
            self.memory.offset[number] -= analysis.estimate.calibration[number] - estimate[number];
            if let Some(spread) = &mut analysis.estimate.calibration_spread {
                spread[number] = before.covariance()[(number, number)].max(0.0).sqrt();
            }
        }
        Ok(analysis)
    }
}

impl Assimilator for Calibrated {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        if self.is_plain() {
            return self.method.forecast(window);
        }
        self.window = Some(window);
        let end = self.memory.seconds + window.seconds();
        self.recalibrate(end)?;
        self.memory.seconds = end;
        for (i, sigma) in self.drift.iter().enumerate() {
            self.prior[(i, i)] += sigma * sigma * window.days();
        }
        let mut estimate = self.method.forecast(window)?;
        self.background = self.is_shifted().then(|| estimate.state.clone());
        self.told(&mut estimate);
        Ok(estimate)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        if self.is_plain() {
            return self.method.analyse(observed);
        }
        let shifted = self.background.take().map(|background| self.shifted(observed, &background));
        let given = shifted.as_ref().unwrap_or(observed);
        let mut analysis = match self.memory.frozen.contains(&true) {
            true => self.analyse_frozen(given)?,
            false => self.method.analyse(given)?,
        };
        self.told(&mut analysis.estimate);
        Ok(analysis)
    }

    fn inner(&self) -> Option<&dyn Assimilator> {
        Some(&*self.method)
    }

    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        let mut smoothed = self.method.smoothed(analyses_ago)?;
        if let (Some(estimate), Some(window)) = (&mut smoothed, self.window) {
            let steps = self.steps_since(self.memory.seconds - window.seconds() * analyses_ago as i64);
            for ((value, offset), step) in estimate.calibration.iter_mut().zip(&self.memory.offset).zip(steps) {
                *value += offset - step;
            }
        }
        Ok(smoothed)
    }

    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.method.widen_calibration(covariance)
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        to_bytes(&(self.method.save()?, &self.memory, Matrix::from(&self.prior)))
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let (method, memory, prior): (Vec<u8>, Memory, Matrix) = from_bytes(saved)?;
        let p = self.drift.len();
        let lengths = [memory.offset.len(), memory.prior_mean.len(), memory.estimate.len(), memory.frozen.len()];
        if lengths != [p; 4] {
            return Err(unfit("what is known of the sensors"));
        }
        self.method.restore(&method)?;
        self.prior = prior.restored(p, Some(p), "the prior covariance of the calibration")?;
        self.memory = memory;
        Ok(())
    }
}

fn no_accuracy() -> Error {
    Error::Setting("the method has no covariance of biases, so none of them can be frozen".into())
}

/// `wide − narrow` on the chosen parameters, zero elsewhere; what is negative in it by rounding is left out.
fn widening(wide: MatRef<'_, f64>, narrow: MatRef<'_, f64>, chosen: impl Fn(usize) -> bool) -> Mat<f64> {
    let p = wide.nrows();
    let difference =
        Mat::from_fn(p, p, |i, j| if chosen(i) && chosen(j) { wide[(i, j)] - narrow[(i, j)] } else { 0.0 });
    let (values, vectors) = eigen(difference.as_ref());
    let scaled = Mat::from_fn(p, p, |i, j| vectors[(i, j)] * values[j].max(0.0));
    let mut widening = Mat::zeros(p, p);
    add_symmetric_product(widening.as_mut(), 1.0, scaled.as_ref(), vectors.transpose());
    widening
}
