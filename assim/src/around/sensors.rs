//! A method with what is known of its sensors: earlier calibrations, announced recalibrations, frozen parameters.

mod root;

use super::compared;
use crate::assimilator::{Adjustments, Assimilator, CalibrationAdjustment, Smoother, Views};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::calibration_drift::drift;
use crate::covariance_root::CovarianceRoot;
use crate::error::Error;
use crate::estimate::{Analysis, Background, Estimate};
use crate::linalg::{add_symmetric_product, eigen};
use crate::memory::{Matrix, read, require, write};
use faer::{Mat, MatRef};
use isobar_model::vector::{add, multiply};
use isobar_model::{Duration, State, Time};
use isobar_obs::{Calibration, ObservationWindow};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{Read, Write};

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
/// of all recalibrations so far. It is given the observations y − G o, and its estimate of c' is reported with o added. That
/// is exact, whatever the method, and for a window of several cycles as well: c' has no steps.
///
/// *Variance.* What is not known of a step, diag(σ²), is added to the covariance of c by
/// [`WidenCalibration`](crate::assimilator::WidenCalibration).
///
/// *Comparisons* of sensors and test points are given to the method as observations of c' alone (see
/// [`SensorComparison`](isobar_obs::SensorComparison)); in a Kalman filter that is the analysis with their rows in H. The
/// departures and χ² of the analysis are those of the observations alone: with r⁺ = d − g ĉ and A⁺ = g S gᵀ after the analysis,
/// and R = diag(σ²), the comparisons' part of χ², given the observations, is `r⁺ᵀ (R − A⁺)⁻¹ r⁺`.
///
/// *Frozen parameters.* With the gain's rows of frozen parameters F set to zero (the Schmidt–Kalman or consider filter, Schmidt
/// 1966, Advances in Control Systems 3, 293; Jazwinski 1970, section 8.4), their uncertainty still enters the covariance
/// `S = H P⁻ Hᵀ + R` of the innovations, and Joseph's form gives the optimal covariance but for its F × F block, which stays
/// that of the forecast: `P⁺ = P⁺_optimal + K_F S K_Fᵀ`, `K_F S K_Fᵀ = P⁻_FF − P⁺_optimal,FF`. So the optimal analysis is
/// made, o_F takes back what it did to c_F, and the difference of the blocks is added. The state's errors stay correlated with
/// those of c_F. P⁺_optimal,FF is what an update would have left, by which it is judged whether to adjust them again.
#[derive(Clone)]
pub struct Calibrated {
    method: Box<dyn Assimilator>,
    /// What follows is empty where the method does not estimate biases.
    knowledge: SensorKnowledge,
    calibration: Calibration,
    ignores_comparisons: bool,
    memory: Memory,
}

/// What is remembered from cycle to cycle.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Memory {
    time: Time,
    /// o.
    offset: Vec<f64>,
    /// The mean of c as it would be now without any observation.
    prior_mean: Vec<f64>,
    /// P_c as it would be now without any observation, `[p, p]`.
    prior: Matrix,
    /// ĉ'.
    estimate: Vec<f64>,
    frozen: Vec<bool>,
    /// The variance that the last analysis would have left of each parameter that was frozen in it; meaningless for the others.
    would_be: Vec<f64>,
    /// o at the analyses that the method's smoother still revises, the oldest first.
    past_offsets: VecDeque<Vec<f64>>,
}

