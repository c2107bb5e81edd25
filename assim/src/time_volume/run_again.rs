//! The cycles of the window, which are run again when a correction has moved: the Gauss–Newton method for eq. (24) of
//! WO 97/18442.
//!
//! What is sought is the least sum of squares of all cycles of the window, which the innovations of the filter with the model
//! A(r) make up:
//!
//! ```text
//! Q(r) = Σ_t d_t(r)' T_t^-1 d_t(r),     −½ ∂Q/∂r = j = Σ_t G_t' T_t^-1 d_t,     ½ ∂²Q/∂r² ≈ J = Σ_t G_t' T_t^-1 G_t
//! ```
//!
//! with G = −∂d/∂r; J^-1 is the claimed covariance, where G is that of the least. What a cycle has left in the window was found
//! where r̂ was then. Once r̂ has moved by δ, d_t(r̂) is not d_t − G δ: ŝ + U δ and the innovations are wrong by terms of second
//! order, (∂U/∂r) δ²/2, which neither P nor J^-1 contains. So after a move of a correction by more than [`FAR`] claimed standard
//! deviations the cycles of the window are run again with A(r̂) and the same observations, which gives d and G at r̂, until r̂
//! stays:
//!
//! ```text
//! start      ŝ ← ŝ + U δ,   P ← P + U_r (δ δ' + S_rr) U_r',   U_r ← 0        before the first of them (`restart`)
//! each       forecast and analysis with A(r̂), whose J and j take the place of the old ones
//! window     δ = J^-1 j
//! ```
//!
//! At the beginning of the experiment U = 0, so that a run from there finds the least of Q for all observations. Where d is linear
//! in r the first solution is that, and running again changes nothing.
//!
//! The observations are those of the first run as linear rows, y' = d + H s + F^y C with H as it was at the background then.
//! States from which to start are kept at every half of a window, so that up to one and a half windows are run again.

use super::history::{Event, History, Part};
use super::observed::{Coefficients, Observed};
use super::{Memory, TimeVolume};
use crate::error::Error;
use crate::errors::blocks::BlockErrors;
use crate::filter::Errors;
use crate::problem::Innovations;
use isobar_model::Duration;
use isobar_obs::Jacobian;

/// Claimed standard deviations beyond which a move is far.
const FAR: f64 = 1.0;

/// How often the cycles are run again at most after an analysis.
const MOST_RUNS: usize = 4;

impl TimeVolume {
    /// Keeps that a forecast is made, and where a part of the history begins what is known before it; drops what the window
    /// does not need.
    pub(super) fn keep_forecast(&mut self, window: Duration) {
        if self.corrections.is_none() {
            return;
        }
        let mut history = std::mem::take(&mut self.memory.history);
        let parts = &mut history.0;
        if parts.back().is_none_or(|part| part.analyses() >= self.settings.cycles.div_ceil(2)) {
            let (errors, memory) = self.as_of_now();
            parts.push_back(Part { errors, memory, events: Vec::new() });
            if parts.iter().skip(1).map(Part::analyses).sum::<usize>() >= self.settings.cycles {
                parts.pop_front();
            }
        }
        parts.back_mut().expect("there is a part").events.push(Event::Forecast(window));
        self.memory.history = history;
    }

    fn as_of_now(&self) -> (<BlockErrors as Errors>::Memory, Memory) {
        (self.errors.memory().clone(), self.memory.clone())
    }

    /// Keeps the observations of the cycle, about the background.
    pub(super) fn keep_observations(&mut self, innovations: &Innovations, coefficients: &[Coefficients]) {
        if self.memory.history.0.is_empty() {
            return;
        }
        let predicted = self.predicted(&innovations.jacobian, coefficients);
        let part = self.memory.history.0.back_mut().expect("it is not empty");
        part.events.push(Event::Analysis(Observed {
            time: self.memory.time,
            values: innovations.departures.iter().zip(predicted).map(|(departure, own)| departure + own).collect(),
            jacobian: innovations.jacobian.clone(),
            variance: innovations.variance.clone(),
            coefficients: coefficients.to_vec(),
        }));
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

    /// Whether one of the corrections has moved far: by more than the observations alone leave open, without a prior that was found.
    fn is_far(&self, shift: &[f64]) -> bool {
        let Memory { active, precisions, posterior, .. } = &self.memory;
        let is_far = |k: usize| {
            let information = 1.0 / posterior.variance(k) - precisions[k];
            shift[k].powi(2) * information > FAR * FAR
        };
        (self.constant.len()..self.unknowns()).any(|k| active[k] && is_far(k))
    }

    /// Runs the window's cycles again as long as a correction has moved far, given the last move.
    ///
    /// # Errors
    /// Those of forecast and analysis.
    pub(super) fn settle(&mut self, mut shift: Vec<f64>) -> Result<(), Error> {
        for _ in 0..MOST_RUNS {
            if self.memory.history.0.is_empty() || !self.is_far(&shift) {
                break;
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
        let mut left = parts.iter().map(|part| part.events.len()).sum::<usize>();
        for (number, part) in parts.iter_mut().enumerate() {
            if number == 0 {
                self.go_back(part)?;
            } else {
                (part.errors, part.memory) = self.as_of_now();
            }
            for event in &part.events {
                left -= 1;
                match event {
                    Event::Forecast(window) => self.advance(*window)?,
                    Event::Analysis(observed) => {
                        self.update_again(observed)?;
                        // The newest is remembered once it has settled.
                        if left > 0 {
                            self.remember();
                        }
                    }
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
        self.update(&innovations, coefficients).map(drop)
    }

    /// Takes what was known at the start of a part, about the reference as it is now.
    fn go_back(&mut self, part: &Part<Memory>) -> Result<(), Error> {
        self.errors.recall(part.errors.clone(), &part.memory.s)?;
        let now = std::mem::replace(&mut self.memory, part.memory.clone());
        let Memory { reference, posterior, active, precisions, .. } = now;
        let shift: Vec<f64> = reference.iter().zip(&self.memory.reference).map(|(now, then)| now - then).collect();
        (self.memory.posterior, self.memory.active, self.memory.precisions) = (posterior, active, precisions);
        self.shift_reference(&shift);
        self.begin_anew(&shift);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
