//! State-transition corrections dA: WO 97/18442, eqs. (22), (23).
//!
//! `s_t = (A + dA) s_{t-1}`, `dA s = M(s) r`. A full M has m² columns, which no observations could determine; it is
//! compressed to a few candidates, each an error of one parameter θ_c of the model, the same everywhere or with patterns
//! w_ck in space, and so with an amplitude r_ck for each of these: θ_c is wrong by the field ρ_c = Σ_k r_ck w_ck.

use super::corrected_model::CorrectedModel;
use super::correction::{Candidate, Correction, Corrections};
use super::moved_patterns;
use crate::error::Error;
use crate::tall_matrix::TallMatrix;
use isobar_model::{Duration, Grid, State, TangentLinear};
use std::sync::Arc;

/// The corrections of a time volume.
#[derive(Clone)]
pub(super) struct Transition {
    pub family: Arc<dyn Corrections>,
    /// Its candidates, with the patterns where they are now.
    candidates: Arc<[Candidate]>,
    grid: Grid,
    /// r.
    pub amplitudes: Arc<[Correction]>,
    /// The model with those of the reference.
    corrected: Arc<CorrectedModel>,
}

impl Transition {
    /// With all amplitudes at zero, on a grid.
    ///
    /// # Errors
    /// [`Error::Setting`] if a pattern is not of this grid; those of the family.
    pub fn new(family: Arc<dyn Corrections>, grid: &Grid) -> Result<Self, Error> {
        let cells = grid.cells();
        for candidate in family.candidates() {
            if let Some(pattern) = candidate.patterns.iter().find(|pattern| pattern.weights.len() != cells) {
                let (name, length) = (&candidate.name, pattern.weights.len());
                let message = format!("correction {name}: a pattern has {length} values, but the grid {cells} cells");
                return Err(Error::Setting(message));
            }
        }
        let amplitudes = amplitudes(family.candidates());
        let candidates: Arc<[Candidate]> = family.candidates().into();
        let corrected = Arc::new(CorrectedModel::new(&*family, &candidates, &vec![0.0; amplitudes.len()])?);
        Ok(Self { family, candidates, grid: grid.clone(), amplitudes: amplitudes.into(), corrected })
    }

    /// Changes the amplitudes.
    ///
    /// # Errors
    /// If there is no such model.
    pub fn set(&mut self, r: &[f64]) -> Result<(), Error> {
        self.corrected = Arc::new(CorrectedModel::new(&*self.family, &self.candidates, r)?);
        Ok(())
    }

    /// Moves the patterns that move with the flow to where they are on average in a window that begins with `state`, when they have
    /// moved by `moved_m` from the start; then `moved_m` is by how much they have at the end of the window.
    ///
    /// # Errors
    /// If there is no model with the amplitudes `r` of the patterns where they are.
    pub fn move_patterns(
        &mut self,
        moved_m: &mut [f64; 2],
        state: &State,
        window: Duration,
        r: &[f64],
    ) -> Result<(), Error> {
        if !self.candidates.iter().any(|it| it.moves_with_flow) {
            return Ok(());
        }
        let half = self.family.mean_flow(state).map(|speed| 0.5 * speed * window.seconds() as f64);
        let middle = [moved_m[0] + half[0], moved_m[1] + half[1]];
        *moved_m = [middle[0] + half[0], middle[1] + half[1]];
        self.candidates = moved_patterns::moved(self.family.candidates(), &self.grid, middle).into();
        self.set(r)
    }

    /// The corrected model.
    pub fn model(&self) -> Arc<dyn TangentLinear> {
        self.corrected.model()
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
        self.corrected.columns(&self.candidates, &self.amplitudes, state, steps)
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
