//! Networks: an instrument, when it reports, and which of its reports are missing or wrong.

use crate::error::{ObservationError, require};
use crate::error_correlation::ErrorCorrelation;
use crate::faults::Faults;
use crate::instrument::InstrumentSettings;
use crate::observation::Observation;
use isobar_model::Duration;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A network of stations, a satellite or recorded observations: one instrument of an observing system under its name.
#[derive(Clone, Debug)]
pub struct Network {
    /// Its name, unique in the observing system, without `/`.
    pub name: String,
    /// In which cycles it reports.
    pub schedule: Schedule,
    /// Probability that all observations of a platform (a station, a footprint) are missing in a cycle, from 0 to 1.
    pub missing_rate: f64,
    /// Reports that must not be believed.
    pub faults: Faults,
    /// How the random errors of its observations are correlated; `None` if they are independent.
    pub error_correlation: Option<ErrorCorrelation>,
    /// Whether methods assimilate its observations. Those of a passive network are compared with every method's estimates, and
    /// take part in nothing else.
    pub assimilate: bool,
    /// The share of its stations that is withheld: their observations are passive; from 0 to below 1.
    pub withhold: f64,
    /// At how many times of the window it observes, at equal intervals, the last at the end; each observation is made once.
    /// Of a scanner the scan lines follow each other through the window, of other instruments the platforms take turns.
    /// Recorded observations have times of their own: 1.
    pub times_per_window: usize,
    /// What reports.
    pub instrument: Arc<dyn InstrumentSettings>,
}

impl Network {
    /// An instrument that reports in every cycle, without missing reports and faults.
    pub fn new(name: &str, instrument: impl InstrumentSettings + 'static) -> Self {
        Self {
            name: name.to_owned(),
            schedule: Schedule::EVERY_CYCLE,
            missing_rate: 0.0,
            faults: Faults::NONE,
            error_correlation: None,
            assimilate: true,
            withhold: 0.0,
            times_per_window: 1,
            instrument: Arc::new(instrument),
        }
    }

    /// Whether some of its observations are passive.
    pub fn has_passive(&self) -> bool {
        !self.assimilate || self.withhold > 0.0
    }

    /// Whether some of its observations are valid before the end of their window, and are compared with the states then.
    pub fn is_within_window(&self) -> bool {
        self.times_per_window > 1 || self.instrument.is_within_window()
    }

    /// Whether its name and all that instruments have in common are what they must be.
    pub(crate) fn validate(&self) -> Result<(), ObservationError> {
        let name = &self.name;
        if name.trim().is_empty() || name.contains('/') {
            let problem = format!("name is `{name}`, but must not be empty and must not contain `/`");
            return Err(ObservationError::in_setting(name, "name", problem));
        }
        self.schedule.validate(name)?;
        let rate = self.missing_rate;
        require((0.0..=1.0).contains(&rate), name, "missing_rate", rate, "a probability from 0 to 1")?;
        require((0.0..1.0).contains(&self.withhold), name, "withhold", self.withhold, "a share from 0 to below 1")?;
        if self.withhold > 0.0 && !self.assimilate {
            let problem =
                "withhold has no effect, since assimilate is false: none of the network's stations is assimilated";
            return Err(ObservationError::in_setting(name, "withhold", problem));
        }
        if self.withhold > 0.0 && self.error_correlation.is_some() {
            let problem = "withhold would compare methods with stations whose errors are correlated with those that they are \
                           given; leave out withhold or error_correlation";
            return Err(ObservationError::in_setting(name, "withhold", problem));
        }
        if let Some(correlation) = &self.error_correlation {
            correlation.validate(name, self.instrument.has_scan_lines())?;
        }
        self.faults.validate(name)
    }

