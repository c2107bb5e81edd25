//! The federated Kalman filter: a local filter for each observing system, and a master that fuses them.

mod blocks;
mod dense;
mod system;

use crate::assimilator::{Adjustments, Assimilator, CalibrationAdjustment, Views, WidenCalibration};
use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::blocks::BlockErrors;
use crate::errors::dense::Dense;
use crate::estimate::{Analysis, Background, Estimate};
use crate::filter::{Errors, Filter};
use crate::memory::{read, require, write};
use crate::problem::{Innovations, Problem};
use faer::MatRef;
use isobar_model::{Duration, TangentLinear};
use isobar_obs::{Calibration, ObservationWindow};
use rayon::prelude::*;
use std::io::{Read, Write};
use system::observations_of;

/// How the filter is divided.
#[derive(Clone, Debug, PartialEq)]
pub struct FederatedSettings {
    /// The observing systems, each with its information-sharing factor β > 0; the factors sum to 1.
    pub systems: Vec<(String, f64)>,
    /// Number of cycles after which the local filters are given what the master has fused; `None` for never.
    pub reset_every_cycles: Option<usize>,
}

/// The decentralised filter of WO 90/13794, fig. 2 (Carlson 1990, Federated square root filter for decentralized parallel
/// processes, IEEE Trans. Aerosp. Electron. Syst. 26, 517–525). The local filter i sees the observations of one observing
/// system alone, and estimates the state x and that system's biases `c_i`. Its prior and its model error are inflated,
///
/// ```text
/// P_i(0) = P(0)/β_i,    Q_i = Q/β_i,    Σ β_i = 1,
/// ```
///
/// for then errors that are common to all local filters, being fully correlated between them, are bounded by errors that
/// are independent: `1 1ᵀ ⊗ P ≤ diag(P/β_i)`. The master fuses the local estimates as if they were,
///
/// ```text
/// P⁻¹ = Σ P_i⁻¹,    x̂ = P Σ P_i⁻¹ x̂_i
/// ```
///
/// in gain form, with the biases going along by their regression on the state (`fusion`). So the covariance that it claims
/// is never less than that of its actual errors where model and observations are linear, and therefore never less than that
/// of the centralised Kalman filter.
///
/// *Reset.* The local filters get back x̂ with P/β_i, and each `c_i` given x stays what it was. After every analysis
/// this loses nothing of a state without biases: the filter equals the centralised one (WO 90/13794, p. 14). With biases
/// it forgets what model error lets the biases of different systems have in common, given the state. Without reset the
/// local filters weigh old observations with their own inflated Q: equal to the centralised filter without model error.
///
/// It costs as many filters as there are systems, and two fusions. Covariances between the biases of different systems that a
/// prior, or frozen biases, may have cannot be represented, and are refused.
///
/// `E` is the form of the errors' covariances: [`FederatedKalmanFilter`], [`FederatedFastKalmanFilter`].
#[derive(Clone)]
pub struct FederatedFilter<E> {
    filters: Filters<E>,
    reset_every_cycles: Option<usize>,
    /// Analyses so far.
    cycle: usize,
    /// The factor of Q in all local filters.
    error_factor: f64,
}

/// The federated filter of dense Kalman filters.
pub type FederatedKalmanFilter = FederatedFilter<Dense>;

/// The federated filter of Fast Kalman Filters, with the biases of each system as shared parameters, wherever they belong.
/// Its covariances are fused without a dense one: see `errors::blocks::fusion`. With one block, or as many factors as unknowns,
/// it is that of dense filters; with one system it is that system's filter.
pub type FederatedFastKalmanFilter = FederatedFilter<BlockErrors>;

/// A form of the errors in which estimates can be fused, and their fusion be divided.
trait Fusible: Errors {
    /// Fuses the local estimates into the master's.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if a covariance has lost its meaning.
    fn fuse(filters: &mut Filters<Self>) -> Result<(), Error>;

    /// Divides the master's estimate among the local filters: see [`FederatedFilter`].
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if a covariance has lost its meaning.
    fn divide(filters: &mut Filters<Self>) -> Result<(), Error>;

    /// dᵀ (H P Hᵀ + R)⁻¹ d with the master's P.
    ///
    /// # Errors
    /// Those of an analysis.
    fn normalised_square(master: &Filter<Self>, innovations: &Innovations) -> Result<f64, Error>;

    /// Fails unless there is memory for all filters and for the analysis of this number of observations.
    ///
    /// # Errors
    /// [`Error::TooLarge`].
    fn require_memory_of(filters: &Filters<Self>, observations: usize) -> Result<(), Error>;
}

