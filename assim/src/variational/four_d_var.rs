//! Strong-constraint incremental 4D-Var with the biases in the control vector.

use super::bias_information::BiasInformation;
use super::conjugate_gradient::{Stopping, minimise};
use super::control_space::{self, ControlSpace};
use super::convergence::Convergence;
use super::window_cost::Cost;
use crate::appropriate_time::Times;
use crate::assimilator::{Adjustments, Assimilator, CalibrationAdjustment, Views, WidenCalibration};
use crate::calibrated_state::CalibratedState;
use crate::error::Error;
use crate::estimate::{Analysis, Background};
use crate::linalg::squared_norm;
use crate::memory::{read, require, write};
use crate::problem::{Innovations, Problem, require_finite, steps};
use faer::MatRef;
use isobar_model::vector::add;
use isobar_model::{Adjoint, Duration, Model, State, forecast};
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, WithinWindow};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{Read, Write};
use std::sync::Arc;

/// How 4D-Var is tuned.
#[derive(Clone, Debug, PartialEq)]
pub struct FourDVarSettings {
    /// Number of cycles in the assimilation window, at least one.
    pub window_cycles: usize,
    /// Factor on the covariance B of the problem.
    pub covariance_scale: f64,
    /// Number of outer loops, at least one: linearisations about the latest trajectory.
    pub outer_loops: usize,
    /// The minimiser of an outer loop stops when the gradient's norm has fallen by this factor.
    pub tolerance: f64,
    /// The largest number of iterations of an outer loop.
    pub max_iterations: usize,
}

/// Minimises over the state x_0 at the start of a window of L cycles and the biases c in it
///
/// ```text
/// J = ½ |x_0 − x_b|²_B + ½ |c − c_b|²_Pc + ½ Σ_l |y_l − h(M_0→l x_0, c)|²_R,
/// ```
///
/// with the model as a strong constraint (Le Dimet and Talagrand 1986), incrementally (Courtier, Thépaut and Hollingsworth
/// 1994): each outer loop linearises model and observations about the latest trajectory and minimises the quadratic cost
/// in the control variables of 3D-Var, `x_0 − x_b = √s U χ`, `c − c_b = L β`, by conjugate gradients whose Hessian runs the
/// tangent-linear model forward and its adjoint back. Observations within a cycle are seen at their times on the trajectory,
/// interpolated linearly between its time steps.
///
/// The window slides by one cycle at a time. Its background is the analysis that was made when the cycle before its first
/// observations ended, so that no observation counts twice; until L cycles have passed, it is the first background. The
/// result of each cycle is the end of the trajectory. P_c, the covariance of the biases' errors, belongs to the background
/// too: it is that block of the inverse Hessian of the analysis from which the window starts.
#[derive(Clone)]
pub struct FourDVar {
    problem: Problem<dyn Model>,
    model: Arc<dyn Adjoint>,
    settings: FourDVarSettings,
    /// The analyses of the last cycles, at most L: the first is the background of the window.
    starts: VecDeque<CalibratedState>,
    /// The observations since the first of them, cycle by cycle.
    observed: VecDeque<ObservationWindow>,
    present: CalibratedState,
    convergence: Convergence,
}

/// The present estimate, and the window that will slide on.
#[derive(Serialize, Deserialize)]
struct Memory {
    present: CalibratedState,
    starts: VecDeque<CalibratedState>,
    /// The observations of each cycle with the Jacobian of their operator, which is linear, and how long before the end of the
    /// cycle each is valid; no times where all are at its end.
    observed: Vec<(ObservationWindow, Jacobian, Vec<Duration>)>,
    convergence: Convergence,
}

impl FourDVar {
    /// 4D-Var from the background.
    ///
    /// # Errors
    /// [`Error::Setting`] for a window or a number of outer loops of zero; [`Error::TooLarge`] if the analysis of the most
    /// observations does not fit into the memory limit.
    pub fn new(problem: Problem<dyn Adjoint>, settings: FourDVarSettings) -> Result<Self, Error> {
        if settings.window_cycles == 0 || settings.outer_loops == 0 {
            return Err(Error::Setting("4D-Var needs a window of at least one cycle and one outer loop".into()));
        }
        let (model, problem) = (Arc::clone(&problem.model), Problem::<dyn Model>::from(problem));
        check_memory(&problem, settings.window_cycles, problem.most_observations * settings.window_cycles, 0)?;
        let present = CalibratedState::new(&problem)?;
        Ok(Self {
            model,
            problem,
            settings,
            starts: VecDeque::from([present.clone()]),
            observed: VecDeque::new(),
            present,
            convergence: Convergence::default(),
        })
    }

