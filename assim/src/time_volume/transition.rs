//! State-transition corrections dA: WO 97/18442, eqs. (22), (23).
//!
//! `s_t = (A + dA) s_{t-1}`, `dA s = M(s) r`. A full M has m² columns, which no observations could determine; it is
//! compressed to a few candidates, each an error of one parameter of the model, with the column of M the derivative of the
//! forecast by that parameter at the current state.

use crate::error::Error;
use crate::tall_matrix::TallMatrix;
use isobar_model::{State, TangentLinear, forecast};
use rayon::prelude::*;
use std::sync::Arc;

/// One candidate operator.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Its name: `mean_depth_m`.
    pub name: String,
    /// Unit of its amplitude, in UDUNITS spelling.
    pub unit: String,
    /// Step of the central difference by which M is found: small against what matters, large against rounding.
    pub step: f64,
    /// Standard deviation of a prior N(0, σ²) of the amplitude; `None` for no prior.
    pub sigma_prior: Option<f64>,
}

/// The forecast models that corrections lead to.
pub trait Corrections: Send + Sync {
    /// The candidates.
    fn candidates(&self) -> &[Candidate];

    /// The model with these corrections, one for each candidate.
    ///
    /// # Errors
    /// If there is no such model: a negative depth.
    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error>;
}

/// M(s) over a cycle: derivatives of the forecast from `state` by each correction, `[m, candidates]`.
///
/// Central differences, of second order in the step and so exact for what is linear in a parameter; one-sided where the
/// model on one side does not exist.
pub(super) fn columns(
    family: &dyn Corrections,
    corrections: &[f64],
    state: &State,
    steps: usize,
) -> Result<TallMatrix, Error> {
    let forecast_with = |candidate: usize, sign: f64| -> Result<State, Error> {
        let mut moved = corrections.to_vec();
        moved[candidate] += sign * family.candidates()[candidate].step;
        let model = family.model(&moved)?;
        let mut state = state.clone();
        forecast::forecast(&*model, &mut state, steps)?;
        Ok(state)
    };
    let derivative = |candidate: usize| -> Result<Vec<f64>, Error> {
        let step = family.candidates()[candidate].step;
        let (above, below) = (forecast_with(candidate, 1.0), forecast_with(candidate, -1.0));
        let (above, below, width) = match (above, below) {
            (Ok(above), Ok(below)) => (above, below, 2.0 * step),
            (Ok(above), Err(_)) => (above, forecast_with(candidate, 0.0)?, step),
            (Err(_), Ok(below)) => (forecast_with(candidate, 0.0)?, below, step),
            (Err(error), Err(_)) => return Err(error),
        };
        Ok(above.values().iter().zip(below.values()).map(|(above, below)| (above - below) / width).collect())
    };
    let count = family.candidates().len();
    let columns: Vec<Vec<f64>> = (0..count).into_par_iter().map(derivative).collect::<Result<_, _>>()?;
    Ok(TallMatrix::from_values(state.values().len(), count, columns.concat()))
}
