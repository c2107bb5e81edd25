//! The federated Kalman filter: a local filter for each observing system, and a master that fuses them.

mod fusion;
mod system;

use crate::assimilator::{Adjustments, Assimilator, CalibrationAdjustment, Views, WidenCalibration};
use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::dense::KalmanFilter;
use crate::estimate::{Analysis, Background, Estimate};
use crate::innovation_covariance::InnovationCovariance;
use crate::memory::{from_bytes, require, to_bytes};
use crate::problem::{Innovations, Problem};
use crate::propagator::Propagator;
use faer::MatRef;
use fusion::Fused;
use isobar_model::{Duration, Model, TangentLinear};
use isobar_obs::{Calibration, ObservationWindow};
use rayon::prelude::*;
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
/// It costs as many Kalman filters as there are systems, and two fusions. Covariances between the biases of different
/// systems that a prior, or frozen biases, may have cannot be represented, and are refused.
#[derive(Clone)]
pub struct FederatedKalmanFilter {
    filters: Filters,
    reset_every_cycles: Option<usize>,
    /// Analyses so far.
    cycle: usize,
    /// The factor of Q in all local filters.
    error_factor: f64,
}

/// The local filters and their master.
#[derive(Clone)]
struct Filters {
    /// The fused estimate of x and all biases. It forecasts nothing.
    master: KalmanFilter,
    local: Vec<LocalFilter>,
}

/// A correlation below this is rounding.
const ROUNDING: f64 = 1e-9;

#[derive(Clone)]
struct LocalFilter {
    system: String,
    /// β.
    share: f64,
    /// The numbers of its biases among all, ascending.
    parameters: Vec<usize>,
    filter: KalmanFilter,
}

impl FederatedKalmanFilter {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit; [`Error::Setting`] for a bias of no
    /// system, for biases of two systems whose priors are correlated, and for shares that do not sum to 1.
    pub fn new(problem: impl Into<Problem<dyn TangentLinear>>, settings: FederatedSettings) -> Result<Self, Error> {
        let problem = problem.into();
        if settings.systems.is_empty() {
            return Err(Error::Setting("a federated filter needs an observing system".into()));
        }
        let total: f64 = settings.systems.iter().map(|(_, share)| share).sum();
        if settings.systems.iter().any(|(_, share)| *share <= 0.0) || (total - 1.0).abs() > 1e-9 {
            let message = format!("the information-sharing factors must be positive and sum to 1, but sum to {total}");
            return Err(Error::Setting(message));
        }
        let parameters = biases_of_systems(&problem.calibration, &settings.systems)?;
        let sizes = parameters.iter().map(Vec::len);
        check_memory(&problem.clone().into(), sizes, problem.most_observations)?;
        let local = settings.systems.into_iter().zip(parameters).map(|((system, share), parameters)| {
            let own = parameters.iter().map(|&number| problem.calibration.parameters[number].clone()).collect();
            let within = |&(i, j): &(usize, usize)| {
                Some((parameters.binary_search(&i).ok()?, parameters.binary_search(&j).ok()?))
            };
            let covariances = problem.calibration.covariances.iter();
            let covariances = covariances.filter_map(|(pair, value)| Some((within(pair)?, *value))).collect();
            let calibration = Calibration { parameters: own, covariances };
            // All together have been found to fit.
            let problem = Problem { calibration, most_observations: 0, ..problem.clone() };
            let filter = KalmanFilter::with_inflated_errors(problem, 1.0 / share, false)?;
            Ok(LocalFilter { system, share, parameters, filter })
        });
        let local = local.collect::<Result<_, Error>>()?;
        let master = KalmanFilter::new(Problem { model_error: None, most_observations: 0, ..problem })?;
        let filters = Filters { master, local };
        Ok(Self { filters, reset_every_cycles: settings.reset_every_cycles, cycle: 0, error_factor: 1.0 })
    }

    /// The fused covariance of the errors of (x, c), `[m + p, m + p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.filters.master.covariance()
    }
}

impl Filters {
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

    /// Fuses the local estimates into the master's.
    fn fuse(&mut self) -> Result<(), Error> {
        let m = self.master.belief.s.state.values().len();
        let (first, rest) = self.local.split_first().expect("there is a system at least");
        let mut fused = Fused::from(&first.filter);
        for local in rest {
            fused.fuse(&local.filter)?;
        }
        // The biases stand there system after system.
        let order: Vec<usize> = match self.master.covariance().nrows() - m {
            0 => (0..m).collect(),
            _ => (0..m).chain(self.local.iter().flat_map(|it| &it.parameters).map(|number| m + number)).collect(),
        };
        fused.store(&order, &mut self.master);
        Ok(())
    }

