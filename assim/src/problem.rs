//! What every method is given at its start, and the innovations it computes from a window of observations.

use crate::covariance::Covariance;
use crate::error::Error;
use crate::estimate::{Analysis, Estimate};
use isobar_model::{Adjoint, Bands, Duration, Model, State, TangentLinear};
use isobar_obs::{Calibration, Jacobian, ObservationWindow, SparseRows};
use std::sync::Arc;

/// How a method treats the observations' biases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasTreatment {
    /// The calibration parameters are estimated with the state.
    Estimate,
    /// Biased observations are taken as they are.
    Ignore,
    /// The method is given observations from which the true biases have been removed.
    Known,
}

/// An assimilation problem: everything that a method may know. The truth is not part of it.
///
/// `M` is what the forecast model can do. A constructor asks for what its method needs: an ensemble for a
/// `Problem<dyn Model>`, a Kalman filter for a `Problem<dyn TangentLinear>`, 4D-Var for a `Problem<dyn Adjoint>`; the one
/// that can do more converts into the one that can do less.
pub struct Problem<M: ?Sized = dyn Adjoint> {
    /// The forecast model.
    pub model: Arc<M>,
    /// The background at the start, with its valid time.
    pub background: State,
    /// Covariance of its error.
    pub background_error: Arc<dyn Covariance>,
    /// Covariance of the model error that a cycle adds; `None` for a perfect model.
    pub model_error: Option<Arc<dyn Covariance>>,
    /// The calibration parameters, with prior mean zero.
    pub calibration: Calibration,
    /// What becomes of the biases.
    pub bias: BiasTreatment,
    /// The most memory that the method may use \[bytes\].
    pub memory_limit_bytes: u64,
    /// The most observations that there will be in a cycle: a method that could not hold them is refused at the start.
    pub most_observations: usize,
}

impl<M: ?Sized> Clone for Problem<M> {
    fn clone(&self) -> Self {
        Self {
            model: Arc::clone(&self.model),
            background: self.background.clone(),
            background_error: Arc::clone(&self.background_error),
            model_error: self.model_error.clone(),
            calibration: self.calibration.clone(),
            bias: self.bias,
            memory_limit_bytes: self.memory_limit_bytes,
            most_observations: self.most_observations,
        }
    }
}

impl<M: ?Sized> Problem<M> {
    /// The same problem with another model of the same states.
    pub fn with_model<N: ?Sized>(self, model: Arc<N>) -> Problem<N> {
        let Self {
            background,
            background_error,
            model_error,
            calibration,
            bias,
            memory_limit_bytes,
            most_observations,
            ..
        } = self;
        Problem {
            model,
            background,
            background_error,
            model_error,
            calibration,
            bias,
            memory_limit_bytes,
            most_observations,
        }
    }
}

impl From<Problem<dyn Adjoint>> for Problem<dyn TangentLinear> {
    fn from(problem: Problem<dyn Adjoint>) -> Self {
        let model: Arc<dyn TangentLinear> = problem.model.clone();
        problem.with_model(model)
    }
}

impl From<Problem<dyn Adjoint>> for Problem<dyn Model> {
    fn from(problem: Problem<dyn Adjoint>) -> Self {
        let model: Arc<dyn Model> = problem.model.clone();
        problem.with_model(model)
    }
}

impl From<Problem<dyn TangentLinear>> for Problem<dyn Model> {
    fn from(problem: Problem<dyn TangentLinear>) -> Self {
        let model: Arc<dyn Model> = problem.model.clone();
        problem.with_model(model)
    }
}

impl<M: ?Sized> Problem<M> {
    /// The calibration parameters that the method estimates: all or none.
    pub(crate) fn estimated_calibration(&self) -> Calibration {
        match self.bias {
            BiasTreatment::Estimate => self.calibration.clone(),
            BiasTreatment::Ignore | BiasTreatment::Known => Calibration::default(),
        }
    }

    /// Fails if several ranks compute the run, and not each has everything.
    ///
    /// # Errors
    /// [`Error::Setting`] that names what they cannot divide.
    pub(crate) fn require_one_rank(&self, what: &str) -> Result<(), Error>
    where
        M: Model,
    {
        match self.model.in_bands() {
            None => Ok(()),
            Some(_) => Err(Error::Setting(format!("{what} cannot be computed by several ranks together"))),
        }
    }

