//! A truth that is a series of states from a file.

use crate::scenario::TruthSeries;
use isobar_model::{Duration, State, Time};

/// A true world whose states are in a file.
pub struct Series {
    series: TruthSeries,
    window: Duration,
    time: Time,
    state: State,
}

impl Series {
    /// The world at a time, with the length of a cycle.
    ///
    /// # Errors
    /// As [`TruthSeries::state`].
    pub fn new(series: TruthSeries, time: Time, window: Duration) -> Result<Self, String> {
        let state = series.state(time)?;
        Ok(Self { series, window, time, state })
    }

    /// Whether the file has the states of the next cycles.
    ///
    /// # Errors
    /// As [`TruthSeries::state`], of the first that cannot be used.
    pub fn check_cycles(&self, cycles: usize) -> Result<(), String> {
        (1..=cycles).try_for_each(|cycle| self.series.state(self.time + self.window * cycle).map(|_| ()))
    }

    /// The true state now.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The time of this state, and the state.
    pub fn save(&self) -> (Time, State) {
        (self.time, self.state.clone())
    }

    /// Goes to a time at which the state was this one.
    ///
    /// # Errors
    /// As [`TruthSeries::state`]; another state in the file.
    pub fn restore(&mut self, time: Time, state: State) -> Result<(), String> {
        if self.series.state(time)? != state {
            let (name, time) = (self.series.name(), crate::calendar::utc(time));
            return Err(format!("truth.file: at {time} {name} has another truth than there was before"));
        }
        (self.time, self.state) = (time, state);
        Ok(())
    }

    /// Goes on by one cycle.
    ///
    /// # Errors
    /// As [`TruthSeries::state`].
    pub fn advance(&mut self) -> Result<(), String> {
        let time = self.time + self.window;
        self.state = self.series.state(time)?;
        self.time = time;
        Ok(())
    }
}