/// The local filters and their master.
#[derive(Clone)]
struct Filters<E> {
    /// The fused estimate of x and all biases. It forecasts nothing.
    master: Filter<E>,
    local: Vec<LocalFilter<E>>,
}

/// A correlation below this is rounding.
const ROUNDING: f64 = 1e-9;

#[derive(Clone)]
struct LocalFilter<E> {
    system: String,
    /// β.
    share: f64,
    /// The numbers of its biases among all, ascending.
    parameters: Vec<usize>,
    filter: Filter<E>,
}

/// A problem of one observing system, or of the master, whose state's errors at the start and model errors are to be
/// multiplied by a factor.
struct Part {
    problem: Problem<dyn TangentLinear>,
    factor: f64,
}

/// The filters of all systems, each made by `build`, and their master.
///
/// # Errors
/// [`Error::Setting`] for a bias of no system, for biases of two systems whose priors are correlated, and for shares that do
/// not sum to 1; those of `build`.
fn filters<E>(
    problem: &Problem<dyn TangentLinear>,
    systems: &[(String, f64)],
    build: impl Fn(Part) -> Result<Filter<E>, Error>,
) -> Result<Filters<E>, Error> {
    let local =
        systems.iter().zip(biases_of_systems(&problem.calibration, systems)?).map(|((system, share), numbers)| {
            let own = numbers.iter().map(|&number| problem.calibration.parameters[number].clone()).collect();
            let within =
                |&(i, j): &(usize, usize)| Some((numbers.binary_search(&i).ok()?, numbers.binary_search(&j).ok()?));
            let covariances = problem.calibration.covariances.iter();
            let covariances = covariances.filter_map(|(pair, value)| Some((within(pair)?, *value))).collect();
            let calibration = Calibration { parameters: own, covariances };
            // All together have been found to fit.
            let problem = Problem { calibration, most_observations: 0, ..problem.clone() };
            let filter = build(Part { problem, factor: 1.0 / share })?;
            Ok(LocalFilter { system: system.clone(), share: *share, parameters: numbers, filter })
        });
    let local = local.collect::<Result<_, Error>>()?;
    let master = Problem { model_error: None, most_observations: 0, ..problem.clone() };
    Ok(Filters { master: build(Part { problem: master, factor: 1.0 })?, local })
}

impl<E> FederatedFilter<E> {
    fn of(filters: Filters<E>, reset_every_cycles: Option<usize>) -> Self {
        Self { filters, reset_every_cycles, cycle: 0, error_factor: 1.0 }
    }
}

impl FederatedSettings {
    /// Fails for shares that make no sense.
    ///
    /// # Errors
    /// [`Error::Setting`].
    fn check(&self) -> Result<(), Error> {
        if self.systems.is_empty() {
            return Err(Error::Setting("a federated filter needs an observing system".into()));
        }
        let total: f64 = self.systems.iter().map(|(_, share)| share).sum();
        if self.systems.iter().any(|(_, share)| *share <= 0.0) || (total - 1.0).abs() > 1e-9 {
            let message = format!("the information-sharing factors must be positive and sum to 1, but sum to {total}");
            return Err(Error::Setting(message));
        }
        Ok(())
    }
}

impl<E: Errors> Filters<E> {
    /// The fused estimate.
    fn estimate(&self) -> Result<Estimate, Error> {
        self.master.belief.estimate(&self.master.calibration)
    }

    /// The observations of each local filter, by number.
    fn rows(&self, observed: &ObservationWindow, innovations: &Innovations) -> Result<Vec<Vec<usize>>, Error> {
        let mut rows = vec![Vec::new(); self.local.len()];
        for (row, report) in observed.reports.iter().enumerate() {
            let found = self.local.iter().position(|local| *local.system == *report.network);
            let Some(number) = found else {
                return Err(Error::Setting(format!("there is no local filter for the network {}", report.network)));
            };
            let own = &self.local[number].parameters;
            let read = innovations.jacobian.calibration.row(row);
            if let Some(&(parameter, _)) = read.iter().find(|(parameter, _)| own.binary_search(parameter).is_err()) {
                let name = &self.master.problem.calibration.parameters[parameter].name;
                let message = format!("an observation of {} has the bias {name} of another system", report.network);
                return Err(Error::Setting(message));
            }
            rows[number].push(row);
        }
        Ok(rows)
    }
}