    /// Divides the master's estimate among the local filters.
    fn reset(&mut self) -> Result<(), Error> {
        let given_state = fusion::explained_by_state(&self.master)?;
        for local in &mut self.local {
            let biases: &[usize] = if given_state.nrows() == 0 { &[] } else { &local.parameters };
            fusion::divide(&self.master, given_state.as_ref(), local.share, biases, &mut local.filter);
        }
        Ok(())
    }
}

impl Assimilator for FederatedKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        let (factor, filters) = (self.error_factor, &mut self.filters);
        let forecast = |local: &mut LocalFilter| {
            if let Some(own) = local.filter.adjust().error_factor {
                *own = factor;
            }
            local.filter.forecast(window)
        };
        let forecasts: Vec<_> = filters.local.par_iter_mut().map(forecast).collect();
        forecasts.into_iter().try_for_each(|forecast| forecast.map(drop))?;
        filters.fuse()?;
        Ok(Background { estimate: filters.estimate()?, window })
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let filters = &mut self.filters;
        let sizes = filters.local.iter().map(|local| local.parameters.len());
        check_memory(&filters.master.problem, sizes, observed.len())?;
        let Augmented { state, bias } = &filters.master.belief.s;
        let innovations = filters.master.problem.innovations(observed, state, bias)?;
        let covariance = InnovationCovariance::new(filters.master.covariance(), &innovations)?;
        let innovation_chi2 = covariance.normalised_square(&innovations.departures);
        let rows = filters.rows(observed, &innovations)?;
        let all = bias.len();
        let analyses: Vec<_> = filters
            .local
            .par_iter_mut()
            .zip(rows)
            .map(|(local, rows)| local.filter.analyse(from, &observations_of(observed, rows, &local.parameters, all)))
            .collect();
        analyses.into_iter().try_for_each(|analysis| analysis.map(drop))?;
        filters.fuse()?;
        self.cycle += 1;
        // One filter has nothing to share.
        let is_due = self.reset_every_cycles.is_some_and(|cycles| self.cycle.is_multiple_of(cycles));
        if is_due && filters.local.len() > 1 {
            filters.reset()?;
        }
        let estimate = filters.estimate()?;
        filters.master.problem.resolved_analysis(observed, innovations, estimate, innovation_chi2)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn memory(&self) -> Result<Vec<u8>, Error> {
        let Filters { master, local } = &self.filters;
        let local = local.iter().map(|local| local.filter.memory()).collect::<Result<Vec<_>, _>>()?;
        to_bytes(&(master.memory()?, local, self.cycle))
    }

    fn recall(&mut self, memory: &[u8]) -> Result<(), Error> {
        let (master, local, cycle): (Vec<u8>, Vec<Vec<u8>>, usize) = from_bytes(memory)?;
        require(local.len() == self.filters.local.len(), "the number of local filters")?;
        self.filters.master.recall(&master)?;
        self.filters.local.iter_mut().zip(&local).try_for_each(|(local, memory)| local.filter.recall(memory))?;
        self.cycle = cycle;
        Ok(())
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

impl WidenCalibration for Filters {
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

/// `parameters` are the numbers of biases of the systems.
fn check_memory(
    problem: &Problem<dyn Model>,
    parameters: impl ExactSizeIterator<Item = usize>,
    observations: usize,
) -> Result<(), Error> {
    let m = problem.background.values().len();
    let (systems, n) = (parameters.len(), observations as f64);
    let of_filter = |size: f64| 2.0 * size * size + Propagator::numbers(size);
    let filters: f64 = parameters.map(|own| of_filter((m + own) as f64)).sum();
    let master = (m + problem.calibration.len()) as f64;
    // Covariance, model error, propagator and twice a band for each, the master and what it fuses; for the innovations those
    // of the master and those of all local filters.
    let numbers = filters + 5.0 * master * master + 4.0 * master * n + 2.0 * n * n;
    problem.require_memory(numbers, || {
        format!("{systems} dense Kalman filters for {m} values each and {observations} observations, and their fusion")
    })
}
