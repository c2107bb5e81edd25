//! The fixed-lag smoother of the dense Kalman filter.

use crate::augmented::Augmented;
use crate::error::Error;
use crate::innovation_covariance::InnovationCovariance;
use crate::linalg::{add_product, column, product, solved_lower, squared_norm};
use crate::memory::{Matrix, require};
use crate::problem::Innovations;
use faer::{Mat, MatRef};
use isobar_model::vector::scale;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The last analyses of a method with a smoother, as they are known now.
pub(crate) trait PastAnalyses {
    /// The number of analyses before the newest that are revised.
    fn lag(&self) -> usize;

    /// State and parameters at the analysis `analyses_ago` before the newest, and the variances `[m + p]` of what is
    /// estimated; `None` if there was none, or it is out of reach.
    fn estimate(&self, analyses_ago: usize) -> Option<(&Augmented, &[f64])>;
}

/// The estimates of the last analyses given all observations up to now, and what it takes to revise them.
///
/// The error of an earlier analysis j and that of the background now have the covariance `Cov(e_j, e_t) = P_j Φᵀ`, where
/// `Φ = A_t (I − K_{t−1} H_{t−1}) … A_{j+1}` takes the one to the other and what is added on the way, the model error and
/// the drift of biases, is independent of e_j. With `H P_t Hᵀ + R = L Lᵀ`, `W = Hᵀ L⁻ᵀ` and `V = Φᵀ W`, the observations
/// y_t, with innovations d, therefore mean for it
///
/// ```text
/// G = P_j V,    s_j ← s_j + G L⁻¹ d,    Cov_jj ← Cov_jj − G Gᵀ
/// ```
///
/// This is the augmented-state form of the fixed-lag smoother (Anderson and Moore 1979, Optimal Filtering, section 7.3), with
/// V found backwards as in the modified Bryson–Frazier form of the Rauch–Tung–Striebel smoother (Bierman 1973, Automatica 9,
/// 465–471): `V ← Aᵀ V` through a forecast and `V ← V − W_i (P_i W_i)ᵀ V` through the analysis i, which is `(I − K_i H_i)ᵀ V`.
/// No covariance is inverted, so that it may be singular. n observations cost n (m + p)² for each analysis that is revised;
/// nothing is cubic in the number of unknowns.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct FixedLag {
    lag: usize,
    /// The oldest first, at most `lag` and the last one.
    analyses: VecDeque<PastAnalysis>,
}

/// An analysis j, as it is known now.
#[derive(Clone, Serialize, Deserialize)]
struct PastAnalysis {
    /// ŝ_j given all observations so far.
    s: Augmented,
    /// The diagonal of its covariance, `[m + p]`.
    variances: Vec<f64>,
    /// P_j given the observations up to j, `[m + p, m + p]`.
    covariance: Matrix,
    /// A_{j+1} of the state, `[m, m]`; `None` before the next forecast.
    propagator: Option<Matrix>,
    /// A_{j+1} of the parameters, φ, `[p]`; `None` if they persist.
    kept: Option<Vec<f64>>,
    /// Its own observations.
    whitened: Whitened,
}

/// What n observations say, in units of their innovations' standard deviations.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Whitened {
    /// Wᵀ = L⁻¹ H, `[n, m + p]`.
    jacobian: Matrix,
    /// (P W)ᵀ = L⁻¹ H P, `[n, m + p]`.
    cross: Matrix,
    /// L⁻¹ d, `[n, 1]`; without rows once all analyses are revised.
    departures: Matrix,
}

impl Whitened {
    /// Before an analysis, with the covariance of the background, `[m + p, m + p]`.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]: H P Hᵀ + R is not.
    pub fn new(covariance: MatRef<'_, f64>, innovations: &Innovations) -> Result<Self, Error> {
        let InnovationCovariance { cross, root } = InnovationCovariance::new(covariance, innovations)?;
        let n = innovations.len();
        let mut rows = Mat::zeros(n, covariance.nrows());
        for row in 0..n {
            innovations.row(row).for_each(|(column, weight)| rows[(row, column)] += weight);
        }
        let [jacobian, cross, departures] = [rows, cross.transpose().to_owned(), column(&innovations.departures)]
            .map(|part| Matrix(solved_lower(root.as_ref(), part)));
        Ok(Self { jacobian, cross, departures })
    }
}

impl FixedLag {
    /// A smoother of the last `lag` analyses before the newest.
    pub fn new(lag: usize) -> Self {
        Self { lag, analyses: VecDeque::with_capacity(lag + 1) }
    }