impl<E: Fusible> Assimilator for FederatedFilter<E> {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        let (factor, filters) = (self.error_factor, &mut self.filters);
        let forecast = |local: &mut LocalFilter<E>| {
            if let Some(own) = local.filter.adjust().error_factor {
                *own = factor;
            }
            local.filter.forecast(window)
        };
        let forecasts: Vec<_> = filters.local.par_iter_mut().map(forecast).collect();
        forecasts.into_iter().try_for_each(|forecast| forecast.map(drop))?;
        filters.master.belief.s.state.advance(window);
        E::fuse(filters)?;
        Ok(Background { estimate: filters.estimate()?, window })
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let filters = &mut self.filters;
        E::require_memory_of(filters, observed.len())?;
        let Augmented { state, bias } = &filters.master.belief.s;
        let innovations = filters.master.problem.innovations(observed, state, bias)?;
        let innovation_chi2 = E::normalised_square(&filters.master, &innovations)?;
        let rows = filters.rows(observed, &innovations)?;
        let all = bias.len();
        let analyses: Vec<_> = filters
            .local
            .par_iter_mut()
            .zip(rows)
            .map(|(local, rows)| local.filter.analyse(from, &observations_of(observed, rows, &local.parameters, all)))
            .collect();
        analyses.into_iter().try_for_each(|analysis| analysis.map(drop))?;
        E::fuse(filters)?;
        self.cycle += 1;
        // One filter has nothing to share.
        let is_due = self.reset_every_cycles.is_some_and(|cycles| self.cycle.is_multiple_of(cycles));
        if is_due && filters.local.len() > 1 {
            E::divide(filters)?;
        }
        let estimate = filters.estimate()?;
        filters.master.problem.resolved_analysis(observed, innovations, estimate, innovation_chi2)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        let Filters { master, local } = &self.filters;
        write(&(local.len(), self.cycle), to)?;
        master.save(to)?;
        local.iter().try_for_each(|local| local.filter.save(to))
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let (count, cycle): (usize, usize) = read(from)?;
        let Filters { master, local } = &mut self.filters;
        require(count == local.len(), "the number of local filters")?;
        self.cycle = cycle;
        master.recall(from)?;
        local.iter_mut().try_for_each(|local| local.filter.recall(from))
    }

    fn can(&self) -> Views<'_> {
        self.filters.master.can()
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        let estimates = self.can().calibration.is_some();
        Adjustments {
            calibration: estimates.then_some(CalibrationAdjustment::Widen(&mut self.filters)),
            error_factor: Some(&mut self.error_factor),
        }
    }
}

impl<E: Errors> WidenCalibration for Filters<E> {
    /// Each local filter takes the covariance of its own biases, so that the fused one is wider by just that. For a
    /// covariance between biases of two systems there is no place, and it is refused; recalibrations have none.
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let p = covariance.nrows();
        let mut system_of = vec![0; p];
        for (number, local) in self.local.iter().enumerate() {
            local.parameters.iter().for_each(|&parameter| system_of[parameter] = number);
        }
        let is_between = |i: usize, j: usize| {
            let largest = (covariance[(i, i)] * covariance[(j, j)]).max(0.0).sqrt();
            system_of[i] != system_of[j] && covariance[(i, j)].abs() > ROUNDING * largest
        };
        if let Some((i, j)) = (0..p).flat_map(|i| (0..i).map(move |j| (i, j))).find(|&(i, j)| is_between(i, j)) {
            let name = |number: usize| &self.master.problem.calibration.parameters[number].name;
            return Err(Error::Setting(format!(
                "local filters of two systems cannot represent a covariance between the biases {} and {}",
                name(j),
                name(i)
            )));
        }
        for local in &mut self.local {
            let own = &local.parameters;
            let covariance = faer::Mat::from_fn(own.len(), own.len(), |i, j| covariance[(own[i], own[j])]);
            local.filter.belief.widen_calibration(covariance.as_ref())?;
        }
        self.master.belief.widen_calibration(covariance)
    }
}

/// The numbers of each system's biases, which are called `system/…`.
fn biases_of_systems(calibration: &Calibration, systems: &[(String, f64)]) -> Result<Vec<Vec<usize>>, Error> {
    let system_of = |number: usize| {
        let name = &calibration.parameters[number].name;
        let system = name.split('/').next().unwrap_or_default();
        let found = systems.iter().position(|(own, _)| own == system);
        found.ok_or_else(|| Error::Setting(format!("the bias {name} is of no observing system")))
    };
    let mut numbers = vec![Vec::new(); systems.len()];
    for number in 0..calibration.len() {
        numbers[system_of(number)?].push(number);
    }
    for (&(i, j), &covariance) in &calibration.covariances {
        if covariance != 0.0 && system_of(i)? != system_of(j)? {
            let name = |number: usize| &calibration.parameters[number].name;
            return Err(Error::Setting(format!(
                "the biases {} and {} are known to be correlated, which local filters of two systems cannot represent",
                name(i),
                name(j)
            )));
        }
    }
    Ok(numbers)
}