    /// Which rank has which rows of what is divided among them.
    pub(crate) fn bands(&self) -> Bands
    where
        M: Model,
    {
        match self.model.in_bands() {
            None => Bands::whole(&self.background.layout().grid),
            Some(model) => model.bands().clone(),
        }
    }

    /// Which part of what is divided among ranks this one has: all, if there are no others.
    pub(crate) fn share(&self) -> f64
    where
        M: Model,
    {
        self.model.in_bands().map_or(1.0, |model| 1.0 / model.bands().communicator().ranks() as f64)
    }

    /// Fails if the numbers in double precision that `what` has to hold at one time need more memory than is allowed.
    /// They are counted as a float, which does not overflow.
    ///
    /// # Errors
    /// [`Error::TooLarge`].
    pub fn require_memory(&self, numbers: f64, what: impl FnOnce() -> String) -> Result<(), Error> {
        require_memory(self.memory_limit_bytes, numbers, what)
    }

    /// Innovations about an estimate; `calibration` holds all parameters of the experiment.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if a departure is not finite.
    pub(crate) fn innovations(
        &self,
        observed: &ObservationWindow,
        state: &State,
        calibration: &[f64],
    ) -> Result<Innovations, Error> {
        let mut jacobian = observed.operator.linearize(state, calibration);
        if self.bias != BiasTreatment::Estimate {
            jacobian.calibration = SparseRows::new();
            (0..observed.len()).for_each(|_| jacobian.calibration.push_row([]));
        }
        let departures = self.departures(observed, state, calibration);
        require_finite(&departures, observed)?;
        let variance = observed.sigma.iter().map(|sigma| sigma * sigma).collect();
        Ok(Innovations { departures, jacobian, variance, state_values: state.values().len() })
    }

    /// y − h(x, c).
    pub(crate) fn departures(&self, observed: &ObservationWindow, state: &State, calibration: &[f64]) -> Vec<f64> {
        let simulated = observed.operator.simulate(state, calibration);
        observed.values.iter().zip(simulated).map(|(value, simulated)| value - simulated).collect()
    }

    /// What an analysis did with `observed`, from the innovations that it began with and the estimate that it came to.
    pub(crate) fn analysis(
        &self,
        observed: &ObservationWindow,
        innovations: Innovations,
        estimate: Estimate,
        innovation_chi2: impl Into<Option<f64>>,
    ) -> Analysis {
        let analysis_departures = self.departures(observed, &estimate.state, &estimate.calibration);
        Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: innovation_chi2.into(),
            partition: None,
            warnings: Vec::new(),
        }
    }

    /// [`Problem::analysis`] of a method that holds covariances as sums: H P Hᵀ + R, or I + Lᵀ Hᵀ R⁻¹ H L.
    ///
    /// With s² a diagonal entry of H P Hᵀ, rounding changes H P Hᵀ by ε s², and the analysis at the observations by
    /// δ(H x) ≈ (H K) δ(H P Hᵀ) z, where z = (H P Hᵀ + R)⁻¹ d = R⁻¹ (y − H x_a). As |H K| ≤ 1, the analysis is uncertain by
    /// ε s² |y − H x_a|/σ². That matters where observations whose σ is beyond rounding contradict each other: of two, 1 ± σ
    /// and 2 ± σ, nothing is left in the sums to show that both count the same.
    ///
    /// # Errors
    /// [`Error::Unresolved`] where this exceeds 10⁻⁶ of s and of the background's departure. s is that of B, which bounds the method's from above but for errors
    /// that grow; what is left of an observation that is fitted to 10⁻⁶ s is no contradiction.
    pub(crate) fn resolved_analysis(
        &self,
        observed: &ObservationWindow,
        innovations: Innovations,
        estimate: Estimate,
        innovation_chi2: impl Into<Option<f64>>,
    ) -> Result<Analysis, Error> {
        const TOLERANCE: f64 = 1e-6;
        let (jacobian, variance) = (innovations.jacobian.clone(), innovations.variance.clone());
        let analysis = self.analysis(observed, innovations, estimate, innovation_chi2);
        for (row, (departure, variance)) in analysis.analysis_departures.iter().zip(variance).enumerate() {
            // Nothing else can exceed the tolerance by both measures, and B is asked of these few alone.
            if departure * departure < variance * TOLERANCE.powi(2) / f64::EPSILON {
                continue;
            }
            let of_state = jacobian.state.row(row).iter();
            let of_state = of_state.map(|&(i, weight)| weight.abs() * self.background_error.covariance(i, i).sqrt());
            let of_biases = jacobian.calibration.row(row).iter();
            let of_biases = of_biases.map(|&(i, weight)| weight.abs() * self.calibration.prior_covariance(i, i).sqrt());
            let spread = of_state.sum::<f64>() + of_biases.sum::<f64>();
            let uncertainty = f64::EPSILON * spread * spread * departure.abs() / variance;
            let scale = spread.max(analysis.background_departures[row].abs());
            if uncertainty > TOLERANCE * scale && departure.abs() > TOLERANCE * spread {
                let report = &observed.reports[row];
                return Err(Error::Unresolved {
                    observation: format!("{}/{}", report.network, report.platform),
                    departure: *departure,
                    sigma: variance.sqrt(),
                    spread,
                });
            }
        }
        Ok(analysis)
    }

    /// An estimate that takes no notice of `observed`.
    pub(crate) fn unchanged(&self, observed: &ObservationWindow, estimate: Estimate) -> Analysis {
        let departures = self.departures(observed, &estimate.state, &estimate.calibration);
        Analysis {
            estimate,
            background_departures: departures.clone(),
            analysis_departures: departures,
            innovation_chi2: None,
            partition: None,
            warnings: Vec::new(),
        }
    }
}