    /// How many numbers a smoother of `lag` analyses with `unknowns` values each, m + p, and n observations holds: P and A,
    /// and what the observations say, of each; beside them H P Hᵀ + R, P Hᵀ and a copy of what they say.
    pub fn numbers(lag: usize, unknowns: usize, observations: usize) -> f64 {
        let (size, n) = (unknowns as f64, observations as f64);
        2.0 * (lag as f64 + 1.0) * (size * size + size * n) + 4.0 * size * n + n * n
    }

    /// Takes in a forecast with the propagator A of the state, `[m, m]`, and φ of the parameters if they do not persist.
    pub fn forecast(&mut self, propagator: MatRef<'_, f64>, kept: Option<&[f64]>) {
        let Some(last) = self.analyses.back_mut() else { return };
        if let Some(kept) = kept {
            let all = last.kept.get_or_insert_with(|| vec![1.0; kept.len()]);
            all.iter_mut().zip(kept).for_each(|(all, kept)| *all *= kept);
        }
        last.propagator = Some(Matrix(match last.propagator.take() {
            None => propagator.to_owned(),
            Some(earlier) => product(propagator, earlier.as_ref()),
        }));
    }

    /// Revises the earlier analyses by the observations of a new one.
    fn revise(&mut self, whitened: &Whitened) {
        while self.analyses.len() > self.lag {
            self.analyses.pop_front();
        }
        if whitened.departures.nrows() == 0 {
            return;
        }
        // Vᵀ, row by row.
        let mut sensitivity = whitened.jacobian.0.clone();
        for past in self.analyses.iter_mut().rev() {
            if let Some(propagator) = &past.propagator {
                let m = propagator.nrows();
                let earlier = product(sensitivity.as_ref().get(.., ..m), propagator.as_ref());
                sensitivity.as_mut().get_mut(.., ..m).copy_from(earlier);
            }
            for (number, kept) in past.kept.iter().flatten().enumerate() {
                let first = past.s.state.values().len();
                scale(sensitivity.col_as_slice_mut(first + number), *kept);
            }
            let gain = product(sensitivity.as_ref(), past.covariance.as_ref());
            let increment = product(gain.transpose(), whitened.departures.as_ref());
            past.s.add(increment.col_as_slice(0));
            for (j, variance) in past.variances.iter_mut().enumerate() {
                *variance -= squared_norm(gain.col_as_slice(j));
            }
            if past.whitened.cross.nrows() > 0 {
                let through = product(sensitivity.as_ref(), past.whitened.cross.transpose());
                add_product(sensitivity.as_mut(), -1.0, through.as_ref(), past.whitened.jacobian.as_ref());
            }
        }
    }

    /// Takes in the newest analysis, which revises the earlier ones, with its covariance `[m + p, m + p]`.
    pub fn add(&mut self, s: Augmented, covariance: MatRef<'_, f64>, mut whitened: Whitened) {
        self.revise(&whitened);
        whitened.departures = Matrix(Mat::zeros(0, 1));
        let variances = (0..covariance.nrows()).map(|i| covariance[(i, i)]).collect();
        let covariance = Matrix(covariance.to_owned());
        self.analyses.push_back(PastAnalysis { s, variances, covariance, propagator: None, kept: None, whitened });
    }

    /// Forgets all analyses: what follows is independent of them.
    pub fn clear(&mut self) {
        self.analyses.clear();
    }

    /// Fails unless it is a smoother of this lag, of estimates like `s` with `size` = m + p unknowns.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require(&self, lag: usize, s: &Augmented, size: usize) -> Result<(), Error> {
        require(self.lag == lag && self.analyses.len() <= lag + 1, "the number of earlier analyses")?;
        let m = s.state.values().len();
        for past in &self.analyses {
            past.s.require_like(s)?;
            let Whitened { jacobian, cross, departures } = &past.whitened;
            let fits = past.variances.len() == size
                && past.covariance.has_shape(size, size)
                && past.propagator.as_ref().is_none_or(|propagator| propagator.has_shape(m, m))
                && past.kept.as_ref().is_none_or(|kept| kept.len() == size - m)
                && jacobian.has_shape(cross.nrows(), size)
                && cross.ncols() == size
                && departures.has_shape(0, 1);
            require(fits, "an earlier analysis")?;
        }
        Ok(())
    }
}

impl PastAnalyses for FixedLag {
    fn lag(&self) -> usize {
        self.lag
    }

    fn estimate(&self, analyses_ago: usize) -> Option<(&Augmented, &[f64])> {
        let past = self.analyses.get(self.analyses.len().checked_sub(analyses_ago + 1)?)?;
        Some((&past.s, &past.variances))
    }
}
