//! Strong-constraint incremental 4D-Var with the biases in the control vector.

use super::conjugate_gradient::{self, Stopping};
use super::saved_window::{Saved, SavedStart, SavedWindow};
use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::error::Error;
use crate::linalg::{cholesky, column, product};
use crate::problem::{Innovations, Problem};
use crate::saved::{from_bytes, to_bytes, unfit};
use crate::spread::standard_deviations;
use faer::Mat;
use isobar_model::{Duration, State, forecast};
use isobar_obs::{Calibration, ObservationWindow};
use rayon::prelude::*;
use std::collections::VecDeque;

/// How 4D-Var is tuned.
#[derive(Clone, Debug, PartialEq)]
pub struct FourDVarSettings {
    /// Number of cycles in the assimilation window, at least one.
    pub window_cycles: usize,
    /// Factor on the covariance B of the problem.
    pub covariance_scale: f64,
    /// Number of outer loops, at least one: linearisations about the latest trajectory.
    pub outer_loops: usize,
    /// The minimiser of an outer loop stops when the gradient's norm has fallen by this factor,
    pub tolerance: f64,
    /// or after so many iterations.
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
/// tangent-linear model forward and its adjoint back.
///
/// The window slides by one cycle at a time. Its background is the analysis that was made when the cycle before its first
/// observations ended, so that no observation counts twice; until L cycles have passed, it is the first background. The
/// result of each cycle is the end of the trajectory. P_c, the covariance of the biases' errors, belongs to the background
/// too: it is that block of the inverse Hessian of the analysis from which the window starts.
pub struct FourDVar {
    problem: Problem,
    settings: FourDVarSettings,
    calibration: Calibration,
    /// The analyses of the last cycles, at most L: the first is the background of the window.
    starts: VecDeque<Start>,
    /// The observations since the first of them, cycle by cycle.
    observed: VecDeque<ObservationWindow>,
    /// Length of a cycle.
    window: Duration,
    /// The present estimate.
    state: State,
    bias: Vec<f64>,
    bias_covariance: Mat<f64>,
}

/// What a window starts from.
#[derive(Clone)]
struct Start {
    state: State,
    bias: Vec<f64>,
    /// P_c, `[p, p]`.
    bias_covariance: Mat<f64>,
}

impl FourDVar {
    /// 4D-Var from the background.
    ///
    /// # Errors
    /// [`Error::Setting`] for a window or a number of outer loops of zero.
    pub fn new(problem: Problem, settings: FourDVarSettings) -> Result<Self, Error> {
        if settings.window_cycles == 0 || settings.outer_loops == 0 {
            return Err(Error::Setting("4D-Var needs a window of at least one cycle and one outer loop".into()));
        }
        let calibration = problem.estimated_calibration();
        let p = calibration.len();
        let bias_covariance =
            Mat::from_fn(p, p, |i, j| if i == j { calibration.parameters[i].sigma_prior.powi(2) } else { 0.0 });
        let (state, bias) = (problem.background.clone(), vec![0.0; problem.calibration.len()]);
        let start = Start { state: state.clone(), bias: bias.clone(), bias_covariance: bias_covariance.clone() };
        Ok(Self {
            problem,
            settings,
            calibration,
            starts: VecDeque::from([start]),
            observed: VecDeque::new(),
            window: Duration::from_seconds(0),
            state,
            bias,
            bias_covariance,
        })
    }

    fn estimate(&self) -> Result<Estimate, Error> {
        let variances: Vec<f64> = (0..self.calibration.len()).map(|i| self.bias_covariance[(i, i)]).collect();
        let spread = standard_deviations(&variances, "the covariance of the calibration parameters", |i| {
            self.calibration.parameters[i].name.clone()
        })?;
        Ok(Estimate {
            state: self.state.clone(),
            calibration: self.bias.clone(),
            state_spread: None,
            calibration_spread: (!self.calibration.is_empty()).then_some(spread),
        })
    }

    /// P_c with the parameters' random walks over a time.
    fn drifted(&self, covariance: &Mat<f64>, time: Duration) -> Mat<f64> {
        let mut covariance = covariance.clone();
        for (i, parameter) in self.calibration.parameters.iter().enumerate() {
            covariance[(i, i)] += parameter.sigma_drift_per_sqrt_day.powi(2) * time.days();
        }
        covariance
    }

    /// The trajectory from x_0 through the window, one list of states for each cycle, from its first step to its end.
    fn trajectory(&self, start: &State) -> Result<Vec<Vec<State>>, Error> {
        let steps = self.problem.steps(self.window)?;
        let mut cycles: Vec<Vec<State>> = Vec::with_capacity(self.observed.len());
        for _ in 0..self.observed.len() {
            let from = cycles.last().map_or(start, |cycle| &cycle[steps]);
            cycles.push(forecast::trajectory(&*self.problem.model, from, steps)?);
        }
        Ok(cycles)
    }