/// Fails if this number of values in double precision needs more memory than is allowed.
///
/// # Errors
/// [`Error::TooLarge`].
pub(crate) fn require_memory(limit_bytes: u64, numbers: f64, what: impl FnOnce() -> String) -> Result<(), Error> {
    let needed_bytes = (8.0 * numbers) as u64;
    if needed_bytes <= limit_bytes {
        return Ok(());
    }
    Err(Error::TooLarge { what: what(), needed_bytes, limit_bytes })
}

/// The time steps of a forecast over `window`.
///
/// # Errors
/// [`Error::Setting`] if they are not a whole number.
pub(crate) fn steps(model: &(impl Model + ?Sized), window: Duration) -> Result<usize, Error> {
    let step = model.time_step();
    window
        .steps_of(step)
        .ok_or_else(|| Error::Setting(format!("the window of {window} is not a whole number of time steps of {step}")))
}

/// Fails at the first departure that is not finite.
///
/// # Errors
/// [`Error::NotFinite`] with its network and platform.
pub(crate) fn require_finite(departures: &[f64], observed: &ObservationWindow) -> Result<(), Error> {
    let Some(row) = departures.iter().position(|departure| !departure.is_finite()) else { return Ok(()) };
    let report = &observed.reports[row];
    Err(Error::NotFinite { what: format!("the innovation of {}/{}", report.network, report.platform) })
}

/// The observations of a cycle as seen from an estimate.
pub(crate) struct Innovations {
    /// d = y − h(x, c), `[n]`.
    pub departures: Vec<f64>,
    /// H = (X, G), `[n, m + p]`.
    pub jacobian: Jacobian,
    /// The diagonal of R, `[n]`.
    pub variance: Vec<f64>,
    /// m, the number of values of the state.
    pub state_values: usize,
}

impl Innovations {
    /// n.
    pub fn len(&self) -> usize {
        self.departures.len()
    }

    /// The entries of a row of H on the augmented state (x, c).
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, f64)> {
        entries(&self.jacobian, row, self.state_values)
    }

    /// R^-½ dy.
    pub fn whiten(&self, mut dy: Vec<f64>) -> Vec<f64> {
        dy.iter_mut().zip(&self.variance).for_each(|(value, variance)| *value /= variance.sqrt());
        dy
    }
}

/// The entries of a row of H = (X, G) on the augmented state, whose first `m` values are the state's.
pub(crate) fn entries(jacobian: &Jacobian, row: usize, m: usize) -> impl Iterator<Item = (usize, f64)> {
    let state = jacobian.state.row(row).iter().copied();
    state.chain(jacobian.calibration.row(row).iter().map(move |&(parameter, weight)| (m + parameter, weight)))
}
