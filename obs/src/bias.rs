//! Biases: the true evolution of calibration parameters, and what methods may assume of it.

use crate::error::{ObservationError, require};
use isobar_model::{Duration, Time};

/// How one bias parameter b(t) truly behaves, and what methods may assume of it. Numbers are in the parameter's unit,
/// that of the observed variable.
#[derive(Clone, Debug, PartialEq)]
pub struct BiasProcess {
    /// The value at the start.
    pub initial: InitialBias,
    /// How it changes.
    pub evolution: Evolution,
    /// Standard deviation of the prior that methods assume; `None`: that of the truth, or the size of a given value.
    pub assumed_sigma_prior: Option<f64>,
    /// Standard deviation over one day of the random walk that methods assume; `None`: that of the truth, thus 0
    /// unless the truth is a random walk.
    pub assumed_sigma_drift_per_sqrt_day: Option<f64>,
    /// Whether the instrument is calibrated: the bias is taken out of the data before any method sees them, and is no
    /// parameter of the [`Calibration`](crate::Calibration).
    pub known: bool,
}

/// The true value of a bias parameter at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitialBias {
    /// Drawn from N(0, `sigma`²).
    Drawn {
        /// Standard deviation, at least 0.
        sigma: f64,
    },
    /// Given.
    Given {
        /// The value.
        value: f64,
    },
}

/// How the true value of a bias parameter changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Evolution {
    /// Not at all.
    Constant,
    /// A Wiener process: b(t + Δt) = b(t) + N(0, σ² Δt), Δt in days.
    RandomWalk {
        /// σ, the standard deviation of the change over one day.
        sigma_per_sqrt_day: f64,
    },
    /// It is larger by `size` from one time on: a recalibration, a new type of sonde.
    Jump {
        /// When, in hours since the start; at least 0.
        at_hours: f64,
        /// By how much, of either sign.
        size: f64,
    },
    /// It is larger by `amplitude` cos(2π (t/period − phase)), t the time of day in UTC if the period is a day: sensors
    /// that the sun heats. Methods do not know of it.
    Sinusoid {
        /// The largest deviation.
        amplitude: f64,
        /// The period in hours; above 0.
        period_hours: f64,
        /// When it is largest, in hours since midnight UTC of 1970-01-01, and periods after that.
        peak_hours: f64,
    },
}

impl BiasProcess {
    /// A constant drawn from N(0, `sigma`²); methods know `sigma`.
    pub fn constant(sigma: f64) -> Self {
        Self {
            initial: InitialBias::Drawn { sigma },
            evolution: Evolution::Constant,
            assumed_sigma_prior: None,
            assumed_sigma_drift_per_sqrt_day: None,
            known: false,
        }
    }

    /// The standard deviation of the prior that methods assume.
    pub fn sigma_prior(&self) -> f64 {
        self.assumed_sigma_prior.unwrap_or(match self.initial {
            InitialBias::Drawn { sigma } => sigma,
            InitialBias::Given { value } => value.abs(),
        })
    }

    /// The standard deviation over one day of the random walk that methods assume.
    pub fn sigma_drift_per_sqrt_day(&self) -> f64 {
        self.assumed_sigma_drift_per_sqrt_day.unwrap_or(match self.evolution {
            Evolution::RandomWalk { sigma_per_sqrt_day } => sigma_per_sqrt_day,
            Evolution::Constant | Evolution::Jump { .. } | Evolution::Sinusoid { .. } => 0.0,
        })
    }

    /// The expectation of the true value `elapsed` after the start, at `time`.
    pub fn mean(&self, elapsed: Duration, time: Time) -> f64 {
        let initial = match self.initial {
            InitialBias::Drawn { .. } => 0.0,
            InitialBias::Given { value } => value,
        };
        initial + self.known_change(elapsed, time)
    }

    /// The variance of the true value at the start.
    pub fn initial_variance(&self) -> f64 {
        match self.initial {
            InitialBias::Drawn { sigma } => sigma * sigma,
            InitialBias::Given { .. } => 0.0,
        }
    }

    /// The variance that the true value gains in a day.
    pub fn variance_per_day(&self) -> f64 {
        match self.evolution {
            Evolution::RandomWalk { sigma_per_sqrt_day } => sigma_per_sqrt_day.powi(2),
            Evolution::Constant | Evolution::Jump { .. } | Evolution::Sinusoid { .. } => 0.0,
        }
    }

    /// The part of the true value beyond its initial value and random walk, `elapsed` after the start, at `time`.
    pub(crate) fn known_change(&self, elapsed: Duration, time: Time) -> f64 {
        match self.evolution {
            Evolution::Jump { at_hours, size } if elapsed.as_f64() >= at_hours * 3600.0 => size,
            Evolution::Sinusoid { amplitude, period_hours, peak_hours } => {
                let hours = time.seconds() as f64 / 3600.0 - peak_hours;
                let phase = hours.rem_euclid(period_hours) / period_hours;
                amplitude * (std::f64::consts::TAU * phase).cos()
            }
            Evolution::Constant | Evolution::RandomWalk { .. } | Evolution::Jump { .. } => 0.0,
        }
    }

    pub(crate) fn validate(&self, network: &str) -> Result<(), ObservationError> {
        match self.initial {
            InitialBias::Drawn { sigma } => {
                require(sigma >= 0.0, network, "biases.initial.sigma", sigma, "at least 0")?;
            }
            InitialBias::Given { value } => require(true, network, "biases.initial.value", value, "finite")?,
        }
        match self.evolution {
            Evolution::Constant => {}
            Evolution::RandomWalk { sigma_per_sqrt_day: sigma } => {
                require(sigma >= 0.0, network, "biases.evolution.sigma_per_sqrt_day", sigma, "at least 0")?;
            }
            Evolution::Jump { at_hours, size } => {
                require(at_hours >= 0.0, network, "biases.evolution.at_hours", at_hours, "at least 0")?;
                require(true, network, "biases.evolution.size", size, "finite")?;
            }
            Evolution::Sinusoid { amplitude, period_hours, peak_hours } => {
                require(true, network, "biases.evolution.amplitude", amplitude, "finite")?;
                let expected = "above 0";
                require(period_hours > 0.0, network, "biases.evolution.period_hours", period_hours, expected)?;
                require(true, network, "biases.evolution.peak_hours", peak_hours, "finite")?;
            }
        }
        if !self.known {
            let prior = self.sigma_prior();
            let expected = "above 0: it is the prior of an unknown parameter, by default that of the true value \
                            (give it, or take the bias out, or make it known)";
            require(prior > 0.0, network, "biases.assumed_sigma_prior", prior, expected)?;
            let drift = self.sigma_drift_per_sqrt_day();
            let setting = "biases.assumed_sigma_drift_per_sqrt_day";
            require(drift >= 0.0, network, setting, drift, "at least 0")?;
        }
        Ok(())
    }
}
