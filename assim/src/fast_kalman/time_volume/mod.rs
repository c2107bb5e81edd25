//! The moving time volume: unknowns that are constant over the last L cycles, with the Fast Kalman Filter within each.
//!
//! ```text
//! y_{t-l} = H s_{t-l} + F^y_{t-l} C + e,     s_{t-l} = A s_{t-l-1} + F^s_{t-l} C + M(s_{t-l-1}) r + a
//! ```
//!
//! (WO 97/18442, eqs. (21)–(25)). The blocks are time steps, each of them block-angular in space; the border is C, with the
//! state-transition corrections r among it. What makes the time blocks independent of each other given C, as the form
//! needs them, is to refer each forecast to the C that was believed when it was made, and to carry on how it would have
//! been with another, the sensitivities U = ∂(b, c)/∂C:
//!
//! ```text
//! forecast   U ← A U + [F^s M(s)]
//! analysis   d = y − H s~,   G = H U + F^y,   U ← U − K G,   J = G' T^-1 G,   j = G' T^-1 d,   T = H P H' + R
//! window     Ĉ = (V_0^-1 + Σ_l J_{t-l})^-1 (V_0^-1 y_0 + Σ_l j_{t-l}),   S = Cov(Ĉ) the inverse there
//! state      ŝ(Ĉ) = ŝ(C_0) + U (Ĉ − C_0),   Cov(ŝ) = P + U S U'
//! ```
//!
//! With P the covariance given C, d is white in time for the true C, so that Ĉ with no prior is the least-squares solution
//! of all cycles of the window at once, and with the prior row carried along, L = 1 is the recursion (Friedland 1969, with
//! the sums in the place of his covariance). After every analysis the reference C_0 is moved to Ĉ, which changes nothing
//! for a linear model and linearises a nonlinear one about the best there is.
//!
//! Amplitudes that are a random walk or an AR(1) process cannot be constant over a window: they are unknowns of each cycle
//! beside the calibration parameters, and common factors carry their covariance with the state.

mod factor;
mod query;
mod report;
mod restart;
mod rows;
mod saved;
mod select;
mod transition;
mod window;

pub use factor::{AmplitudeEvolution, Factor, Target, TimeShape};
pub use transition::{Candidate, Corrections};

use super::factors::Factors;
use super::free_columns::FreeColumns;
use super::{BiasCoupling, FastKalmanFilter, FastKalmanSettings};
use crate::assimilator::{Analysis, Assimilator, BiasTreatment, Estimate};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::estimated::EstimatedParameter;
use crate::problem::Problem;
use crate::structure::Structure;
use crate::tall_matrix::{Precision, TallMatrix};
use faer::{Mat, MatRef};
use isobar_model::{Duration, Time};
use isobar_obs::{ObservationWindow, Parameter, Placement, SparseRows};
use std::sync::Arc;
use window::{Information, Posterior, Window};

/// How a time volume is set up.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeVolumeSettings {
    /// The filter within each time step.
    pub filter: FastKalmanSettings,
    /// L: the cycles of the window.
    pub cycles: usize,
    /// Whether what cycles older than the window have said is kept as prior row, and not forgotten.
    pub keep_before: bool,
    /// F^y and F^s.
    pub factors: Vec<Factor>,
    /// Valid time of the background at the start.
    pub start: Time,
    /// A state-transition correction is chosen when its column, without what the others explain, correlates with the
    /// innovations by so many standard deviations of chance.
    pub selection_threshold: f64,
}

/// An amplitude of a factor.
#[derive(Clone, Debug)]
struct Amplitude {
    name: String,
    unit: String,
    factor: usize,
    pattern: Option<usize>,
    /// Which of the shape's functions of time.
    function: usize,
}

/// The filter of a moving time volume.
pub struct TimeVolume {
    /// The filter given C = the reference. Its calibration has the evolving amplitudes after the parameters.
    filter: FastKalmanFilter,
    settings: TimeVolumeSettings,
    /// Number of calibration parameters without the evolving amplitudes.
    parameters: usize,
    /// Those of C that belong to factors; after them come the corrections r.
    constant: Vec<Amplitude>,
    /// Those that are calibration parameters of the filter.
    evolving: Vec<Amplitude>,
    corrections: Option<Arc<dyn Corrections>>,
    /// U, `[m, q]`, of local parameters, and of shared ones with the evolving amplitudes after them.
    sensitivity: Factors,
    /// C_0, `[q]`.
    reference: Vec<f64>,
    window: Window,
    /// C relative to the reference, as of the last analysis.
    posterior: Posterior,
    /// Which of C are estimated: all amplitudes, and the corrections that are chosen.
    active: Vec<bool>,
    time: Time,
}

