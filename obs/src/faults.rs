//! Faults of an instrument: reports that must not be believed, to try quality control on.

use crate::error::{ObservationError, require};
use crate::observation::Arrival;
use isobar_model::{Duration, Grid};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// How often an instrument's reports are wrong, and how; each observation has one fault at most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Faults {
    /// Probability of a gross error.
    pub gross_error_rate: f64,
    /// Standard deviation of gross errors, in standard deviations of the random error; above 0.
    pub gross_error_factor: f64,
    /// Probability that the value is no number.
    pub not_finite_rate: f64,
    /// Probability that the report comes twice.
    pub duplicate_rate: f64,
    /// Probability that the report gives a place outside of the domain.
    pub misplaced_rate: f64,
    /// Probability that the report is one window old.
    pub late_rate: f64,
}

impl Faults {
    /// No faults.
    pub const NONE: Faults = Faults {
        gross_error_rate: 0.0,
        gross_error_factor: 20.0,
        not_finite_rate: 0.0,
        duplicate_rate: 0.0,
        misplaced_rate: 0.0,
        late_rate: 0.0,
    };

    fn rates(&self) -> [(&'static str, f64); 5] {
        [
            ("faults.gross_error_rate", self.gross_error_rate),
            ("faults.not_finite_rate", self.not_finite_rate),
            ("faults.duplicate_rate", self.duplicate_rate),
            ("faults.misplaced_rate", self.misplaced_rate),
            ("faults.late_rate", self.late_rate),
        ]
    }

    pub(crate) fn validate(&self, network: &str) -> Result<(), ObservationError> {
        for (setting, rate) in self.rates() {
            require((0.0..=1.0).contains(&rate), network, setting, rate, "a probability from 0 to 1")?;
        }
        let sum: f64 = self.rates().iter().map(|rate| rate.1).sum();
        require(sum <= 1.0, network, "faults", sum, "at most 1 in sum: an observation has one fault at most")?;
        let factor = self.gross_error_factor;
        require(factor > 0.0, network, "faults.gross_error_factor", factor, "above 0")
    }

    /// Spoils the arrivals of an instrument in one window.
    pub(crate) fn spoil(
        &self,
        arrivals: Vec<Arrival>,
        window: Duration,
        grid: &Grid,
        random: &mut ChaCha8Rng,
    ) -> Vec<Arrival> {
        if self.rates().iter().all(|rate| rate.1 == 0.0) {
            return arrivals;
        }
        let mut spoilt = Vec::with_capacity(arrivals.len());
        for mut arrival in arrivals {
            // Both are always drawn, so that a rate changes none of the other faults.
            let (mut draw, normal): (f64, f64) = (random.random(), StandardNormal.sample(random));
            let error = self.gross_error_factor * arrival.observation.sigma * normal;
            let mut happens = |rate: f64| {
                let before = draw;
                draw -= rate;
                (0.0..rate).contains(&before)
            };
            if happens(self.gross_error_rate) {
                arrival.value += error;
                arrival.value_bias_removed += error;
            } else if happens(self.not_finite_rate) {
                (arrival.value, arrival.value_bias_removed) = (f64::NAN, f64::NAN);
            } else if happens(self.duplicate_rate) {
                spoilt.push(arrival.clone());
            } else if happens(self.misplaced_rate) {
                arrival.observation.report.y_m += 2.0 * grid.height_m();
            } else if happens(self.late_rate) {
                arrival.time = arrival.time + Duration::from_seconds(-window.seconds());
            }
            spoilt.push(arrival);
        }
        spoilt
    }
}
