//! States advanced together in one sweep over the rows, all steps of a forecast at once: they lie interleaved, so that a row of
//! a small grid is as long as that of a large one. What a row costs beside its arithmetic (calls, the ends of loops, places that
//! fill no vector) they share. Each value is the same function of the same values as for a state alone, and has the same bits.

use super::sweep::sweep;
use super::tendency::Tendency;
use super::update::Scheme;
use crate::state::State;

/// Places of a row of all states together from which on further states gain nothing.
const PLACES: usize = 256;

/// More states than this gain nothing, however short their rows.
const MOST_STATES: usize = 16;

/// How many states are best advanced together; one, if the tendency has no form by rows.
pub(super) fn best_together<T: Tendency>(tendency: &T) -> usize {
    let nx = tendency.layout().grid.nx;
    if tendency.row_stream(nx, 1).is_none() {
        return 1;
    }
    (PLACES / nx).clamp(1, MOST_STATES)
}

/// Advances the values of states, of all levels of the scheme, by `steps` steps; returns false, with nothing done, if the
/// tendency has no row form.
pub(super) fn sweep_states<T: Tendency>(tendency: &T, scheme: Scheme<'_>, states: &mut [State], steps: usize) -> bool {
    if steps == 0 {
        return true;
    }
    let level = tendency.layout().len();
    for x in &mut *states {
        x.values_mut().chunks_exact_mut(level).for_each(|level| tendency.constrain(level));
    }
    // What is constrained stays so, as its tendency is zero.
    if let [x] = states {
        return sweep(tendency, scheme, x.values_mut(), 1, steps);
    }
    let lanes = states.len();
    let mut values = vec![0.0; scheme.levels() * level * lanes];
    for (lane, x) in states.iter().enumerate() {
        values[lane..].iter_mut().step_by(lanes).zip(x.values()).for_each(|(value, x)| *value = *x);
    }
    if !sweep(tendency, scheme, &mut values, lanes, steps) {
        return false;
    }
    for (lane, x) in states.iter_mut().enumerate() {
        x.values_mut().iter_mut().zip(values[lane..].iter().step_by(lanes)).for_each(|(x, value)| *x = *value);
    }
    true
}
