//! Unknowns in the border that have no prior: the time block of a moving time volume.
//!
//! The first columns of Φ may be sensitivities U = ∂(b, c)/∂C to unknowns C without a prior. They go through the
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

use super::BlockErrors;
use super::solution::{Found, Increments, Solved};
use crate::linalg::{column, inverse_from_cholesky, product, solve_lower_transposed};
use faer::{Mat, MatRef};
use isobar_model::vector::dot;

impl BlockErrors {
    /// As [`BlockErrors::finish`], with `free` unknowns C and L, `root`; the increments are those for C = 0.
    pub(super) fn finish_with_free(
        &mut self,
        amplitudes: &[f64],
        root: MatRef<'_, f64>,
        mut of_blocks: Vec<f64>,
        chi2: f64,
        free: usize,
    ) -> Solved {
        let (q, all) = (free, amplitudes.len());
        let of_free = root.get(..q, ..q);
        // T' = L_CC^-T L_ξC'.
        let mut turn = root.get(q.., ..q).transpose().to_owned();
        solve_lower_transposed(of_free, turn.as_mut());
        let turn = turn.transpose().to_owned();
        let mut matrix = inverse_from_cholesky(of_free);
        let estimate = column(&amplitudes[..q]);
        let vector = product(matrix.as_ref(), estimate.as_ref()).col_as_slice(0).to_vec();
        (0..q).for_each(|i| matrix[(i, i)] -= 1.0);
        let chi2_of_zero = dot(&vector, &amplitudes[..q]);
        // ξ̂ given C = 0.
        let moved = product(turn.as_ref(), estimate.as_ref());
        let given: Vec<f64> = (0..all).map(|i| if i < q { 0.0 } else { amplitudes[i] - moved[(i - q, 0)] }).collect();
        let rotation = Mat::from_fn(all, all, |i, j| match (i < q, j < q) {
            (true, true) => f64::from(u8::from(i == j)),
            (true, false) => 0.0,
            (false, true) => turn[(i - q, j)],
            (false, false) => root[(i, j)],
        });
        let of_shared = self.take_in_amplitudes(&given, rotation.as_ref(), free, &mut of_blocks);
        let found = Some(Found { matrix, vector, chi2_of_zero });
        Solved { increments: Increments { of_blocks, of_shared }, chi2, found }
    }
}
