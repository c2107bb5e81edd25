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
//! for a linear model and linearises a nonlinear one about the best there is; after a far move of a correction the window's
//! cycles are run again (`run_again`).
//!
//! Amplitudes that are a random walk or an AR(1) process cannot be constant over a window: they are unknowns of each cycle
//! beside the calibration parameters, and common factors carry their covariance with the state.

mod corrected_model;
mod correction;
mod covariances;
mod cycle;
mod factor;
mod fixed_lag;
mod history;
mod local_prior;
mod moved_patterns;
mod observed;
mod report;
mod restart;
mod rows;
mod run_again;
mod select;
mod tiles;
mod transition;
mod window;

pub use correction::{Candidate, CorrectionPattern, Corrections};
pub use factor::{AmplitudeEvolution, Factor, Target, TimeShape};
pub use tiles::tile_patterns;

use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::blocks::{BiasCoupling, BlockErrors, Factors, FastKalmanSettings, Precision};
use crate::problem::{BiasTreatment, Problem};
use history::History;
use isobar_model::{Model, TangentLinear, Time};
use isobar_obs::{Calibration, Drift, Parameter, Placement};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;
use transition::Transition;
use window::{Posterior, Window};

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
    /// innovations by more than this number of standard deviations of chance.
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
#[derive(Clone)]
pub struct TimeVolume {
    problem: Problem<dyn Model>,
    settings: Arc<TimeVolumeSettings>,
    /// The parameters of the experiment and, after them, the evolving amplitudes: the unknowns of each cycle.
    calibration: Calibration,
    /// Those of C that belong to factors; after them come the corrections r.
    constant: Arc<[Amplitude]>,
    /// Those that are unknowns of each cycle.
    evolving: Arc<[Amplitude]>,
    corrections: Option<Transition>,
    /// The model with the corrections of the reference.
    model: Arc<dyn TangentLinear>,
    /// P, given C.
    errors: BlockErrors,
    memory: Memory,
}

/// What changes from cycle to cycle beside P.
#[derive(Clone, Serialize, Deserialize)]
struct Memory {
    /// (b, c) given that C is the reference.
    s: Augmented,
    /// U, `[m, q]`, of local parameters, and of shared ones with the evolving amplitudes after them.
    sensitivity: Factors,
    /// C_0, `[q]`.
    reference: Vec<f64>,
    window: Window,
    /// C relative to the reference, as of the last analysis.
    posterior: Posterior,
    /// Which of C are estimated: all amplitudes, the corrections that are chosen, and the other tiles of these.
    active: Vec<bool>,
    /// σ^-2 of the priors of tiles that are not chosen; 0 of all else, `[q]`.
    precisions: Vec<f64>,
    /// By how much the patterns have moved that move with the flow, eastward and northward \[m\].
    moved_m: [f64; 2],
    /// Valid time of `s`.
    time: Time,
    /// Those of the analyses that are still revised, the oldest first, if there is a smoother.
    past_times: VecDeque<Time>,
    /// The cycles that are run again when a correction has moved far.
    history: History<Memory>,
}

impl TimeVolume {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::Setting`] if there is nothing to estimate, or a factor that makes no sense; those of
    /// [`FastKalmanFilter::new`](crate::fast_kalman::FastKalmanFilter::new).
    pub fn new(
        problem: impl Into<Problem<dyn TangentLinear>>,
        settings: TimeVolumeSettings,
        corrections: Option<Arc<dyn Corrections>>,
    ) -> Result<Self, Error> {
        let problem = problem.into();
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
                let (sigma_prior, drift) = match factor.evolution {
                    AmplitudeEvolution::Constant { sigma_prior } => {
                        priors.push(sigma_prior);
                        constant.push(amplitude);
                        continue;
                    }
                    AmplitudeEvolution::RandomWalk { sigma_prior, sigma_per_sqrt_day } => {
                        (sigma_prior, Drift::RandomWalk { sigma_per_sqrt_day })
                    }
                    AmplitudeEvolution::FirstOrder { sigma, correlation_time } => {
                        (sigma, Drift::FirstOrder { sigma, correlation_time })
                    }
                };
                let (placement, unit) = (Placement::Shared, unit.clone());
                calibration.parameters.push(Parameter { name, unit, placement, sigma_prior, drift });
                evolving.push(amplitude);
            }
        }
        let amplitudes = constant.len();
        let corrections = corrections.map(|family| Transition::new(family, &layout.grid)).transpose()?;
        priors.extend(corrections.iter().flat_map(Transition::sigma_priors));
        let q = priors.len();
        if q + evolving.len() == 0 {
            return fault("needs a factor or a state-transition correction");
        }
        let own = problem.calibration.clone();
        let problem = Problem { calibration, ..problem };
        let errors = BlockErrors::new(&problem, settings.filter)?;
        let window = Window::new(&priors);
        let active: Vec<bool> = (0..q).map(|k| k < amplitudes).collect();
        let memory = Memory {
            s: Augmented::background(&problem),
            sensitivity: Factors::zeros_like(errors.factors(), q),
            reference: vec![0.0; q],
            posterior: window.total().solve(&active),
            window,
            active,
            precisions: vec![0.0; q],
            moved_m: [0.0; 2],
            time: settings.start,
            past_times: VecDeque::new(),
            history: History::default(),
        };
        let model = corrections.as_ref().map_or_else(|| Arc::clone(&problem.model), |it| it.model());
        let calibration = problem.calibration.clone();
        let problem = Problem { calibration: own, ..problem.into() };
        let settings = Arc::new(settings);
        let (constant, evolving) = (constant.into(), evolving.into());
        Ok(Self { problem, settings, calibration, constant, evolving, corrections, model, errors, memory })
    }

    /// Number of calibration parameters of the experiment, without the evolving amplitudes.
    fn parameters(&self) -> usize {
        self.problem.calibration.len()
    }

    /// Number of unknowns C.
    fn unknowns(&self) -> usize {
        self.memory.reference.len()
    }

    /// The row of the first evolving amplitude among those of the shared parameters: they are the last.
    fn first_evolving(&self) -> usize {
        self.errors.shared().len() - self.evolving.len()
    }
}
