//! The cycles of the window, which are run again when a correction has moved far: the Gauss–Newton method on eq. (24) of
//! WO 97/18442.
//!
//! The sensitivities U to a correction r, and what the cycles say of it, hold for small changes of r. When r̂ moves by more
//! than some of its claimed uncertainties, as it does when it is first chosen, the state ŝ + U δ has an error of the order of
//! δ², which P does not contain, and what the earlier cycles say of r was said about another model. So the window's cycles are
//! run again from the state before them, with the model as it now is and the same observations, until r̂ stays:
//!
//! ```text
//! start      ŝ ← ŝ + U δ                       before the first of them, P and U as they were
//! each       forecast and analysis with A + dA(r̂), whose J and j take the place of the old ones
//! window     Ĉ = (V_0^-1 + Σ_l J_{t-l})^-1 (V_0^-1 y_0 + Σ_l j_{t-l})
//! ```
//!
//! The observations are those of the first run as linear rows, y' = d + H s + F^y C with H as it was at the background then.
//! States from which to start are kept at every half of a window, so that up to one and a half windows are run again.

use super::rows::Coefficients;
use super::window::Window;
use super::{Memory, TimeVolume};
use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::blocks::{BlockErrors, Factors};
use crate::filter::Errors;
use crate::memory::require;
use crate::problem::Innovations;
use isobar_model::{Duration, Time};
use isobar_obs::Jacobian;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Claimed standard deviations beyond which a move is far.
const FAR: f64 = 2.0;

/// How often the cycles are run again at most after an analysis.
const MOST_RUNS: usize = 4;

/// The cycles of the window and some before, in parts of half a window, oldest first.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(super) struct History(VecDeque<Part>);

/// Cycles, and what was known before the first of them.
#[derive(Clone, Serialize, Deserialize)]
struct Part {
    start: Start,
    cycles: Vec<PastCycle>,
}

#[derive(Clone, Serialize, Deserialize)]
struct Start {
    errors: <BlockErrors as Errors>::Memory,
    s: Augmented,
    sensitivity: Factors,
    reference: Vec<f64>,
    window: Window,
    time: Time,
    past_times: VecDeque<Time>,
}

/// A cycle as it is run again.
#[derive(Clone, Serialize, Deserialize)]
struct PastCycle {
    /// Length of its forecast, if it had one.
    window: Option<Duration>,
    /// What it observed, if it has been analysed.
    observed: Option<Observed>,
}

#[derive(Clone, Serialize, Deserialize)]
struct Observed {
    time: Time,
    /// y'.
    values: Vec<f64>,
    /// H, with columns of the evolving amplitudes after those of the parameters.
    jacobian: Jacobian,
    variance: Vec<f64>,
    coefficients: Vec<Coefficients>,
}

impl History {
    /// Fails if it is not one of a time volume with such a memory: it has been read from a file.
    pub fn require(&self, like: &Memory) -> Result<(), Error> {
        let (q, own) = (like.reference.len(), &like.sensitivity);
        for Part { start, cycles } in &self.0 {
            start.s.require_like(&like.s)?;
            let fits = start.reference.len() == q
                && start.sensitivity.columns() == q
                && start.sensitivity.has_rows(own.state.rows(), own.local.rows(), own.shared.nrows())
                && start.sensitivity.past.len() == start.past_times.len()
                && start.window.has_unknowns(q);
            require(fits, "a start of the history of the time volume")?;
            let mut observed = cycles.iter().filter_map(|cycle| cycle.observed.as_ref());
            require(observed.all(|it| it.fits(&like.s, q)), "a cycle of the history of the time volume")?;
        }
        Ok(())
    }
}

impl Observed {
    fn fits(&self, s: &Augmented, q: usize) -> bool {
        let n = self.values.len();
        let Jacobian { state, calibration } = &self.jacobian;
        self.variance.len() == n
            && self.coefficients.len() == n
            && self.coefficients.iter().all(|own| own.constant.iter().all(|entry| entry.0 < q))
            && state.has_shape(n, s.state.values().len())
            && calibration.has_shape(n, s.bias.len())
    }
}

impl TimeVolume {
    /// Keeps that a forecast is made, and what is known before it where a part of the history begins; drops what the window
    /// does not need.
    pub(super) fn keep_forecast(&mut self, window: Duration) {
        if self.corrections.is_none() {
            return;
        }
        let length = self.settings.cycles.div_ceil(2);
        let last = self.memory.history.0.back().map(|part| part.cycles.len());
        if last.is_none_or(|cycles| cycles >= length) {
            let part = Part { start: self.start(), cycles: Vec::new() };
            self.memory.history.0.push_back(part);
        }
        let parts = &mut self.memory.history.0;
        parts.back_mut().expect("there is a part").cycles.push(PastCycle { window: Some(window), observed: None });
        if parts.iter().skip(1).map(|part| part.cycles.len()).sum::<usize>() >= self.settings.cycles {
            parts.pop_front();
        }
    }

