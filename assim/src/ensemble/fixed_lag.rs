//! The fixed-lag ensemble Kalman smoother.

use super::members::Ensemble;
use super::moments::{Moments, spread};
use crate::error::Error;
use crate::memory::require;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The analysed ensembles of the last cycles given all observations up to now (Evensen and van Leeuwen 2000, Mon. Wea. Rev.
/// 128, 1852–1867): what an analysis makes of the members now, it makes of their earlier states as well, since each
/// observation is regressed on them by the same members. It equals the ensemble form of the Rauch–Tung–Striebel smoother
/// (Raanes 2016, Q. J. R. Meteorol. Soc. 142, 1259–1264).
///
/// With the transform `A = I + Ỹᵀ Ỹ` of [`super::transform`] an earlier ensemble gets `x̄ ← x̄ + X A⁻¹ Ỹᵀ d̃ / √(N−1)` and
/// `X ← X A^-½`, without the inflation and the relaxation of the present one: these are remedies for the forecasts that follow,
/// and none follow from the past (DAPPER's `EnKS` and PDAF do the same). No eigenvalue of A^-½ is above one, and so no variance
/// grows.
///
/// *Localised.* Each place of an earlier ensemble, and each of its biases, is regressed with the weights that the place or the
/// bias has in the present analysis (Khare, Anderson, Hoar and Nychka 2008, Tellus 60A, 97–112; Nerger, Schulte and
/// Bunse-Gerstner 2014, Q. J. R. Meteorol. Soc. 140, 2249–2259): the local transform of
/// [`LocalEnsembleTransformKalmanFilter`](super::LocalEnsembleTransformKalmanFilter), the tapered gain
///
/// ```text
/// x_i ← x_i + (ρ ∘ X Ỹᵀ) S⁻¹ R^-½ (y + ε_i − h(x_i)) / √(N−1)
/// ```
///
/// of [`StochasticEnsembleKalmanFilter`](super::StochasticEnsembleKalmanFilter), with the earlier perturbations X, and the
/// present innovations and their covariance S. The taper ρ is therefore fixed in space: it does not move with the flow, although
/// what was here at the time of the earlier ensemble may be elsewhere by now.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct FixedLag {
    lag: usize,
    /// The oldest first, at most `lag` and the last one.
    ensembles: VecDeque<Moments>,
}

impl FixedLag {
    /// A smoother of the last `lag` analyses before the newest.
    pub fn new(lag: usize) -> Self {
        Self { lag, ensembles: VecDeque::with_capacity(lag + 1) }
    }

    /// The number of analyses before the newest that are revised.
    pub fn lag(&self) -> usize {
        self.lag
    }

    /// Drops what is out of reach of the next analysis.
    pub fn shorten(&mut self) {
        while self.ensembles.len() > self.lag {
            self.ensembles.pop_front();
        }
    }

    /// The earlier ensembles, for an analysis to revise.
    pub fn earlier(&mut self) -> impl Iterator<Item = &mut Moments> {
        self.ensembles.iter_mut()
    }

    /// Takes in the newest ensemble.
    pub fn push(&mut self, analysed: Moments) {
        self.ensembles.push_back(analysed);
    }

    /// The mean `[m + p]` of the ensemble `analyses_ago` before the newest, and the standard deviations; `None` if there
    /// was none, or it is out of reach.
    pub fn estimate(&self, analyses_ago: usize) -> Option<(&[f64], Vec<f64>)> {
        let past = self.ensembles.get(self.ensembles.len().checked_sub(analyses_ago + 1)?)?;
        Some((&past.mean, spread(&past.perturbations)))
    }

    /// Fails unless it is a smoother of this lag, of ensembles like this one.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require(&self, lag: usize, like: &Ensemble) -> Result<(), Error> {
        require(self.lag == lag && self.ensembles.len() <= lag + 1, "the number of earlier ensembles")?;
        let (rows, members) = (like.values().nrows(), like.members());
        let fits = |past: &Moments| past.mean.len() == rows && past.perturbations.has_shape(rows, members);
        require(self.ensembles.iter().all(fits), "an earlier ensemble")
    }
}
