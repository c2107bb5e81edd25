//! The fixed-lag ensemble Kalman smoother.

use super::members::{Moments, spread};
use crate::error::Error;
use crate::saved::{Matrix, unfit};
use faer::Mat;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The analysed ensembles of the last cycles given all observations up to now (Evensen and van Leeuwen 2000, Mon. Wea. Rev.
/// 128, 1852–1867): what an analysis makes of the members now, it makes of their earlier states as well, since each
/// observation is regressed on them by the same members. It equals the ensemble form of the Rauch–Tung–Striebel smoother
/// (Raanes 2016, Q. J. R. Meteorol. Soc. 142, 1259–1264).
///
/// With the transform `A = I + Ỹᵀ Ỹ` of [`super::transform`] an earlier ensemble gets `x̄ ← x̄ + X A⁻¹ Ỹᵀ d̃ / √(N−1)` and
/// `X ← X A^-½`, without the inflation and the relaxation that the present one gets beside: these are remedies for its
/// further forecasts, which the past has not before it. No eigenvalue of A^-½ is above one, and so no variance grows.
pub(super) struct FixedLag {
    lag: usize,
    /// The oldest first, at most `lag` and the last one.
    ensembles: VecDeque<Moments>,
}

/// What a checkpoint holds of it: mean and perturbations.
#[derive(Serialize, Deserialize)]
pub(super) struct Saved(Vec<(Vec<f64>, Matrix)>);

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

    /// Revises the earlier ensembles by an analysis: the perturbations `[m + p, N + 1]` that it makes of `[m + p, N]`, the last
    /// column being the increment of the mean.
    pub fn revise(&mut self, analysis: impl Fn(&Mat<f64>) -> Mat<f64>) {
        for past in &mut self.ensembles {
            let transformed = analysis(&past.perturbations);
            *past = Moments::of_transformed(std::mem::take(&mut past.mean), &transformed);
        }
    }

    /// Takes in the newest ensemble.
    pub fn push(&mut self, analysed: Moments) {
        self.ensembles.push_back(analysed);
    }

    /// The mean `[m + p]` of the ensemble so many analyses before the newest, and the standard deviations; `None` if there
    /// was none, or it is out of reach.
    pub fn estimate(&self, analyses_ago: usize) -> Option<(&[f64], Vec<f64>)> {
        let past = self.ensembles.get(self.ensembles.len().checked_sub(analyses_ago + 1)?)?;
        Some((&past.mean, spread(&past.perturbations)))
    }

    pub fn save(&self) -> Saved {
        Saved(self.ensembles.iter().map(|past| (past.mean.clone(), (&past.perturbations).into())).collect())
    }

    /// Takes back what [`FixedLag::save`] gave.
    ///
    /// # Errors
    /// [`Error::Saved`] if it is of ensembles of another size.
    pub fn restore(&mut self, saved: Saved, rows: usize, members: usize) -> Result<(), Error> {
        if saved.0.len() > self.lag + 1 {
            return Err(unfit("the number of earlier ensembles"));
        }
        let name = "an earlier ensemble";
        let past = saved.0.into_iter().map(|(mean, perturbations)| match mean.len() == rows {
            true => Ok(Moments { mean, perturbations: perturbations.restored(rows, Some(members), name)? }),
            false => Err(unfit(name)),
        });
        self.ensembles = past.collect::<Result<_, Error>>()?;
        Ok(())
    }
}