    fn start(&self) -> Start {
        let Memory { s, sensitivity, reference, window, time, past_times, .. } = &self.memory;
        Start {
            errors: self.errors.memory().clone(),
            s: s.clone(),
            sensitivity: sensitivity.clone(),
            reference: reference.clone(),
            window: window.clone(),
            time: *time,
            past_times: past_times.clone(),
        }
    }

    /// Keeps the observations of the cycle, about the background.
    pub(super) fn keep_observations(&mut self, innovations: &Innovations, coefficients: &[Coefficients]) {
        if self.memory.history.0.is_empty() {
            return;
        }
        let predicted = self.predicted(&innovations.jacobian, coefficients);
        let observed = Observed {
            time: self.memory.time,
            values: innovations.departures.iter().zip(predicted).map(|(departure, own)| departure + own).collect(),
            jacobian: innovations.jacobian.clone(),
            variance: innovations.variance.clone(),
            coefficients: coefficients.to_vec(),
        };
        let cycles = &mut self.memory.history.0.back_mut().expect("it is not empty").cycles;
        match cycles.last_mut() {
            Some(cycle) if cycle.observed.is_none() => cycle.observed = Some(observed),
            _ => cycles.push(PastCycle { window: None, observed: Some(observed) }),
        }
    }

    /// H s + F^y C as believed.
    fn predicted(&self, jacobian: &Jacobian, coefficients: &[Coefficients]) -> Vec<f64> {
        let Memory { s, reference, .. } = &self.memory;
        let row = |(row, own): (usize, &Coefficients)| {
            let constant: f64 = own.constant.iter().map(|&(k, value)| value * reference[k]).sum();
            jacobian.state.row_dot(row, s.state.values()) + jacobian.calibration.row_dot(row, &s.bias) + constant
        };
        coefficients.iter().enumerate().map(row).collect()
    }

    /// Whether one of the corrections has moved far.
    fn is_far(&self, shift: &[f64]) -> bool {
        let q = self.unknowns();
        let unit = |k: usize| -> Vec<f64> { (0..q).map(|j| f64::from(u8::from(j == k))).collect() };
        let mut chosen = (self.constant.len()..q).filter(|&k| self.memory.active[k]);
        chosen.any(|k| shift[k].abs() > FAR * self.memory.posterior.sigma(&unit(k)))
    }

    /// Runs the window's cycles again as long as a correction has moved far, given the last move.
    ///
    /// # Errors
    /// Those of forecast and analysis.
    pub(super) fn settle(&mut self, mut shift: Vec<f64>) -> Result<(), Error> {
        for _ in 0..MOST_RUNS {
            if self.memory.history.0.is_empty() || !self.is_far(&shift) {
                return Ok(());
            }
            self.run_again()?;
            self.select();
            shift = self.solve_and_move()?;
        }
        Ok(())
    }

    /// Runs the cycles of the history again, with the reference as it is.
    fn run_again(&mut self) -> Result<(), Error> {
        let History(mut parts) = std::mem::take(&mut self.memory.history);
        let last = parts.iter().map(|part| part.cycles.len()).sum::<usize>();
        let mut number = 0;
        for (position, part) in parts.iter_mut().enumerate() {
            if position == 0 {
                self.go_back(&part.start)?;
            }
            part.start = self.start();
            for PastCycle { window, observed } in &part.cycles {
                if let Some(window) = window {
                    self.advance(*window)?;
                }
                number += 1;
                let Some(observed) = observed else { continue };
                self.update_again(observed)?;
                // The last one is remembered once it is settled.
                if number < last {
                    self.remember();
                }
            }
        }
        self.memory.history = History(parts);
        Ok(())
    }

    fn update_again(&mut self, observed: &Observed) -> Result<(), Error> {
        let Observed { time, values, jacobian, variance, coefficients } = observed;
        self.memory.time = *time;
        let predicted = self.predicted(jacobian, coefficients);
        let innovations = Innovations {
            departures: values.iter().zip(predicted).map(|(value, own)| value - own).collect(),
            jacobian: jacobian.clone(),
            variance: variance.clone(),
            state_values: self.memory.s.state.values().len(),
        };
        self.update(&innovations, coefficients).map(|_| ())
    }

    /// Takes what was known at a start, about the reference as it is now.
    fn go_back(&mut self, start: &Start) -> Result<(), Error> {
        self.errors.recall(start.errors.clone(), &start.s)?;
        let memory = &mut self.memory;
        memory.s = start.s.clone();
        memory.sensitivity = start.sensitivity.clone();
        memory.window = start.window.clone();
        (memory.time, memory.past_times) = (start.time, start.past_times.clone());
        let now = std::mem::replace(&mut memory.reference, start.reference.clone());
        let shift: Vec<f64> = now.iter().zip(&start.reference).map(|(now, then)| now - then).collect();
        self.shift_reference(&shift);
        Ok(())
    }
}
