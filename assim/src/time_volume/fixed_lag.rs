//! The fixed-lag smoother of a time volume: ŝ_{t−l} of (25) of WO 97/18442 for the last cycles.
//!
//! Given C the earlier analyses are those of the Fast Kalman Filter's smoother (`errors::blocks::fixed_lag`), and the rows of
//! the sensitivities that their errors have, U_{t−l} = ∂ŝ_{t−l}/∂C, go through the analyses with those of now:
//!
//! ```text
//! analysis   U_{t-l} ← U_{t-l} + Ψ_l T,     T = ∂ξ/∂C
//! window     ŝ_{t-l}(Ĉ) = ŝ_{t-l}(C_0) + U_{t-l} (Ĉ − C_0),     Cov = Cov(ŝ_{t-l} | C) + U_{t-l} S U_{t-l}ᵀ
//! ```
//!
//! The unknowns C themselves are smoothed by being constant.

use super::history::History;
use super::report::Believed;
use super::{Memory, TimeVolume};
use crate::assimilator::Smoother;
use crate::augmented::Augmented;
use crate::error::Error;
use crate::estimate::Estimate;
use crate::filter::Errors;

impl TimeVolume {
    /// The same with a smoother that revises the last `lag` analyses by the newer observations.
    ///
    /// # Errors
    /// Those of [`FastKalmanFilter::smoothing`](crate::fast_kalman::FastKalmanFilter::smoothing).
    pub fn smoothing(mut self, lag: usize) -> Result<Self, Error> {
        self.errors.smooth(lag)?;
        Ok(self)
    }

    /// Takes in the newest analysis.
    pub(super) fn remember(&mut self) {
        if self.errors.smoother().is_some() {
            self.errors.remember(&self.memory.s);
            self.memory.sensitivity.remember();
            self.memory.past_times.push_back(self.memory.time);
        }
    }

    /// Drops the times of the analyses that the forecast of the errors has dropped.
    pub(super) fn drop_past_times(&mut self) {
        let Memory { past_times, sensitivity, .. } = &mut self.memory;
        past_times.drain(..past_times.len() - sensitivity.past.len());
    }

    /// Forgets the earlier analyses and cycles: what follows is independent of them.
    pub(super) fn forget(&mut self) {
        self.memory.sensitivity.past.clear();
        self.memory.past_times.clear();
        self.memory.history = History::default();
    }
}

impl Smoother for TimeVolume {
    fn lag(&self) -> usize {
        self.errors.smoother().map_or(0, |smoother| smoother.lag())
    }

    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        let past = self.errors.smoother().and_then(|smoother| smoother.estimate(analyses_ago));
        let Some((Augmented { state, bias }, variances)) = past else { return Ok(None) };
        let number = self.memory.past_times.len() - 1 - analyses_ago;
        let name = "the covariance of a smoothed estimate";
        let given =
            Estimate::with_variances(state.clone(), bias.clone(), &self.calibration, variances, name, |_| None)?;
        let rows = (&self.errors.factors().past[number], &self.memory.sensitivity.past[number]);
        let m = state.values().len();
        let beside_factors = |parameter: usize| {
            let row = self.errors.row_of_parameter(rows.0, parameter);
            variances[m + parameter] - row.iter().map(|value| value * value).sum::<f64>()
        };
        let believed = Believed { bias, factors: rows.0, sensitivity: rows.1, time: self.memory.past_times[number] };
        Ok(Some(self.with_unknowns(given, &believed, beside_factors)))
    }
}
