//! The truth that no method ever sees: a model run of its own, or the states of a file.

mod series;
mod twin;

pub use series::Series;
pub use twin::{Growth, Twin};

use isobar_model::{ForecastError, State, Time};
use isobar_obs::WindowStates;
use serde::{Deserialize, Serialize};

/// The true world.
pub enum Truth {
    /// A model run.
    Twin(Box<Twin>),
    /// The states of a file.
    Series(Series),
}

/// Why the truth cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// It has left the finite numbers.
    #[error(transparent)]
    Forecast(#[from] ForecastError),
    /// It grew by orders of magnitude.
    #[error("{0}")]
    Growth(Growth),
    /// Its file has no such state.
    #[error("{0}")]
    Series(String),
}

/// The truth's memory, for a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum SavedTruth {
    /// Of a model run: its state, and the numbers drawn so far, in words of 32 bits.
    Twin(State, u128),
    /// Of a series: the time and the state then.
    Series(Time, State),
}

impl Truth {
    /// The true state now.
    pub fn state(&self) -> &State {
        match self {
            Self::Twin(twin) => twin.state(),
            Self::Series(series) => series.state(),
        }
    }

    /// The true states through the last window; of a file's only the one at its end.
    pub fn window(&self) -> WindowStates<'_> {
        match self {
            Self::Twin(twin) => twin.window(),
            Self::Series(series) => series.state().into(),
        }
    }

    /// Whether there will be a truth in the next cycles, as far as that can be known before.
    ///
    /// # Errors
    /// In words: what its file has not.
    pub fn check_cycles(&self, cycles: usize) -> Result<(), String> {
        match self {
            Self::Twin(_) => Ok(()),
            Self::Series(series) => series.check_cycles(cycles),
        }
    }

    /// Everything that the next cycles depend on and the scenario does not determine.
    pub fn save(&self) -> SavedTruth {
        match self {
            Self::Twin(twin) => {
                let (state, random) = twin.save();
                SavedTruth::Twin(state, random)
            }
            Self::Series(series) => {
                let (time, state) = series.save();
                SavedTruth::Series(time, state)
            }
        }
    }

    /// Takes back what [`Truth::save`] gave.
    ///
    /// # Errors
    /// In words, if it is that of another truth.
    pub fn restore(&mut self, saved: SavedTruth) -> Result<(), String> {
        let fits = match (self, saved) {
            (Self::Twin(twin), SavedTruth::Twin(state, random)) => twin.restore(state, random),
            (Self::Series(series), SavedTruth::Series(time, state)) => return series.restore(time, state),
            _ => false,
        };
        if fits { Ok(()) } else { Err("its truth is one of another experiment".into()) }
    }

    /// Goes on by one cycle.
    ///
    /// # Errors
    /// [`TruthError`].
    pub fn advance(&mut self) -> Result<(), TruthError> {
        match self {
            Self::Twin(twin) => {
                twin.advance()?;
                twin.check_growth().map_err(TruthError::Growth)
            }
            Self::Series(series) => series.advance().map_err(TruthError::Series),
        }
    }
}
