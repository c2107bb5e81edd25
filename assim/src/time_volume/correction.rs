//! What may be wrong with a model, and the models that corrections of it lead to.

use crate::error::Error;
use isobar_model::{State, TangentLinear};
use std::sync::Arc;

/// One candidate operator.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Its name: `mean_depth_m`.
    pub name: String,
    /// Unit of its amplitudes, in UDUNITS spelling.
    pub unit: String,
    /// Step of the central difference by which M is found: small against what matters, large against rounding.
    pub step: f64,
    /// Standard deviation of a prior N(0, σ²) of each amplitude; `None` for no prior.
    pub sigma_prior: Option<f64>,
    /// How it depends on place: an amplitude for each. Empty: the same everywhere.
    pub patterns: Vec<CorrectionPattern>,
    /// Whether the patterns move with the [mean flow](Corrections::mean_flow), from where they are at the start.
    pub moves_with_flow: bool,
}

impl Candidate {
    /// Number of its amplitudes: one for each pattern, or one that is the same everywhere.
    pub(super) fn amplitudes(&self) -> usize {
        self.patterns.len().max(1)
    }
}

/// How a correction depends on place.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectionPattern {
    /// Its name among those of its candidate: `tile x1 y2`.
    pub name: String,
    /// `[y, x]`, by which all variables of a cell are weighted.
    pub weights: Vec<f64>,
}

/// The forecast models that corrections lead to.
pub trait Corrections: Send + Sync {
    /// The candidates.
    fn candidates(&self) -> &[Candidate];

    /// The model with these corrections of its parameters, one for each candidate, that are the same everywhere.
    ///
    /// # Errors
    /// If there is no such model: a negative depth.
    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error>;

    /// The flow of a state, averaged over the domain, eastward and northward \[m/s\]: that of the patterns that move with it.
    fn mean_flow(&self, _: &State) -> [f64; 2] {
        [0.0; 2]
    }
}

/// An amplitude r_ck.
pub(super) struct Correction {
    /// Number c of the candidate.
    pub candidate: usize,
    /// Number k of its pattern; `None` if it is the same everywhere.
    pub pattern: Option<usize>,
    /// Its name, that of the pattern included.
    pub name: String,
}