impl From<Box<dyn Assimilator>> for Calibrated {
    /// The method as it is, with nothing known of any sensor.
    fn from(method: Box<dyn Assimilator>) -> Self {
        Self::new(method, &Calibration::default(), Time::from_seconds(0), SensorKnowledge::default())
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
            time: start,
            offset: knowledge.mean.clone(),
            prior_mean: knowledge.mean.clone(),
            prior: Matrix(Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j))),
            estimate: vec![0.0; p],
            frozen: vec![false; p],
            would_be: vec![f64::NAN; p],
            past_offsets: VecDeque::new(),
        };
        Self { method, knowledge, calibration: calibration.clone(), ignores_comparisons: false, memory }
    }

    /// The same, as if sensors were never compared.
    pub fn ignoring_comparisons(self) -> Self {
        Self { ignores_comparisons: true, ..self }
    }

    /// Whether comparisons of sensors are taken in: by a method that estimates biases, unless it is to ignore them.
    pub fn takes_comparisons(&self) -> bool {
        !self.ignores_comparisons && !self.is_plain()
    }

    /// The covariance that the parameters would have now without any observation, `[p, p]`; without rows if the method
    /// does not estimate them.
    pub fn prior_covariance(&self) -> MatRef<'_, f64> {
        self.memory.prior.as_ref()
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

    /// The variance that the last analysis would have left of a parameter that is frozen, had it been adjusted in it; `None` if
    /// it is not frozen, or there has been no analysis since it was.
    pub fn variance_if_adjusted(&self, parameter: usize) -> Option<f64> {
        let would_be = self.memory.would_be[parameter];
        (self.memory.frozen[parameter] && would_be.is_finite()).then_some(would_be)
    }

    /// Takes parameters back to their prior, and adjusts them no more.
    ///
    /// # Errors
    /// As [`Calibrated::hold`].
    pub fn freeze(&mut self, parameters: &[usize]) -> Result<(), Error> {
        let fresh: Vec<usize> = parameters.iter().copied().filter(|&number| !self.memory.frozen[number]).collect();
        if fresh.is_empty() {
            return Ok(());
        }
        let accuracy = self.accuracy()?;
        self.hold(&fresh)?;
        let prior = self.memory.prior.as_ref();
        let widening = difference(prior, accuracy.covariance(), |number| fresh.contains(&number));
        self.widen(widening.as_ref())?;
        for number in fresh {
            self.memory.offset[number] = self.memory.prior_mean[number] - self.memory.estimate[number];
        }
        Ok(())
    }

    /// Adjusts parameters no more: each keeps estimate and variance as they are, but for what its drift makes of them.
    ///
    /// # Errors
    /// [`Error::Setting`] for a method without a covariance of the biases, or with a smoother.
    pub fn hold(&mut self, parameters: &[usize]) -> Result<(), Error> {
        if self.method.can().smoother.is_some() {
            let message = "the fixed-lag smoother would go on adjusting what frozen parameters were";
            return Err(Error::Setting(message.into()));
        }
        self.accuracy()?;
        for &number in parameters {
            if !std::mem::replace(&mut self.memory.frozen[number], true) {
                self.memory.would_be[number] = f64::NAN;
            }
        }
        Ok(())
    }

    /// Adjusts parameters again, from the estimate and the variance that they have.
    pub fn thaw(&mut self, parameters: &[usize]) {
        parameters.iter().for_each(|&number| self.memory.frozen[number] = false);
    }

    /// What the method claims to know of the calibration.
    fn accuracy(&self) -> Result<CalibrationAccuracy, Error> {
        let calibration = self.method.can().calibration;
        let accuracy = calibration.map(|calibration| calibration.calibration_accuracy());
        accuracy.ok_or_else(|| {
            Error::Setting("the method has no covariance of biases, so none of them can be frozen".into())
        })
    }

    /// Adds a covariance to that of the calibration.
    fn widen(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let Some(calibration) = self.method.adjust().widen() else {
            let message = "the method has no covariance of biases, which a recalibration could change";
            return Err(Error::Setting(message.into()));
        };
        calibration.widen_calibration(covariance)
    }

    /// Whether the method is not to see the observations as they are.
    fn is_shifted(&self) -> bool {
        self.memory.offset.iter().any(|&offset| offset != 0.0)
    }

    fn is_plain(&self) -> bool {
        self.calibration.is_empty()
    }

    /// Takes up the recalibrations in the window that ends at `end`, each as if it had come at its start and been as much larger as
    /// a parameter decays until its time.
    fn recalibrate(&mut self, end: Time) -> Result<(), Error> {
        let p = self.calibration.len();
        let mut added = Mat::<f64>::zeros(p, p);
        let Memory { time, offset, prior_mean, .. } = &mut self.memory;
        for it in self.knowledge.recalibrations.iter().filter(|it| *time < it.time && it.time <= end) {
            let larger = 1.0 / self.calibration.parameters[it.parameter].drift.kept(it.time - *time);
            offset[it.parameter] += larger * it.step;
            prior_mean[it.parameter] += larger * it.step;
            added[(it.parameter, it.parameter)] += (larger * it.sigma).powi(2);
        }
        if (0..p).any(|i| added[(i, i)] > 0.0) {
            self.widen(added.as_ref())?;
            *self.memory.prior += added;
        }
        Ok(())
    }

    /// Forecasts what is known without observations; the method does so with c'.
    fn drift(&mut self, window: Duration) {
        let Memory { offset, prior_mean, prior, .. } = &mut self.memory;
        let kept = drift(&self.calibration, window, prior.as_mut());
        multiply(offset, &kept);
        multiply(prior_mean, &kept);
    }

    /// The observations y − G o.
    fn shifted(&self, observed: &ObservationWindow, at: &State) -> ObservationWindow {
        let rows = observed.operator.linearize(at, &self.memory.offset).calibration;
        let mut shifted = observed.clone();
        for (row, value) in shifted.values.iter_mut().enumerate() {
            *value -= rows.row_dot(row, &self.memory.offset);
        }
        shifted.comparisons.iter_mut().for_each(|it| it.value -= it.simulate(&self.memory.offset));
        shifted
    }

    /// Turns the method's estimate of c' into one of c.
    fn report(&mut self, estimate: &mut Estimate) {
        self.memory.estimate.clone_from(&estimate.calibration);
        add(&mut estimate.calibration, &self.memory.offset);
    }

    /// The method's analysis of observations and comparisons.
    fn analyse_own(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        if observed.comparisons.is_empty() || !self.takes_comparisons() {
            return self.method.analyse(from, observed);
        }
        let (n, grid) = (observed.len(), &from.estimate.state.layout().grid);
        let mut analysis = self.method.analyse(from, &observed.with_comparisons_below(grid))?;
        analysis.background_departures.truncate(n);
        let left = analysis.analysis_departures.split_off(n);
        if let Some(chi2) = analysis.innovation_chi2 {
            let claims = self.method.can().calibration.map(|claims| claims.calibration_accuracy());
            analysis.innovation_chi2 = claims.and_then(|claims| Some(chi2 - compared::chi2(&claims, &left, observed)?));
        }
        Ok(analysis)
    }

    /// The analysis, where some parameters are frozen.
    fn analyse_frozen(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let before = self.accuracy()?;
        let estimate = self.memory.estimate.clone();
        let mut analysis = self.analyse_own(from, observed)?;
        let after = self.accuracy()?;
        let frozen = self.memory.frozen.clone();
        let widening = difference(before.covariance(), after.covariance(), |number| frozen[number]);
        self.widen(widening.as_ref())?;
        for number in (0..frozen.len()).filter(|&number| frozen[number]) {
            self.memory.offset[number] -= analysis.estimate.calibration[number] - estimate[number];
            self.memory.would_be[number] = after.covariance()[(number, number)];
            if let Some(spread) = &mut analysis.estimate.calibration_spread {
                spread[number] = before.covariance()[(number, number)].max(0.0).sqrt();
            }
        }
        Ok(analysis)
    }
}