    /// The trajectory from x_0 through the window, one list of states for each cycle, from its first step to its end.
    fn trajectory(&self, start: &State, steps: usize) -> Result<Vec<Vec<State>>, Error> {
        let mut cycles: Vec<Vec<State>> = Vec::with_capacity(self.observed.len());
        for _ in 0..self.observed.len() {
            let from = cycles.last().map_or(start, |cycle| &cycle[steps]);
            cycles.push(forecast::trajectory(&*self.model, from, steps)?);
        }
        Ok(cycles)
    }

    /// Innovations about the states of a cycle of this length, and the times of its observations.
    fn innovations(
        &self,
        observed: &ObservationWindow,
        states: &[State],
        bias: &[f64],
        length: Duration,
    ) -> Result<(Innovations, Times), Error> {
        let end = states.last().expect("a cycle has steps");
        let innovations = self.problem.innovations(observed, end, bias)?;
        let Some(within) = observed.operator.within_window() else {
            return Ok((innovations, Times::at_end(observed.len(), states.len() - 1)));
        };
        let times = Times::new(&*self.model, length, within.lags)?;
        let seen = times.along(states, |x| within.whole.simulate(x, bias));
        let departures: Vec<f64> = observed.values.iter().zip(seen).map(|(value, seen)| value - seen).collect();
        require_finite(&departures, observed)?;
        Ok((Innovations { departures, ..innovations }, times))
    }

    /// The analysis of the window, whose cycles have this length; the trajectory's end and the biases become the estimate.
    /// Returns χ², if the last minimisation has converged.
    fn analyse_window(&mut self, cycle: Duration) -> Result<Option<f64>, Error> {
        let steps = steps(&*self.model, cycle)?;
        let (cycles, window_cycles) = (self.observed.len(), self.settings.window_cycles);
        let observations: usize = self.observed.iter().map(|observed| observed.len()).sum();
        check_memory(&self.problem, window_cycles, observations, cycles * (steps + 1))?;
        let mut background = self.starts.front().expect("there is always a background").clone();
        background.drift(Duration::from_seconds(cycle.seconds() * cycles as i64));
        let scale = self.settings.covariance_scale;
        let control = ControlSpace::new(&*self.problem.background_error, scale, &background.bias_covariance)?;
        let stopping = Stopping { tolerance: self.settings.tolerance, max_iterations: self.settings.max_iterations };
        let mut estimate = background.clone();
        let mut chi2 = None;
        for outer in 1..=self.settings.outer_loops {
            let trajectory = self.trajectory(&estimate.s.state, steps)?;
            let along = self.observed.iter().zip(&trajectory);
            let seen = along.map(|(observed, states)| self.innovations(observed, states, &estimate.s.bias, cycle));
            let (innovations, times): (Vec<_>, Vec<_>) = seen.collect::<Result<Vec<_>, Error>>()?.into_iter().unzip();
            let (innovations, times) = (&*innovations, &*times);
            let cost = Cost { model: &*self.model, control: &control, trajectory: &trajectory, innovations, times };
            // Innovations about the background, to first order: d + H M (x − x_b) + G (c − c_b).
            let dx = (&estimate.s.state - &background.s.state).values().to_vec();
            let differences = estimate.s.bias.iter().zip(&background.s.bias).map(|(a, b)| a - b);
            let dc: Vec<f64> = differences.take(control.parameters()).collect();
            let mut right: Vec<Vec<f64>> = cost.observe(dx, &[dc]).swap_remove(0);
            for (values, own) in right.iter_mut().zip(innovations) {
                add(values, &own.whiten(own.departures.clone()));
            }
            let gradient = cost.multiply_transposed(&[right.clone()]).swap_remove(0);
            let minimum = minimise(gradient, observations, stopping, |direction| cost.hessian(direction));
            let (dx, dc) = control.increments(&minimum.values);
            estimate = background.clone();
            estimate.add(&dx, &dc);
            if outer == self.settings.outer_loops {
                // The last outer loop finds the covariance of the biases as well.
                let information =
                    BiasInformation::new(innovations, &control, stopping, |vectors| cost.multiply_state(vectors));
                estimate.bias_covariance = control.bias_covariance(&information.matrix)?.into();
                self.convergence.add(minimum.ending, &information.endings);
                if self.convergence.reached() {
                    let fitted = cost.observe(dx.clone(), std::slice::from_ref(&dc)).swap_remove(0);
                    let misfits = right.iter().flatten().zip(fitted.iter().flatten());
                    let misfit: f64 = misfits.map(|(d, fitted)| (d - fitted).powi(2)).sum();
                    chi2 = Some(misfit + squared_norm(&minimum.values));
                }
            }
        }
        forecast::forecast(&*self.model, &mut estimate.s.state, steps * cycles)?;
        self.present = estimate;
        Ok(chi2)
    }
}

