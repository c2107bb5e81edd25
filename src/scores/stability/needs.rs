//! What would give a bias a stable update: Lange, WO 93/22625, claim 1 f, "indicating when there is need for some of the
//! following: more sensor output signal values, test point data, sensor comparison or system reconfiguration".

use super::doubt::Doubt;
use isobar_assim::{CalibrationAccuracy, Needs};
use isobar_obs::Calibration;
use serde::{Deserialize, Serialize};

/// More observations are no remedy if it would take more than this many times as long as they have been made so far.
const MOST_TIMES: f64 = 20.0;

/// What would give a bias a stable update: each of the data by itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterNeeds {
    /// Further cycles with observations, if these go on to say as much as they did in the second half of the run; `None` if
    /// they would not be enough in twenty times as many cycles.
    pub further_cycles: Option<usize>,
    /// The largest standard deviation of a test point against a reference, in the bias's unit.
    pub test_point_sigma: Option<f64>,
    /// The comparison with another sensor that may have the largest error; `None` if no single one is enough.
    pub comparison: Option<ComparisonNeed>,
    /// What would have to be different in networks or assumptions.
    pub reconfiguration: Option<String>,
}

/// A comparison of two sensors that would be enough.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComparisonNeed {
    /// The bias of the other sensor.
    pub with: String,
    /// The largest standard deviation of its error, in the biases' unit.
    pub sigma: f64,
}

/// Information below which nothing has been said of a bias, in units of that of its prior.
const NOTHING: f64 = 1e-6;

/// How much observations have said of a bias, as P/S − 1, the information in units of that of its prior: proportional to the
/// number of observations of a constant that nothing else explains, and bounded where something else does. Cycles count from
/// the first that says anything: a network may begin to report later than the run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Information {
    /// Cycles, and the information after them: at a time between a quarter and half of all, at a later one, and now.
    earlier: (usize, f64),
    later: (usize, f64),
    now: (usize, f64),
}

impl Information {
    /// Takes in a cycle after which this share of the prior variance is left.
    pub fn add(&mut self, variance_ratio: f64) {
        let information = 1.0 / variance_ratio - 1.0;
        if self.now.0 == 0 && information < NOTHING {
            return;
        }
        self.now = (self.now.0 + 1, information);
        if self.now.0 >= 2 * self.later.0 {
            (self.earlier, self.later) = (self.later, self.now);
        }
    }

    /// In how many further cycles the share is at most `most`, if information goes on to grow as it did lately.
    fn further_cycles(&self, most: f64) -> Option<usize> {
        let (from, to) = (self.earlier, self.now);
        let in_a_cycle = (to.1 - from.1) / to.0.checked_sub(from.0).filter(|&cycles| cycles > 0)? as f64;
        let cycles = (1.0 / most - 1.0 - to.1) / in_a_cycle;
        (cycles > 0.0 && cycles <= MOST_TIMES * to.0 as f64).then(|| cycles.ceil() as usize)
    }
}

/// The needs of parameter `number`, which may keep the share `most` of its prior variance `prior`.
pub(super) fn of_parameter(
    (number, prior): (usize, f64),
    most: f64,
    information: &Information,
    doubts: &[Doubt],
    accuracy: &CalibrationAccuracy,
    calibration: &Calibration,
) -> ParameterNeeds {
    let parameters = &calibration.parameters;
    let comparable = (0..parameters.len()).filter(|&other| parameters[other].unit == parameters[number].unit);
    let data = Needs::new(accuracy, number, most * prior, comparable);
    let comparison = data.as_ref().and_then(|data| data.comparison);
    let comparison = comparison.map(|it| ComparisonNeed { with: parameters[it.with].name.clone(), sigma: it.sigma });
    let further_cycles = data.as_ref().and_then(|_| information.further_cycles(most));
    let is_red = doubts.iter().any(|doubt| matches!(doubt, Doubt::Red(_)));
    let reconfiguration = if doubts.contains(&Doubt::Unobserved) {
        Some("a network that observes it")
    } else if is_red {
        Some("a faster change in what methods assume (`assumed_drift_per_sqrt_day`, `assumed_correlation_hours`)")
    } else if further_cycles.is_none() && comparison.is_none() {
        Some("a network without bias that observes the same")
    } else {
        None
    };
    ParameterNeeds {
        further_cycles,
        test_point_sigma: data.map(|data| data.test_point_sigma),
        comparison,
        reconfiguration: reconfiguration.map(String::from),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The share that n observations with this signal-to-noise ratio leave of the prior variance of a constant.
    fn share(observations: usize, signal: f64) -> f64 {
        1.0 / (1.0 + observations as f64 * signal)
    }

    #[test]
    fn a_constant_is_determined_after_as_many_cycles_as_its_observations_take() {
        for cycles in [1, 2, 7, 18] {
            let mut information = Information::default();
            (1..=cycles).for_each(|cycle| information.add(share(cycle, 0.16)));
            let further = information.further_cycles(0.25).unwrap();
            assert!(share(cycles + further, 0.16) <= 0.25, "{cycles} + {further}");
            assert!(share(cycles + further - 1, 0.16) > 0.25, "{cycles} + {further}");
        }
    }

    #[test]
    fn cycles_before_the_first_report_do_not_count() {
        let further = |before: usize| {
            let mut information = Information::default();
            (0..before).for_each(|_| information.add(1.0));
            (1..=3).for_each(|cycle| information.add(share(cycle, 0.16)));
            information.further_cycles(0.25)
        };
        assert!(further(0).is_some_and(|cycles| cycles > 10) && further(40) == further(0), "{:?}", further(40));
    }

    #[test]
    fn observations_that_say_nothing_more_are_no_remedy() {
        // What cannot be separated from a mean of the state keeps a share whatever the number of observations.
        let mut information = Information::default();
        (1..=40).for_each(|cycle| information.add(0.5 + 0.5 * share(cycle * cycle * 100, 1.0)));
        assert_eq!(information.further_cycles(0.25), None);
        assert_eq!(Information::default().further_cycles(0.25), None);
        let mut unobserved = Information::default();
        (0..5).for_each(|_| unobserved.add(1.0));
        assert_eq!(unobserved.further_cycles(0.25), None);
    }
}
