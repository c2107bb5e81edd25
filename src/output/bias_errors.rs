//! Errors of estimated biases, as pictures show them: the bias itself in a run that knows no true one.

use super::history::{Cycle, History, MethodCycle};
use crate::event::StationInfo;

/// The error of a bias; in a run that knows true biases nothing where the truth of this one is not known.
pub fn error(history: &History, (cycle, own): (&Cycle, &MethodCycle), number: usize) -> Option<f64> {
    let truth = if history.knows_biases() { cycle.true_bias(number)? } else { 0.0 };
    Some(own.bias(number)? - truth)
}

/// The stations with a bias in a variable, the number of its parameter, and its error.
pub fn of_stations<'a>(
    history: &'a History,
    own: (&Cycle, &MethodCycle),
    variable: &str,
) -> Vec<(&'a StationInfo, usize, f32)> {
    let of = |station: &'a StationInfo| {
        let number = history.info.bias_of(station, variable)?;
        let error = error(history, own, number)? as f32;
        error.is_finite().then_some((station, number, error))
    };
    history.info.stations.iter().filter_map(of).collect()
}
