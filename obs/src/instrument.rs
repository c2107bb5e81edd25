//! Instruments: what is common to the configurations of all of them, and what each produces in a cycle.

pub mod radiosonde;
pub mod recorded;
pub mod satellite;

use crate::air_mass::Predictor;
use crate::error::{ObservationError, list, require};
use crate::faults::Faults;
use crate::report::Report;
use isobar_model::{Layout, State, Time};
use radiosonde::RadiosondeConfig;
use rand_chacha::ChaCha8Rng;
use recorded::{RecordedConfig, RecordedUse};
use satellite::SatelliteConfig;

/// The most stations, or footprints in one cycle, that one instrument may have.
pub const MOST_PLATFORMS: usize = 1_000_000;

/// One instrument of an observing system.
#[derive(Clone, Debug, PartialEq)]
pub enum InstrumentConfig {
    /// A network of radiosonde stations.
    Radiosonde(RadiosondeConfig),
    /// A satellite with a swath.
    Satellite(SatelliteConfig),
    /// Observations that somebody else made.
    Recorded(RecordedConfig),
}

impl InstrumentConfig {
    /// The instrument's name.
    pub fn name(&self) -> &str {
        match self {
            InstrumentConfig::Radiosonde(config) => &config.name,
            InstrumentConfig::Satellite(config) => &config.name,
            InstrumentConfig::Recorded(config) => &config.name,
        }
    }

    /// The instrument's faults.
    pub(crate) fn faults(&self) -> Faults {
        match self {
            InstrumentConfig::Radiosonde(config) => config.faults,
            InstrumentConfig::Satellite(config) => config.faults,
            InstrumentConfig::Recorded(_) => Faults::NONE,
        }
    }
}

/// In which cycles an instrument reports: those whose number, from 1, leaves the remainder `offset_cycles` when
/// divided by `every_cycles`. With windows of six hours from 00 UTC, `every_cycles = 2` means 12, 00, 12 … UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// Every how many cycles it reports; at least 1.
    pub every_cycles: usize,
    /// The remainder; below `every_cycles`.
    pub offset_cycles: usize,
}

impl Schedule {
    /// Every cycle.
    pub const EVERY_CYCLE: Schedule = Schedule { every_cycles: 1, offset_cycles: 0 };

    /// How many reports there were before that of `cycle` (from 1); `None` if there is none in this cycle.
    pub fn pass(&self, cycle: usize) -> Option<usize> {
        let first = if self.offset_cycles == 0 { self.every_cycles } else { self.offset_cycles };
        (cycle >= first && cycle % self.every_cycles == self.offset_cycles).then(|| (cycle - first) / self.every_cycles)
    }

    pub(crate) fn validate(&self, instrument: &str) -> Result<(), ObservationError> {
        let Schedule { every_cycles: every, offset_cycles: offset } = *self;
        require(every >= 1, instrument, "schedule.every_cycles", every as f64, "at least 1")?;
        let expected = format!("from 0 to {}, below every_cycles", every - 1);
        require(offset < every, instrument, "schedule.offset_cycles", offset as f64, expected)
    }
}

/// A variable of the state that an instrument reports.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservedVariable {
    /// The variable's name in the state's layout.
    pub name: String,
    /// Standard deviation of the random error, in the variable's unit; above 0.
    pub sigma: f64,
}

impl ObservedVariable {
    /// The variable of this name, with errors of this standard deviation.
    pub fn new(name: &str, sigma: f64) -> Self {
        Self { name: name.to_owned(), sigma }
    }

    /// Its number in the layout; `settings` are those of its name and its sigma.
    pub(crate) fn find(
        &self,
        layout: &Layout,
        instrument: &str,
        settings: [&'static str; 2],
    ) -> Result<usize, ObservationError> {
        require(self.sigma > 0.0, instrument, settings[1], self.sigma, "above 0")?;
        layout.variable(&self.name).ok_or_else(|| ObservationError::UnknownName {
            instrument: instrument.to_owned(),
            setting: settings[0],
            value: self.name.clone(),
            valid: list(layout.variables.iter().map(|variable| variable.name)),
        })
    }
}

/// One observation before it arrives: its rows of X and G, and what it reads.
#[derive(Clone, Debug)]
pub(crate) struct Observation {
    pub report: Report,
    pub sigma: f64,
    pub reading: Reading,
    pub state_row: Vec<(usize, f64)>,
    /// G: what of its biases does not depend on the state.
    pub calibration_row: Vec<(usize, f64)>,
    /// What does.
    pub predictors: Vec<Predictor>,
}

impl Observation {
    /// (G + P(x)) c.
    pub fn bias(&self, x: &State, calibration: &[f64]) -> f64 {
        let fixed: f64 = self.calibration_row.iter().map(|&(column, value)| value * calibration[column]).sum();
        fixed + self.predictors.iter().map(|own| own.bias(x, calibration)).sum::<f64>()
    }

    /// Its row of G + P(x).
    pub fn calibration_row_at(&self, x: &State) -> Vec<(usize, f64)> {
        self.calibration_row.iter().copied().chain(self.predictors.iter().map(|own| own.entry(x))).collect()
    }
}

/// What an observation reads.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Reading {
    /// The truth, its bias and this random error, drawn from N(0, sigma²).
    Error(f64),
    /// What somebody else has read.
    Recorded {
        /// The value.
        value: f64,
        /// Whether it is not valid near enough to the end of the window.
        is_late: bool,
    },
}

impl Reading {
    /// The recorded value, or the random error.
    pub fn value(&self) -> f64 {
        match *self {
            Reading::Error(value) | Reading::Recorded { value, .. } => value,
        }
    }

    /// Replaces that.
    pub fn set_value(&mut self, new: f64) {
        match self {
            Reading::Error(value) | Reading::Recorded { value, .. } => *value = new,
        }
    }
}

/// An instrument in operation.
pub(crate) trait Instrument: Send + Sync {
    /// Appends the observations of `cycle`, from 1, which is valid at `time`; to be called for one cycle after the other.
    fn observe(&mut self, cycle: usize, time: Time, observations: &mut Vec<Observation>);

    /// What becomes of its observations in so many cycles, if somebody else made them.
    fn recorded_use(&self, _cycles: usize) -> Option<RecordedUse> {
        None
    }

    /// Its random streams, always in the same order.
    fn streams(&mut self) -> Vec<&mut ChaCha8Rng>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_report_every_nth_cycle() {
        let passes = |every_cycles, offset_cycles| -> Vec<Option<usize>> {
            (1..=6).map(|cycle| Schedule { every_cycles, offset_cycles }.pass(cycle)).collect()
        };
        assert_eq!(passes(1, 0), [Some(0), Some(1), Some(2), Some(3), Some(4), Some(5)]);
        assert_eq!(passes(2, 0), [None, Some(0), None, Some(1), None, Some(2)]);
        assert_eq!(passes(3, 1), [Some(0), None, None, Some(1), None, None]);
    }

    #[test]
    fn impossible_schedules_are_errors() {
        let message = |every_cycles, offset_cycles| {
            Schedule { every_cycles, offset_cycles }.validate("net").unwrap_err().to_string()
        };
        assert_eq!(message(0, 0), "net: schedule.every_cycles is 0, but must be at least 1");
        assert_eq!(message(2, 2), "net: schedule.offset_cycles is 2, but must be from 0 to 1, below every_cycles");
    }
}
