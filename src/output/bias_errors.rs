//! Errors of estimated biases, as pictures show them: the bias itself in a run that knows no true one.

use super::history::{Cycle, History, MethodCycle};
use crate::event::StationInfo;

/// The error of a bias; in a run that knows true biases nothing where the truth of this one is not known.
pub fn error(history: &History, (cycle, own): (&Cycle, &MethodCycle), number: usize) -> Option<f64> {
    let truth = if history.knows_biases() { cycle.true_bias(number)? } else { 0.0 };
    Some(own.bias(number)? - truth)
}

/// The stations with a bias of a variable, the number of its parameter, and its error.
pub fn of_stations<'a>(
    history: &'a History,
    own: (&Cycle, &MethodCycle),
    variable: usize,
) -> Vec<(&'a StationInfo, usize, f32)> {
    let of = |&(station, number): &(usize, usize)| {
        let error = error(history, own, number)? as f32;
        error.is_finite().then_some((&history.info.stations[station], number, error))
    };
    history.station_biases[variable].iter().filter_map(of).collect()
}