/// The observations' rows after the scaling of free columns have this norm each, with which the nominal prior is 10⁻⁶ of
/// what they say.
const NORM: f64 = 1e3;

impl TimeVolume {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::Setting`] if there is nothing to estimate, or a factor that makes no sense; those of
    /// [`FastKalmanFilter::new`].
    pub fn new(
        problem: Problem,
        settings: TimeVolumeSettings,
        corrections: Option<Arc<dyn Corrections>>,
    ) -> Result<Self, Error> {
        let fault = |what: &str| Err(Error::Setting(format!("a time volume {what}")));
        if problem.bias != BiasTreatment::Estimate || settings.filter.bias_coupling == BiasCoupling::Drop {
            return fault("estimates biases, and carries their covariance with the state");
        }
        if settings.filter.factor_precision == Precision::Single {
            // What is known of C is the difference between the posterior's information and a nominal prior's.
            return fault("needs its factors in double precision");
        }
        if settings.cycles == 0 {
            return fault("needs one cycle at least");
        }
        let layout = problem.background.layout().clone();
        let parameters = problem.calibration.len();
        let (mut constant, mut evolving) = (Vec::new(), Vec::new());
        let (mut priors, mut calibration) = (Vec::new(), problem.calibration.clone());
        for (number, factor) in settings.factors.iter().enumerate() {
            factor.check(&layout, parameters)?;
            let unit = match &factor.target {
                Target::Observations(numbers) => problem.calibration.parameters[numbers[0]].unit.clone(),
                Target::Forecast(variable) => layout.variables[*variable].unit.to_string(),
            };
            for (name, pattern, function) in factor.amplitudes() {
                let amplitude = Amplitude { name: name.clone(), unit: unit.clone(), factor: number, pattern, function };
                let evolve = |sigma_prior: f64, sigma_drift_per_sqrt_day: f64| {
                    let (placement, unit) = (Placement::Shared, unit.clone());
                    let own = Parameter { name, unit, placement, sigma_prior, sigma_drift_per_sqrt_day };
                    calibration.parameters.push(own);
                };
                match factor.evolution {
                    AmplitudeEvolution::Constant { sigma_prior } => {
                        priors.push(sigma_prior);
                        constant.push(amplitude);
                        continue;
                    }
                    AmplitudeEvolution::RandomWalk { sigma_prior, sigma_per_sqrt_day } => {
                        evolve(sigma_prior, sigma_per_sqrt_day);
                    }
                    // What it adds depends on the cycle's length: see `decay`.
                    AmplitudeEvolution::FirstOrder { sigma, .. } => evolve(sigma, 0.0),
                }
                evolving.push(amplitude);
            }
        }
        let amplitudes = constant.len();
        priors.extend(corrections.iter().flat_map(|it| it.candidates()).map(|candidate| candidate.sigma_prior));
        let q = priors.len();
        if q + evolving.len() == 0 {
            return fault("needs a factor or a state-transition correction");
        }
        let start = settings.start;
        let filter = FastKalmanFilter::new(Problem { calibration, ..problem }, settings.filter)?;
        let own = &filter.covariance.factors;
        let sensitivity = Factors {
            state: TallMatrix::zeros(layout.len(), q, Precision::Double),
            local: TallMatrix::zeros(own.local.rows(), q, Precision::Double),
            shared: Mat::zeros(own.shared.nrows(), q),
        };
        let window = Window::new(&priors);
        let active: Vec<bool> = (0..q).map(|k| k < amplitudes).collect();
        let posterior = window.total().solve(&active);
        let reference = vec![0.0; q];
        Ok(Self {
            filter,
            settings,
            parameters,
            constant,
            evolving,
            corrections,
            sensitivity,
            reference,
            window,
            posterior,
            active,
            time: start,
        })
    }

    /// Number of unknowns C.
    fn unknowns(&self) -> usize {
        self.reference.len()
    }

    /// U and its rows of the unknowns C themselves come before the columns of Φ, each multiplied by its scale.
    fn join(&mut self, scales: &[f64], with_own_rows: bool) {
        let q = self.unknowns();
        let factors = &mut self.filter.covariance.factors;
        factors.state.prepend(q);
        factors.local.prepend(q);
        for (k, &scale) in scales.iter().enumerate() {
            let scaled = |target: &mut [f64], source: &[f64]| {
                target.iter_mut().zip(source).for_each(|(target, source)| *target = scale * source);
            };
            let own = &self.sensitivity;
            factors.state.edit_column(k, |target| scaled(target, &own.state.column(k)));
            factors.local.edit_column(k, |target| scaled(target, &own.local.column(k)));
        }
        let (before, own) = (&factors.shared, &self.sensitivity.shared);
        let (p, rows) = (before.nrows(), before.nrows() + if with_own_rows { q } else { 0 });
        factors.shared = Mat::from_fn(rows, q + before.ncols(), |i, j| match (i < p, j < q) {
            (true, true) => scales[j] * own[(i, j)],
            (true, false) => before[(i, j - q)],
            (false, _) => {
                if i - p == j {
                    scales[j]
                } else {
                    0.0
                }
            }
        });
    }

    /// Takes U back.
    fn split(&mut self, scales: &[f64]) {
        let q = self.unknowns();
        let factors = &mut self.filter.covariance.factors;
        let p = self.sensitivity.shared.nrows();
        let (mut state, mut local) = (factors.state.take_front(q), factors.local.take_front(q));
        for (k, scale) in scales.iter().enumerate() {
            for own in [&mut state, &mut local] {
                own.edit_column(k, |column| column.iter_mut().for_each(|value| *value /= scale));
            }
        }
        let joint = &factors.shared;
        let shared = Mat::from_fn(p, q, |i, j| joint[(i, j)] / scales[j]);
        factors.shared = Mat::from_fn(p, joint.ncols() - q, |i, j| joint[(i, q + j)]);
        self.sensitivity = Factors { state, local, shared };
    }

    /// What F^s adds to the forecast of a cycle.
    fn add_model_factors(&mut self) {
        let cells = self.filter.state.layout().grid.cells();
        let shared_of = self.filter.shared.len() - self.evolving.len();
        let all = self.constant.iter().enumerate().map(|(k, it)| (it, k, true));
        for (amplitude, k, is_constant) in all.chain(self.evolving.iter().enumerate().map(|(k, it)| (it, k, false))) {
            let factor = &self.settings.factors[amplitude.factor];
            let Target::Forecast(variable) = factor.target else { continue };
            let height = factor.shape.value(amplitude.function, self.time);
            let pattern = amplitude.pattern.map(|pattern| factor.patterns[pattern].as_slice());
            let add = |field: &mut [f64], size: f64| {
                let field = &mut field[variable * cells..][..cells];
                field.iter_mut().enumerate().for_each(|(i, v)| *v += size * height * pattern.map_or(1.0, |it| it[i]));
            };
            if is_constant {
                add(self.filter.state.values_mut(), self.reference[k]);
                self.sensitivity.state.edit_column(k, |column| add(column, 1.0));
                continue;
            }
            // It is an unknown of the filter: whatever changes it changes the forecast.
            let row = shared_of + k;
            add(self.filter.state.values_mut(), self.filter.bias[self.parameters + k]);
            let factors = &mut self.filter.covariance.factors;
            for own in [factors, &mut self.sensitivity] {
                (0..own.columns()).for_each(|j| own.state.edit_column(j, |column| add(column, own.shared[(row, j)])));
            }
        }
    }

    /// What becomes of AR(1) amplitudes in a cycle.
    fn decay(&mut self, window: Duration) {
        let shared_of = self.filter.shared.len() - self.evolving.len();
        for (k, amplitude) in self.evolving.iter().enumerate() {
            let evolution = self.settings.factors[amplitude.factor].evolution;
            let AmplitudeEvolution::FirstOrder { sigma, correlation_time } = evolution else { continue };
            let phi = (-window.as_f64() / correlation_time.as_f64()).exp();
            let (row, number) = (shared_of + k, self.parameters + k);
            self.filter.bias[number] *= phi;
            let factors = &mut self.filter.covariance.factors;
            for own in [factors, &mut self.sensitivity] {
                (0..own.columns()).for_each(|j| own.shared[(row, j)] *= phi);
            }
            let added = sigma * ((1.0 - phi * phi) / window.days()).sqrt();
            self.filter.problem.calibration.parameters[number].sigma_drift_per_sqrt_day = added;
        }
    }

    /// Moves C_0, and with it state and parameters; a correction for which there is no model goes half the way, or less.
    fn move_reference(&mut self, shift: &[f64]) -> Result<(), Error> {
        let first = self.constant.len();
        let mut step = 1.0;
        if let Some(family) = &self.corrections {
            loop {
                let moved: Vec<f64> =
                    self.reference.iter().zip(shift).skip(first).map(|(own, shift)| own + step * shift).collect();
                match family.model(&moved) {
                    Ok(model) => break self.filter.problem.model = model,
                    Err(error) if step < 1e-3 => return Err(error),
                    Err(_) => step *= 0.5,
                }
            }
        }
        let shift: Vec<f64> = shift.iter().map(|it| step * it).collect();
        let mut of_blocks = vec![0.0; self.filter.blocks.variables()];
        self.sensitivity.multiply_add(&shift, &mut of_blocks);
        let shared = &self.sensitivity.shared;
        let of_shared: Vec<f64> =
            (0..shared.nrows()).map(|i| shift.iter().enumerate().map(|(k, it)| shared[(i, k)] * it).sum()).collect();
        self.filter.add_increments(&of_blocks, &of_shared);
        self.reference.iter_mut().zip(&shift).for_each(|(own, shift)| *own += shift);
        self.window.shift(&shift);
        Ok(())
    }
}

impl Assimilator for TimeVolume {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        let steps = self.filter.problem.steps(window)?;
        let first = self.constant.len();
        let transitions = match &self.corrections {
            Some(family) => Some(transition::columns(&**family, &self.reference[first..], &self.filter.state, steps)?),
            None => None,
        };
        self.time = self.time + window;
        let ones = vec![1.0; self.unknowns()];
        self.join(&ones, false);
        let outcome = self.filter.propagate(window);
        self.split(&ones);
        outcome?;
        self.add_model_factors();
        self.decay(window);
        for (k, columns) in transitions.iter().flat_map(|it| (0..it.columns()).map(move |k| (k, it.column(k)))) {
            self.sensitivity.state.edit_column(first + k, |own| {
                own.iter_mut().zip(columns.iter()).for_each(|(own, change)| *own += change);
            });
        }
        self.filter.add_errors(window)?;
        self.estimate()
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        self.time = observed.time;
        let coefficients = self.coefficients(observed);
        let innovations = self.innovations(observed, &coefficients)?;
        let mut rows = self.filter.split_rows(&innovations);
        let p = self.filter.shared.len();
        let mut shared = SparseRows::new();
        for (row, own) in coefficients.iter().enumerate() {
            let of_constant = own.constant.iter().map(|&(k, value)| (p + k, value));
            shared.push_row(rows.shared.row(row).iter().copied().chain(of_constant));
        }
        rows.shared = shared;
        let scales = self.scales(&rows, &innovations.variance);
        self.join(&scales, true);
        self.filter.free = Some(FreeColumns { count: self.unknowns(), found: None });
        let outcome = self.filter.analyse_rows(&rows, &innovations);
        let found = self.filter.free.take().and_then(|free| free.found);
        self.split(&scales);
        let (chi2, partition) = outcome?;
        let q = self.unknowns();
        let mut innovation_chi2 = chi2;
        let mut cycle = Information::none(q);
        if let Some(found) = found {
            cycle.matrix = Mat::from_fn(q, q, |i, j| found.matrix[(i, j)] / (scales[i] * scales[j]));
            cycle.vector = found.vector.iter().zip(&scales).map(|(value, scale)| value / scale).collect();
            innovation_chi2 += found.chi2_of_zero;
        }
        self.window.make_room(self.settings.cycles, self.settings.keep_before);
        let before = self.window.total();
        self.window.cycles.push_back(cycle);
        self.select();
        let (posterior, shift) = self.solve_window();
        // What the best C of before and the best one of now leave of the sum of squares.
        innovation_chi2 += self.explained(&before) - self.explained(&self.window.total());
        self.posterior = posterior;
        self.move_reference(&shift)?;
        self.restart_if_far(&shift);
        let estimate = self.estimate()?;
        let analysis_departures = self.innovations(observed, &coefficients)?.departures;
        Ok(Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: Some(innovation_chi2.max(0.0)),
            partition: Some(partition),
            warnings: Vec::new(),
        })
    }

    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Option<Structure> {
        let mut structure = self.filter.structure_after(observed, factors);
        structure.factors.iter_mut().for_each(|factor| factor.calibration.truncate(self.parameters));
        Some(structure)
    }

    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.column(unknown)
    }

    fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        self.accuracy()
    }

    fn parameters(&self) -> Vec<EstimatedParameter> {
        self.estimated()
    }

    fn set_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.take_calibration(estimate, covariance)
    }

    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.widen(covariance);
        Ok(())
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        saved::save(self)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), Error> {
        saved::restore(self, bytes)
    }
}
