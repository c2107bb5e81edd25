//! The fixed-lag smoother of the dense Kalman filter.

use crate::augmented::entries;
use crate::error::Error;
use crate::kalman::InnovationCovariance;
use crate::linalg::{add_product, column, product, solved_lower, squared_norm};
use crate::problem::Innovations;
use crate::saved::{Matrix, from_bytes, to_bytes, unfit};
use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

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
pub(crate) struct FixedLag {
    lag: usize,
    /// The oldest first, at most `lag` and the last one.
    analyses: VecDeque<PastAnalysis>,
}

/// An analysis j, as it is known now.
struct PastAnalysis {
    /// ŝ_j given all observations so far, `[m + all parameters]`.
    estimate: Vec<f64>,
    /// The diagonal of its covariance, `[m + p]`.
    variances: Vec<f64>,
    /// P_j given the observations up to j, `[m + p, m + p]`.
    covariance: Mat<f64>,
    /// A_{j+1} of the state, `[m, m]`; none before the next forecast.
    propagator: Option<Mat<f64>>,
    /// What it did itself.
    whitened: Whitened,
}

/// What n observations say, in units of their innovations' standard deviations.
pub(crate) struct Whitened {
    /// Wᵀ = L⁻¹ H, `[n, m + p]`.
    jacobian: Mat<f64>,
    /// (P W)ᵀ = L⁻¹ H P, `[n, m + p]`.
    cross: Mat<f64>,
    /// L⁻¹ d, `[n, 1]`; needed no more once all analyses are revised.
    departures: Mat<f64>,
}

impl Whitened {
    /// Before an analysis, with the covariance of the background, `[m + p, m + p]`.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]: H P Hᵀ + R is not.
    pub fn new(covariance: MatRef<'_, f64>, m: usize, innovations: &Innovations) -> Result<Self, Error> {
        let InnovationCovariance { cross, root } = InnovationCovariance::new(covariance, innovations, m)?;
        let (jacobian, n) = (&innovations.jacobian, innovations.departures.len());
        let mut rows = Mat::zeros(n, covariance.nrows());
        for row in 0..n {
            entries(jacobian, row, m).for_each(|(column, weight)| rows[(row, column)] += weight);
        }
        let [jacobian, cross, departures] = [rows, cross.transpose().to_owned(), column(&innovations.departures)]
            .map(|part| solved_lower(root.as_ref(), part));
        Ok(Self { jacobian, cross, departures })
    }
}

/// What a checkpoint holds of an analysis.
#[derive(Serialize, Deserialize)]
struct Saved {
    estimate: Vec<f64>,
    variances: Vec<f64>,
    covariance: Matrix,
    propagator: Option<Matrix>,
    jacobian: Matrix,
    cross: Matrix,
}

impl FixedLag {
    /// A smoother of the last `lag` analyses before the newest.
    pub fn new(lag: usize) -> Self {
        Self { lag, analyses: VecDeque::with_capacity(lag + 1) }
    }

    /// The memory of a smoother of so many analyses with `unknowns` values each, m + p \[bytes\].
    pub fn bytes(lag: usize, unknowns: usize) -> u64 {
        2 * 8 * (lag as u64 + 1) * (unknowns as u64).pow(2)
    }

    /// The number of analyses before the newest that are revised.
    pub fn lag(&self) -> usize {
        self.lag
    }

