//! Observations of a window, each seen from a forecast at its time.

use crate::error::Error;
use crate::problem::steps;
use isobar_model::{Duration, Model, State, forecast};
use isobar_obs::TimedObservations;
use isobar_obs::window_states::place;

/// Where the times of a window's observations are among the time steps of a forecast. Between steps, what is observed is
/// interpolated linearly.
pub(crate) struct Times {
    /// Of each observation, the step at or before its time, and the part of a step since then.
    places: Vec<(usize, f64)>,
    /// The steps that are looked at, in ascending order, the last one always.
    stops: Vec<usize>,
}

impl Times {
    /// The times of observations that precede the end of a window by `lags`.
    ///
    /// # Errors
    /// [`Error::Setting`] if the window is not a whole number of time steps.
    pub fn new(model: &(impl Model + ?Sized), window: Duration, lags: &[Duration]) -> Result<Self, Error> {
        let steps = steps(model, window)?;
        let places: Vec<(usize, f64)> = lags.iter().map(|&lag| place(lag, window, steps)).collect();
        let around = |&(first, part): &(usize, f64)| [Some(first), (part > 0.0).then_some(first + 1)];
        let mut stops: Vec<usize> = places.iter().flat_map(around).flatten().chain([steps]).collect();
        stops.sort_unstable();
        stops.dedup();
        Ok(Self { places, stops })
    }

    /// The times of observations at the end of a window of this number of steps.
    pub fn at_end(observations: usize, steps: usize) -> Self {
        Self { places: vec![(steps, 0.0); observations], stops: vec![steps] }
    }

    /// The steps that are looked at, in ascending order, the last one always.
    pub fn stops(&self) -> &[usize] {
        &self.stops
    }

    /// The weights of a step in the observations: (number of the observation, weight).
    pub fn weights(&self, step: usize) -> impl Iterator<Item = (usize, f64)> {
        self.places.iter().enumerate().filter_map(move |(number, &(first, part))| match step.checked_sub(first) {
            Some(0) => Some((number, 1.0 - part)),
            Some(1) if part > 0.0 => Some((number, part)),
            _ => None,
        })
    }

    /// What is seen at the observations' times of the forecast from `x`, which goes on to the end of the window, and there.
    /// `see` gives what all observations see of a state.
    ///
    /// # Errors
    /// If the forecast leaves the finite numbers.
    pub fn follow(&self, model: &dyn Model, x: &mut State, see: impl Fn(&State) -> Vec<f64>) -> Result<Seen, Error> {
        let (mut done, mut at_time, mut at_end) = (0, vec![0.0; self.places.len()], Vec::new());
        for &stop in &self.stops {
            forecast::forecast(model, x, stop - done)?;
            done = stop;
            at_end = see(x);
            self.take(stop, &at_end, &mut at_time);
        }
        Ok(Seen { at_time, at_end })
    }

    /// What is seen at the observations' times of a trajectory, whose states are those before the first step and after each.
    pub fn along(&self, states: &[State], see: impl Fn(&State) -> Vec<f64>) -> Vec<f64> {
        let mut at_time = vec![0.0; self.places.len()];
        self.stops.iter().for_each(|&stop| self.take(stop, &see(&states[stop]), &mut at_time));
        at_time
    }

    /// Takes what all observations see after a step for those whose times are around it.
    fn take(&self, stop: usize, now: &[f64], at_time: &mut [f64]) {
        for ((own, now), &(first, part)) in at_time.iter_mut().zip(now).zip(&self.places) {
            match stop.checked_sub(first) {
                Some(0) => *own = *now,
                Some(1) => *own += part * (now - *own),
                _ => {}
            }
        }
    }
}

/// What the observations of a window see of a forecast.
pub(crate) struct Seen {
    /// Each at its time.
    pub at_time: Vec<f64>,
    /// All at the end of the window.
    pub at_end: Vec<f64>,
}

/// δ of [`WithinWindow`](isobar_obs::WithinWindow) for a background that is the forecast from `start`, in an experiment with
/// this number of calibration parameters.
///
/// # Errors
/// As a forecast.
pub fn shift(
    model: &dyn Model,
    start: &State,
    window: Duration,
    within: TimedObservations<'_>,
    parameters: usize,
) -> Result<Vec<f64>, Error> {
    let none = vec![0.0; parameters];
    let times = Times::new(model, window, within.lags)?;
    let Seen { at_time, at_end } = times.follow(model, &mut start.clone(), |x| within.whole.simulate(x, &none))?;
    // What is valid at the end is seen as it is.
    let own = |((seen, end), lag): ((f64, f64), &Duration)| if lag.seconds() == 0 { 0.0 } else { seen - end };
    Ok(at_time.into_iter().zip(at_end).zip(within.lags).map(own).collect())
}
