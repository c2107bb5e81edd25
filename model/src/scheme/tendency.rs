//! What a model integrates: a right-hand side dx/dt = f(x), its derivative and the transpose of that.

use super::rows::{AdjointRowStream, RowStream, TangentRowStream};
use super::strips::Lanes;
use crate::error::ModelError;
use crate::state::Layout;
use crate::stored::Stored;
use std::ops::Range;
use std::sync::Arc;

/// An autonomous right-hand side dx/dt = f(x), with the derivative f'(x) and its transpose.
///
/// All states and increments are slices `[variable, y, x]` of the layout's length. `scratch` has
/// [`Tendency::scratch_len`] values, all zero when it is first used, and serves one tendency only.
pub trait Tendency: Send + Sync + 'static {
    /// What f'(x) needs to know of x: coefficient fields, computed once and shared by all increments.
    type Linearisation: Send + Sync;

    /// Grid and variables.
    fn layout(&self) -> &Arc<Layout>;

    /// f on some rows of the grid, as a domain of its own with walls at both ends, where `rows` may go beyond a periodic edge: it is
    /// the same as on the whole, to the bit, but within [`Tendency::reach`] rows of an end that is no wall of the whole; such an end
    /// is open ([`Tendency::open_ends`]). `None` if there is no such form of it.
    fn in_rows(&self, _rows: &Range<isize>) -> Option<Self>
    where
        Self: Sized,
    {
        None
    }

    /// Whether the southern and the northern end of the grid only look like walls: the domain goes on there, and a step need not
    /// advance what depends on the rows beyond.
    fn open_ends(&self) -> [bool; 2] {
        [false; 2]
    }

    /// How many rows of x on either side f depends on.
    fn reach(&self) -> usize {
        1
    }

    /// Number of values of scratch space the other functions need.
    fn scratch_len(&self) -> usize {
        0
    }

    /// Sets to zero the values that must be zero (the flow through a wall): a projection on coordinates, applied
    /// to a state or an increment at the beginning of each step.
    fn constrain<N: Stored>(&self, _x: &mut [N]) {}

    /// Fails if x is outside of the domain of f: a thickness that is not positive. All its values are finite.
    ///
    /// # Errors
    /// [`ModelError`] with the place and the value.
    fn check(&self, _x: &[f64]) -> Result<(), ModelError> {
        Ok(())
    }

    /// `out` = f(x), in the variables' units per second.
    fn tendency(&self, x: &[f64], out: &mut [f64], scratch: &mut [f64]);

    /// f row by row, for rows of `nx` places of `lanes` states that lie interleaved: the same function as
    /// [`Tendency::tendency`], with which a step is one pass over memory. A state has the same bits alone and beside others.
    /// `None` if there is no such form of it, or if there are more than [`MOST_VARIABLES`](super::rows::MOST_VARIABLES).
    fn row_stream(&self, _nx: usize, _lanes: usize) -> Option<Box<dyn RowStream + '_>> {
        None
    }

    /// f and f' row by row for one column or a group at once, in the precision of the columns, for rows of at most `nx` places,
    /// which are at most [`MOST_PLACES`](super::MOST_PLACES): with it a batch of columns is advanced in lockstep, and what f'
    /// needs to know of the state is neither stored nor read for each column. A column has the same bits alone and in a group.
    /// `None` as in [`Tendency::row_stream`].
    fn tangent_row_stream<N: Stored>(&self, _nx: usize, _lanes: Lanes) -> Option<Box<dyn TangentRowStream<N> + '_>> {
        None
    }

    /// f and the transpose of f' row by row, as [`Tendency::tangent_row_stream`], where rows of adjoint increments come at most
    /// `delay` rows after those of the state. `None` if and only if that has none.
    fn adjoint_row_stream(&self, _nx: usize, _lanes: Lanes, _delay: usize) -> Option<Box<dyn AdjointRowStream + '_>> {
        None
    }

    /// The state at which f' is taken where the model's is `at`: another one only if f is itself linearised, about a state
    /// that stays as it is, so that its tendency in [`Tendency::tangent_row_stream`] and
    /// [`Tendency::adjoint_row_stream`] is zero.
    fn linearised_at<'a>(&'a self, at: &'a [f64]) -> &'a [f64] {
        at
    }

    /// The coefficients of f' at a state.
    fn linearise(&self, at: &[f64]) -> Self::Linearisation;

    /// `out` = f'(at) dx.
    fn tendency_tl(&self, at: &Self::Linearisation, dx: &[f64], out: &mut [f64], scratch: &mut [f64]);

    /// `out_add` += f'(at)ᵀ dy.
    fn tendency_ad(&self, at: &Self::Linearisation, dy: &[f64], out_add: &mut [f64], scratch: &mut [f64]);

    /// Bounds of the eigenvalues of f'(x).
    fn spectral_bounds(&self, x: &[f64]) -> SpectralBounds;
}

/// Where the eigenvalues λ of a linearised tendency lie: |Im λ| ≤ oscillation, −damping ≤ Re λ ≤ 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpectralBounds {
    /// The highest frequency \[s⁻¹\].
    pub oscillation_per_s: f64,
    /// The highest damping rate \[s⁻¹\].
    pub damping_per_s: f64,
}