    /// The analysis of the window; the trajectory's end and the biases become the estimate. Returns χ².
    fn analyse_window(&mut self) -> Result<f64, Error> {
        let start = self.starts.front().expect("there is always a background").clone();
        let cycles = self.observed.len();
        let length = Duration::from_seconds(self.window.seconds() * cycles as i64);
        let bias_root = cholesky(self.drifted(&start.bias_covariance, length), || {
            "the covariance of the calibration parameters".into()
        })?;
        let stopping = Stopping { tolerance: self.settings.tolerance, max_iterations: self.settings.max_iterations };
        let (mut state, mut bias) = (start.state.clone(), start.bias.clone());
        let mut chi2 = 0.0;
        for outer in 1..=self.settings.outer_loops {
            let trajectory = self.trajectory(&state)?;
            let innovations = self
                .observed
                .iter()
                .zip(&trajectory)
                .map(|(observed, cycle)| {
                    self.problem.innovations(observed, cycle.last().expect("a cycle has steps"), &bias)
                })
                .collect::<Result<Vec<_>, Error>>()?;
            let inner = Linearised {
                problem: &self.problem,
                scale: self.settings.covariance_scale.sqrt(),
                bias_root: &bias_root,
                trajectory: &trajectory,
                innovations: &innovations,
            };
            // Innovations about the background, to first order: d + H M (x − x_b) + G (c − c_b).
            let dx = (&state - &start.state).values().to_vec();
            let dc: Vec<f64> = bias.iter().zip(&start.bias).map(|(a, b)| a - b).take(self.calibration.len()).collect();
            let mut right: Vec<Vec<f64>> = inner.observe(dx, &[dc]).swap_remove(0);
            for (values, own) in right.iter_mut().zip(&innovations) {
                for ((value, d), variance) in values.iter_mut().zip(&own.departures).zip(&own.variance) {
                    *value += d / variance.sqrt();
                }
            }
            let gradient = inner.multiply_transposed(&[right.clone()]).swap_remove(0);
            // The last outer loop finds the covariance of the biases along with the minimum.
            let (controls, p) = (gradient.len(), self.calibration.len());
            let last = outer == self.settings.outer_loops;
            let mut systems = vec![gradient.clone()];
            systems.extend((0..if last { p } else { 0 }).map(|parameter| {
                let mut unit = vec![0.0; controls];
                unit[controls - p + parameter] = 1.0;
                unit
            }));
            let solutions = conjugate_gradient::solve_many(&systems, stopping, |directions| inner.hessian(directions));
            let (minimum, posterior) = solutions.split_first().expect("the minimum is the first");
            chi2 = right.iter().flatten().map(|value| value * value).sum::<f64>() - dot(&gradient, minimum);
            let (dx, dc) = inner.increments(minimum);
            state = start.state.clone();
            state.values_mut().iter_mut().zip(&dx).for_each(|(value, change)| *value += change);
            bias.copy_from_slice(&start.bias);
            bias.iter_mut().zip(&dc).for_each(|(value, change)| *value += change);
            if last {
                let whitened =
                    Mat::from_fn(p, p, |i, j| 0.5 * (posterior[j][controls - p + i] + posterior[i][controls - p + j]));
                let left = product(bias_root.as_ref(), whitened.as_ref());
                self.bias_covariance = product(left.as_ref(), bias_root.transpose());
            }
        }
        let steps = self.problem.steps(self.window)? * cycles;
        forecast::forecast(&*self.problem.model, &mut state, steps)?;
        (self.state, self.bias) = (state, bias);
        Ok(chi2)
    }
}

impl Assimilator for FourDVar {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.window = window;
        forecast::forecast(&*self.problem.model, &mut self.state, self.problem.steps(window)?)?;
        self.bias_covariance = self.drifted(&self.bias_covariance, window);
        self.estimate()
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let innovations = self.problem.innovations(observed, &self.state, &self.bias)?;
        self.observed.push_back(observed.clone());
        let window_chi2 = self.analyse_window()?;
        // χ² is that of the window; each of its cycles has its part.
        let all: usize = self.observed.iter().map(|observed| observed.len()).sum();
        let innovation_chi2 = window_chi2 * observed.len() as f64 / all.max(1) as f64;
        let analysed =
            Start { state: self.state.clone(), bias: self.bias.clone(), bias_covariance: self.bias_covariance.clone() };
        self.starts.push_back(analysed);
        if self.observed.len() == self.settings.window_cycles {
            self.observed.pop_front();
            self.starts.pop_front();
        }
        Ok(self.problem.analysis(observed, innovations, self.estimate()?, innovation_chi2))
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        let present = SavedStart::new(&self.state, &self.bias, &self.bias_covariance);
        let starts = self.starts.iter().map(|it| SavedStart::new(&it.state, &it.bias, &it.bias_covariance)).collect();
        let observed = self.observed.iter().map(|it| SavedWindow::new(it, &self.state, &self.bias)).collect();
        to_bytes(&Saved { present, starts, observed })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let Saved { present, starts, observed } = from_bytes(saved)?;
        let (layout, p) = (self.state.layout(), self.calibration.len());
        let start = |saved: SavedStart| -> Result<Start, Error> {
            let (mut state, mut bias) = (self.problem.background.clone(), self.bias.clone());
            let bias_covariance = saved.restored(&mut state, &mut bias, p)?;
            Ok(Start { state, bias, bias_covariance })
        };
        let limits = (layout.len(), self.problem.calibration.len(), layout.variables.len());
        let observed = observed.into_iter().map(|it| it.restored(limits)).collect::<Result<VecDeque<_>, _>>()?;
        let starts = starts.into_iter().map(start).collect::<Result<VecDeque<_>, _>>()?;
        if starts.len() != observed.len() + 1 || starts.len() > self.settings.window_cycles {
            return Err(unfit("the assimilation window"));
        }
        (self.starts, self.observed) = (starts, observed);
        self.bias_covariance = present.restored(&mut self.state, &mut self.bias, p)?;
        Ok(())
    }
}

