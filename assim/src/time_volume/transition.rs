//! State-transition corrections dA: WO 97/18442, eqs. (22), (23).
//!
//! `s_t = (A + dA) s_{t-1}`, `dA s = M(s) r`. A full M has m² columns, which no observations could determine; it is
//! compressed to a few candidates, each an error of one parameter θ_c of the model, the same everywhere or with patterns
//! w_ck in space, and so with an amplitude r_ck for each of these: θ_c is wrong by the field ρ_c = Σ_k r_ck w_ck.

use super::corrected_model::CorrectedModel;
use crate::error::Error;
use crate::tall_matrix::TallMatrix;
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

/// The corrections of a time volume.
#[derive(Clone)]
pub(super) struct Transition {
    pub family: Arc<dyn Corrections>,
    /// r.
    pub amplitudes: Arc<[Correction]>,
    /// The model with those of the reference.
    pub corrected: Arc<CorrectedModel>,
}

impl Transition {
    /// With all amplitudes at zero, on a grid of `cells`.
    ///
    /// # Errors
    /// [`Error::Setting`] if a pattern is not of this grid; those of the family.
    pub fn new(family: Arc<dyn Corrections>, cells: usize) -> Result<Self, Error> {
        for candidate in family.candidates() {
            if let Some(pattern) = candidate.patterns.iter().find(|pattern| pattern.weights.len() != cells) {
                let (name, length) = (&candidate.name, pattern.weights.len());
                let message = format!("correction {name}: a pattern has {length} values, but the grid {cells} cells");
                return Err(Error::Setting(message));
            }
        }
        let amplitudes = amplitudes(family.candidates());
        let corrected = Arc::new(CorrectedModel::new(&*family, &vec![0.0; amplitudes.len()])?);
        Ok(Self { family, amplitudes: amplitudes.into(), corrected })
    }

    /// Moves the amplitudes.
    ///
    /// # Errors
    /// If there is no such model.
    pub fn set(&mut self, r: &[f64]) -> Result<(), Error> {
        self.corrected = Arc::new(CorrectedModel::new(&*self.family, r)?);
        Ok(())
    }

    /// The candidate of an amplitude.
    pub fn candidate(&self, amplitude: &Correction) -> &Candidate {
        &self.family.candidates()[amplitude.candidate]
    }

    /// Standard deviations of the amplitudes' priors.
    pub fn sigma_priors(&self) -> impl Iterator<Item = Option<f64>> {
        self.amplitudes.iter().map(|amplitude| self.candidate(amplitude).sigma_prior)
    }

    /// M(s) over a cycle from `state`, `[m, amplitudes]`.
    ///
    /// # Errors
    /// Those of [`CorrectedModel::columns`].
    pub fn columns(&self, state: &State, steps: usize) -> Result<TallMatrix, Error> {
        self.corrected.columns(self.family.candidates(), &self.amplitudes, state, steps)
    }
}

/// The amplitudes of the candidates, in their order.
fn amplitudes(candidates: &[Candidate]) -> Vec<Correction> {
    let of = |(number, candidate): (usize, &Candidate)| -> Vec<Correction> {
        let one = |pattern, name| Correction { candidate: number, pattern, name };
        if candidate.patterns.is_empty() {
            return vec![one(None, candidate.name.clone())];
        }
        let patterns = candidate.patterns.iter().enumerate();
        patterns.map(|(k, pattern)| one(Some(k), format!("{}/{}", candidate.name, pattern.name))).collect()
    };
    candidates.iter().enumerate().flat_map(of).collect()
}