    /// Whether the times at which it observes are whole seconds of a window.
    pub(crate) fn validate_times(&self, window: Duration) -> Result<(), ObservationError> {
        let (name, times) = (&self.name, self.times_per_window);
        let expected = format!("a divisor of the window's {} s", window.seconds());
        let fits = times >= 1 && i64::try_from(times).is_ok_and(|times| window.seconds() % times == 0);
        require(fits, name, "times_per_window", times as f64, expected)?;
        let refuse = |problem: &str| Err(ObservationError::in_setting(name, "times_per_window", problem));
        if times > 1 && self.instrument.is_recorded() {
            return refuse("times_per_window has no effect, since recorded observations have times of their own");
        }
        if times > 1 && self.instrument.has_air_mass_bias() {
            return refuse(
                "times_per_window is above 1, but a bias depends on the state: methods know its predictor at the end of the \
                 window only; leave out times_per_window or that bias",
            );
        }
        Ok(())
    }
}

/// Spreads the observations of a window over `times` equally spaced times, the last at its end: scan lines follow each other,
/// other platforms take turns.
pub(crate) fn spread(observations: &mut [Observation], times: usize, window: Duration) {
    if times == 1 {
        return;
    }
    let (mut lines, mut platforms): (BTreeSet<usize>, Vec<Arc<str>>) = (BTreeSet::new(), Vec::new());
    lines.extend(observations.iter().filter_map(|it| Some(it.scan_line?.number)));
    let lines: Vec<usize> = lines.into_iter().collect();
    for observation in observations {
        let number = match observation.scan_line {
            Some(line) => lines.partition_point(|&other| other < line.number) * times / lines.len(),
            None => {
                let platform = &observation.report.platform;
                if platforms.last() != Some(platform) {
                    platforms.push(Arc::clone(platform));
                }
                (platforms.len() - 1) % times
            }
        };
        let after = (times - 1 - number) as i64;
        observation.lag = Duration::from_seconds(window.seconds() / times as i64 * after);
    }
}

/// In which cycles, from 1, a network reports: `first_cycle`, and after it every `every_cycles` cycles. With windows of six hours
/// from 00 UTC, `every_cycles = 2` and `first_cycle = 2` mean 12, 00, 12 … UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// The interval between its reports in cycles, at least 1.
    pub every_cycles: usize,
    /// The first cycle in which it reports, at least 1.
    pub first_cycle: usize,
}

impl Schedule {
    /// Every cycle.
    pub const EVERY_CYCLE: Schedule = Schedule { every_cycles: 1, first_cycle: 1 };

    /// Number of reports before that of `cycle` (from 1); `None` if the network does not report in this cycle.
    pub fn pass(&self, cycle: usize) -> Option<usize> {
        let after = cycle.checked_sub(self.first_cycle)?;
        after.is_multiple_of(self.every_cycles).then(|| after / self.every_cycles)
    }

    pub(crate) fn validate(&self, network: &str) -> Result<(), ObservationError> {
        let Schedule { every_cycles: every, first_cycle: first } = *self;
        require(every >= 1, network, "schedule.every_cycles", every as f64, "at least 1")?;
        require(first >= 1, network, "schedule.first_cycle", first as f64, "at least 1")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_report_every_nth_cycle_from_the_first() {
        let passes = |every_cycles, first_cycle| -> Vec<Option<usize>> {
            (1..=6).map(|cycle| Schedule { every_cycles, first_cycle }.pass(cycle)).collect()
        };
        assert_eq!(passes(1, 1), [Some(0), Some(1), Some(2), Some(3), Some(4), Some(5)]);
        assert_eq!(passes(2, 2), [None, Some(0), None, Some(1), None, Some(2)]);
        assert_eq!(passes(3, 1), [Some(0), None, None, Some(1), None, None]);
        assert_eq!(passes(1, 4), [None, None, None, Some(0), Some(1), Some(2)]);
        assert_eq!(passes(2, 3), [None, None, Some(0), None, Some(1), None]);
        assert_eq!(passes(3, 9), [None; 6]);
    }

    #[test]
    fn impossible_schedules_are_errors() {
        let message =
            |every_cycles, first_cycle| Schedule { every_cycles, first_cycle }.validate("net").unwrap_err().to_string();
        assert_eq!(message(0, 1), "net: schedule.every_cycles is 0, but must be at least 1");
        assert_eq!(message(2, 0), "net: schedule.first_cycle is 0, but must be at least 1");
    }
}