impl Assimilator for Calibrated {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        if self.is_plain() {
            return self.method.forecast(window);
        }
        let end = self.memory.time + window;
        self.recalibrate(end)?;
        self.memory.time = end;
        self.drift(window);
        let mut background = self.method.forecast(window)?;
        self.report(&mut background.estimate);
        Ok(background)
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        if self.is_plain() {
            return self.method.analyse(from, observed);
        }
        // The method's own background is one of c'.
        let shifted = self.is_shifted().then(|| {
            let mut own = from.clone();
            own.estimate.calibration.clone_from(&self.memory.estimate);
            let observed = self.shifted(observed, &own.estimate.state);
            (own, observed)
        });
        let (from, observed) = shifted.as_ref().map_or((from, observed), |(from, observed)| (from, observed));
        let mut analysis = if self.memory.frozen.contains(&true) {
            self.analyse_frozen(from, observed)?
        } else {
            self.analyse_own(from, observed)?
        };
        if self.method.can().smoother.is_some() {
            let lag = self.lag();
            self.memory.past_offsets.push_back(self.memory.offset.clone());
            while self.memory.past_offsets.len() > lag + 1 {
                self.memory.past_offsets.pop_front();
            }
        }
        self.report(&mut analysis.estimate);
        Ok(analysis)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.memory, to)?;
        self.method.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let memory: Memory = read(from)?;
        let p = self.calibration.len();
        let Memory { offset, prior_mean, estimate, frozen, would_be, .. } = &memory;
        let lengths = [offset.len(), prior_mean.len(), estimate.len(), frozen.len(), would_be.len()];
        let past_fits = memory.past_offsets.iter().all(|offset| offset.len() == p);
        let fits = lengths == [p; 5] && memory.prior.has_shape(p, p) && past_fits;
        require(fits, "the knowledge of the sensors")?;
        self.memory = memory;
        self.method.recall(from)
    }

    fn can(&self) -> Views<'_> {
        let views = self.method.can();
        Views {
            smoother: views.smoother.map(|_| self as &dyn Smoother),
            root: views.root.map(|_| self as &dyn CovarianceRoot),
            ..views
        }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        let Adjustments { calibration, error_factor } = self.method.adjust();
        // To replace it would be to replace c', which nobody else knows.
        let calibration = calibration.map(|calibration| match calibration {
            CalibrationAdjustment::Replace(method) => CalibrationAdjustment::Widen(method),
            widen => widen,
        });
        Adjustments { calibration, error_factor }
    }
}

impl Smoother for Calibrated {
    fn lag(&self) -> usize {
        self.method.can().smoother.map_or(0, |smoother| smoother.lag())
    }

    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        let Some(smoother) = self.method.can().smoother else { return Ok(None) };
        let mut smoothed = smoother.smoothed(analyses_ago)?;
        let offset = self.memory.past_offsets.iter().rev().nth(analyses_ago);
        if let (Some(estimate), Some(offset)) = (&mut smoothed, offset) {
            add(&mut estimate.calibration, offset);
        }
        Ok(smoothed)
    }
}

/// `wide − narrow` on the chosen parameters, zero elsewhere; what is negative in it by rounding is left out.
fn difference(wide: MatRef<'_, f64>, narrow: MatRef<'_, f64>, chosen: impl Fn(usize) -> bool) -> Mat<f64> {
    let p = wide.nrows();
    let difference =
        Mat::from_fn(p, p, |i, j| if chosen(i) && chosen(j) { wide[(i, j)] - narrow[(i, j)] } else { 0.0 });
    let (values, vectors) = eigen(difference.as_ref());
    let scaled = Mat::from_fn(p, p, |i, j| vectors[(i, j)] * values[j].max(0.0));
    let mut widening = Mat::zeros(p, p);
    add_symmetric_product(widening.as_mut(), 1.0, scaled.as_ref(), vectors.transpose());
    widening
}