impl Assimilator for FourDVar {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.present.forecast(&*self.model, window)?;
        Ok(Background { estimate: self.present.estimate(None)?, window })
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let innovations = self.problem.innovations(observed, &self.present.s.state, &self.present.s.bias)?;
        self.observed.push_back(observed.clone());
        let window_chi2 = self.analyse_window(from.window)?;
        // χ² is that of the window; each of its cycles has its part.
        let all: usize = self.observed.iter().map(|observed| observed.len()).sum();
        let innovation_chi2 = window_chi2.map(|chi2| chi2 * observed.len() as f64 / all.max(1) as f64);
        self.starts.push_back(self.present.clone());
        if self.observed.len() == self.settings.window_cycles {
            self.observed.pop_front();
            self.starts.pop_front();
        }
        let analysis = self.problem.analysis(observed, innovations, self.present.estimate(None)?, innovation_chi2);
        Ok(Analysis { warnings: self.convergence.warning().into_iter().collect(), ..analysis })
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    /// The operators of the window are linear: a Jacobian stands for each of them.
    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        let s = &self.present.s;
        let with_jacobian = |window: &ObservationWindow| {
            let lags = window.operator.within_window().map_or(Vec::new(), |within| within.lags.to_vec());
            (window.clone(), window.operator.linearize(&s.state, &s.bias), lags)
        };
        let observed = self.observed.iter().map(with_jacobian).collect();
        let convergence = self.convergence.clone();
        write(&Memory { present: self.present.clone(), starts: self.starts.clone(), observed, convergence }, to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let Memory { present, starts, observed, convergence } = read(from)?;
        starts.iter().chain([&present]).try_for_each(|start| start.require_like(&self.present))?;
        let (layout, p) = (present.s.state.layout(), present.s.bias.len());
        let fits = |(window, jacobian, lags): &(ObservationWindow, Jacobian, Vec<Duration>)| {
            window.fits(layout)
                && (lags.is_empty() || lags.len() == window.len())
                && jacobian.state.has_shape(window.len(), layout.len())
                && jacobian.calibration.has_shape(window.len(), p)
        };
        let is_whole = starts.len() == observed.len() + 1 && starts.len() <= self.settings.window_cycles;
        require(is_whole && observed.iter().all(fits), "the assimilation window")?;
        let with_operator = |(window, jacobian, lags): (ObservationWindow, Jacobian, Vec<Duration>)| {
            let operator = Arc::new(LinearOperator { jacobian });
            let operator = if lags.is_empty() { operator } else { WithinWindow::around(operator, lags) };
            ObservationWindow { operator, ..window }
        };
        let observed = observed.into_iter().map(with_operator).collect();
        (self.present, self.starts, self.observed) = (present, starts, observed);
        self.convergence = convergence;
        Ok(())
    }

    fn can(&self) -> Views<'_> {
        Views { calibration: self.present.view(), parameters: Some(&self.convergence), ..Views::default() }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        let calibration = (self.present.parameters() > 0).then_some(CalibrationAdjustment::Widen(self));
        Adjustments { calibration, error_factor: None }
    }
}

impl WidenCalibration for FourDVar {
    /// The window's background says what was known of biases that are one and the same over the window.
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.starts.iter_mut().chain([&mut self.present]).try_for_each(|start| start.widen_calibration(covariance))
    }
}

/// What the minimisation needs, the trajectory's states and those that the window's vectors are propagated with, and the
/// backgrounds of the window's cycles.
fn check_memory(
    problem: &Problem<dyn Model>,
    window_cycles: usize,
    observations: usize,
    states: usize,
) -> Result<(), Error> {
    let (m, p) = (problem.background.values().len(), problem.estimated_calibration().len());
    let controls = problem.background_error.control_len();
    let [values, parameters, starts] = [m, p, window_cycles + 2].map(|size| size as f64);
    let numbers = control_space::numbers(controls, m, p, observations)
        + values * (states as f64 + 3.0 * (parameters + 1.0))
        + starts * (parameters * parameters + values);
    problem.require_memory(numbers, || {
        format!(
            "the minimisation for {controls} control variables, {p} biases and {observations} observations of a window"
        )
    })
}