/// The quadratic problem of an outer loop; a control vector is (χ, β), a vector of whitened observations has one part for
/// each cycle. All operators take several vectors at once, which the models propagate together.
struct Linearised<'a> {
    problem: &'a Problem,
    /// √s.
    scale: f64,
    /// L.
    bias_root: &'a Mat<f64>,
    /// States of each cycle, from its first step to its end.
    trajectory: &'a [Vec<State>],
    innovations: &'a [Innovations],
}

impl Linearised<'_> {
    /// (δx_0, δc) of a control vector.
    fn increments(&self, control: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let operator = &*self.problem.background_error;
        let (chi, beta) = control.split_at(operator.control_len());
        let mut dx = vec![0.0; operator.len()];
        operator.root_add(chi, &mut dx);
        dx.iter_mut().for_each(|value| *value *= self.scale);
        (dx, product(self.bias_root.as_ref(), column(beta).as_ref()).col_as_slice(0).to_vec())
    }

    /// R^-½ (H M δx_0 + G δc) of several increments: `columns` holds the δx_0 one after another.
    fn observe(&self, mut columns: Vec<f64>, biases: &[Vec<f64>]) -> Vec<Vec<Vec<f64>>> {
        let m = self.problem.background.values().len();
        let mut result: Vec<Vec<Vec<f64>>> = vec![Vec::with_capacity(self.trajectory.len()); biases.len()];
        for (cycle, own) in self.trajectory.iter().zip(self.innovations) {
            for at in &cycle[..cycle.len() - 1] {
                self.problem.model.step_tl(at, &mut columns);
            }
            for (number, dc) in biases.iter().enumerate() {
                let dy = own.jacobian.apply(&columns[number * m..][..m], dc);
                result[number].push(whiten(dy, own));
            }
        }
        result
    }

    /// Kᵀ of several vectors of whitened observations.
    fn multiply_transposed(&self, whitened: &[Vec<Vec<f64>>]) -> Vec<Vec<f64>> {
        let operator = &*self.problem.background_error;
        let m = operator.len();
        let mut columns = vec![0.0; m * whitened.len()];
        let mut biases = vec![vec![0.0; self.bias_root.nrows()]; whitened.len()];
        for (number, (cycle, own)) in self.trajectory.iter().zip(self.innovations).enumerate().rev() {
            for (values, (dx, dc)) in whitened.iter().zip(columns.chunks_exact_mut(m).zip(&mut biases)) {
                own.jacobian.apply_ad(&whiten(values[number].clone(), own), dx, dc);
            }
            forecast::backward_ad(&*self.problem.model, cycle, &mut columns);
        }
        let control = |(dx, dc): (&[f64], &Vec<f64>)| {
            let scaled: Vec<f64> = dx.iter().map(|value| value * self.scale).collect();
            let mut control = vec![0.0; operator.control_len()];
            operator.root_transpose_add(&scaled, &mut control);
            control.extend_from_slice(product(self.bias_root.transpose(), column(dc).as_ref()).col_as_slice(0));
            control
        };
        columns.par_chunks_exact(m).zip(&biases).map(control).collect()
    }

    /// (I + KᵀK) of several control vectors.
    fn hessian(&self, controls: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (columns, biases): (Vec<Vec<f64>>, Vec<Vec<f64>>) =
            controls.par_iter().map(|control| self.increments(control)).unzip();
        let mut images = self.multiply_transposed(&self.observe(columns.concat(), &biases));
        for (image, control) in images.iter_mut().zip(controls) {
            image.iter_mut().zip(control).for_each(|(image, own)| *image += own);
        }
        images
    }
}

/// R^-½ dy.
fn whiten(mut dy: Vec<f64>, innovations: &Innovations) -> Vec<f64> {
    dy.iter_mut().zip(&innovations.variance).for_each(|(value, variance)| *value /= variance.sqrt());
    dy
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