    /// Takes note of a forecast with the propagator A, `[m, m]`.
    pub fn forecast(&mut self, propagator: MatRef<'_, f64>) {
        let Some(last) = self.analyses.back_mut() else { return };
        last.propagator = Some(match last.propagator.take() {
            None => propagator.to_owned(),
            Some(earlier) => product(propagator, earlier.as_ref()),
        });
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
        let mut sensitivity = whitened.jacobian.clone();
        for past in self.analyses.iter_mut().rev() {
            if let Some(propagator) = &past.propagator {
                let m = propagator.nrows();
                let earlier = product(sensitivity.as_ref().get(.., ..m), propagator.as_ref());
                sensitivity.as_mut().get_mut(.., ..m).copy_from(earlier);
            }
            let gain = product(sensitivity.as_ref(), past.covariance.as_ref());
            let increment = product(gain.transpose(), whitened.departures.as_ref());
            past.estimate.iter_mut().zip(increment.col_as_slice(0)).for_each(|(value, change)| *value += change);
            for (j, variance) in past.variances.iter_mut().enumerate() {
                *variance -= squared_norm(gain.col_as_slice(j));
            }
            if past.whitened.cross.nrows() > 0 {
                let through = product(sensitivity.as_ref(), past.whitened.cross.transpose());
                add_product(sensitivity.as_mut(), -1.0, through.as_ref(), past.whitened.jacobian.as_ref());
            }
        }
    }

    /// Takes in the newest analysis, which revises the earlier ones: state and all parameters, with their covariance
    /// `[m + p, m + p]`.
    pub fn add(&mut self, estimate: Vec<f64>, covariance: MatRef<'_, f64>, mut whitened: Whitened) {
        self.revise(&whitened);
        whitened.departures = Mat::zeros(0, 1);
        let variances = (0..covariance.nrows()).map(|i| covariance[(i, i)]).collect();
        let covariance = covariance.to_owned();
        self.analyses.push_back(PastAnalysis { estimate, variances, covariance, propagator: None, whitened });
    }

    /// Forgets all analyses: what follows is independent of them.
    pub fn clear(&mut self) {
        self.analyses.clear();
    }

    /// State and all parameters at the analysis so many before the newest, and the variances `[m + p]` of those that are
    /// estimated; `None` if there was none, or it is out of reach.
    pub fn estimate(&self, analyses_ago: usize) -> Option<(&[f64], &[f64])> {
        let past = self.analyses.get(self.analyses.len().checked_sub(analyses_ago + 1)?)?;
        Some((&past.estimate, &past.variances))
    }

    /// What a checkpoint holds of it.
    pub fn save(&self) -> Result<Vec<u8>, Error> {
        let saved = self.analyses.iter().map(|past| Saved {
            estimate: past.estimate.clone(),
            variances: past.variances.clone(),
            covariance: (&past.covariance).into(),
            propagator: past.propagator.as_ref().map(Matrix::from),
            jacobian: (&past.whitened.jacobian).into(),
            cross: (&past.whitened.cross).into(),
        });
        to_bytes(&saved.collect::<Vec<_>>())
    }

    /// Takes back what [`FixedLag::save`] gave, for m values of the state, p parameters that are estimated, and so many in
    /// all.
    ///
    /// # Errors
    /// [`Error::Saved`].
    pub fn restore(&mut self, bytes: &[u8], m: usize, p: usize, parameters: usize) -> Result<(), Error> {
        let saved: Vec<Saved> = from_bytes(bytes)?;
        let (name, size) = ("an earlier analysis", m + p);
        if saved.len() > self.lag + 1 {
            return Err(unfit("the number of earlier analyses"));
        }
        let past = saved.into_iter().map(|it| {
            let (rows, other) = (it.jacobian.rows(), it.cross.rows());
            if it.estimate.len() != m + parameters || it.variances.len() != size || rows != other {
                return Err(unfit(name));
            }
            let propagator = it.propagator.map(|it| it.restored(m, Some(m), name)).transpose()?;
            Ok(PastAnalysis {
                estimate: it.estimate,
                variances: it.variances,
                covariance: it.covariance.restored(size, Some(size), name)?,
                propagator,
                whitened: Whitened {
                    jacobian: it.jacobian.restored(rows, Some(size), name)?,
                    cross: it.cross.restored(rows, Some(size), name)?,
                    departures: Mat::zeros(0, 1),
                },
            })
        });
        self.analyses = past.collect::<Result<_, Error>>()?;
        Ok(())
    }
}
