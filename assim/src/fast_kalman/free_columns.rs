//! Unknowns in the border that have no prior: the time block of a moving time volume.
//!
//! The first columns of Φ may be sensitivities U = ∂(b, c)/∂C to unknowns C of which nothing is known. They go through the
//! analysis as the common factors do, with a nominal prior N(0, I), and here it is taken out again: given C, the
//! amplitudes ξ of the factors do not depend on it, and what the observations say of C is the posterior's information
//! without the prior's,
//!
//! ```text
//! S = [S_CC S_Cξ; S_ξC S_ξξ] = L Lᵀ,     L = [L_CC 0; L_ξC L_ξξ]
//! ξ | C ~ N(ξ̂ + T (C − Ĉ), L_ξξ L_ξξᵀ),  T = L_ξC L_CC^-1
//! J = S_CC^-1 − I,     j = S_CC^-1 Ĉ
//! U ← (Φ − D)_C + (Φ − D)_ξ T,     Φ ← (Φ − D)_ξ L_ξξ
//! ```
//!
//! This is the elimination of a time block from WO 97/18442, eqs. (24), (25): the blocks in space first, then the factors,
//! which are of this time alone; J and j are `G' R G` and `G' R y` of what is left for the shared C.

use super::FastKalmanFilter;
use crate::error::Error;
use crate::linalg::{cholesky, column, inverse_from_cholesky, product, solve_lower_transposed};
use faer::Mat;

/// The first columns of Φ, and what an analysis has found out about their amplitudes C.
#[derive(Clone, Debug)]
pub(super) struct FreeColumns {
    /// How many there are.
    pub count: usize,
    /// What the last analysis has found.
    pub found: Option<Found>,
}

/// What an analysis says of C.
#[derive(Clone, Debug)]
pub(super) struct Found {
    /// J.
    pub matrix: Mat<f64>,
    /// j.
    pub vector: Vec<f64>,
    /// By how much dᵀ Cov(d)⁻¹ d is larger for C = 0 than with the nominal prior.
    pub chi2_of_zero: f64,
}

impl FastKalmanFilter {
    /// As [`FastKalmanFilter::finish`]; state and parameters become those for C = 0.
    pub(super) fn finish_with_free(
        &mut self,
        amplitudes: &[f64],
        covariance: Mat<f64>,
        mut increment: Vec<f64>,
    ) -> Result<(), Error> {
        let free = self.free.as_mut().expect("there are free columns");
        let (q, all) = (free.count, amplitudes.len());
        let root = cholesky(covariance, || "the covariance S of the border".into())?;
        let of_free = root.as_ref().get(..q, ..q);
        // T' = L_CC^-T L_ξC'.
        let mut turn = root.as_ref().get(q.., ..q).transpose().to_owned();
        solve_lower_transposed(of_free, turn.as_mut());
        let turn = turn.transpose().to_owned();
        let mut information = inverse_from_cholesky(of_free);
        let estimate = column(&amplitudes[..q]);
        let vector = product(information.as_ref(), estimate.as_ref());
        for i in 0..q {
            information[(i, i)] -= 1.0;
        }
        let vector = vector.col_as_slice(0).to_vec();
        let chi2_of_zero = vector.iter().zip(amplitudes).map(|(j, c)| j * c).sum();
        free.found = Some(Found { matrix: information, vector, chi2_of_zero });
        // ξ̂ given C = 0.
        let moved = product(turn.as_ref(), estimate.as_ref());
        let given: Vec<f64> = (0..all).map(|i| if i < q { 0.0 } else { amplitudes[i] - moved[(i - q, 0)] }).collect();
        let factors = &mut self.covariance.factors;
        factors.multiply_add(&given, &mut increment);
        let shared_increment = product(factors.shared.as_ref(), column(&given).as_ref());
        let rotation = Mat::from_fn(all, all, |i, j| match (i < q, j < q) {
            (true, true) => f64::from(u8::from(i == j)),
            (true, false) => 0.0,
            (false, true) => turn[(i - q, j)],
            (false, false) => root[(i, j)],
        });
        factors.rotate(rotation.as_ref());
        self.add_increments(&increment, shared_increment.col_as_slice(0));
        Ok(())
    }
}
