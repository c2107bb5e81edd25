//! Biases: the true evolution of calibration parameters, and what methods may assume of it.

use crate::calibration::Drift;
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
    /// The change that methods assume; `None`: that of the truth if it is a random walk or an AR(1) process, else that
    /// there is no change.
    pub assumed_drift: Option<AssumedDrift>,
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
    /// An AR(1) process: b(t + Δt) = φ b(t) + N(0, σ² (1 − φ²)), φ = exp(−Δt/τ), σ the standard deviation of the prior.
    FirstOrder {
        /// τ in hours; above 0.
        correlation_hours: f64,
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

/// A change that methods assume of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AssumedDrift {
    /// A random walk.
    RandomWalk {
        /// Standard deviation of the change over one day.
        sigma_per_sqrt_day: f64,
    },
    /// An AR(1) process whose standard deviation is that of the prior.
    FirstOrder {
        /// Correlation time in hours; above 0.
        correlation_hours: f64,
    },
}

impl Evolution {
    /// The random changes that methods can assume, unless it is constant or changes by rule.
    fn at_random(self) -> Option<AssumedDrift> {
        match self {
            Evolution::RandomWalk { sigma_per_sqrt_day } => Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day }),
            Evolution::FirstOrder { correlation_hours } => Some(AssumedDrift::FirstOrder { correlation_hours }),
            Evolution::Constant | Evolution::Jump { .. } | Evolution::Sinusoid { .. } => None,
        }
    }
}

impl BiasProcess {
    /// A constant drawn from N(0, `sigma`²); methods know `sigma`.
    pub fn constant(sigma: f64) -> Self {
        Self {
            initial: InitialBias::Drawn { sigma },
            evolution: Evolution::Constant,
            assumed_sigma_prior: None,
            assumed_drift: None,
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

    /// The change that methods assume.
    pub fn drift(&self) -> Drift {
        drift(self.assumed_drift.or(self.evolution.at_random()), self.sigma_prior())
    }

    /// How the true value changes at random.
    pub fn true_drift(&self) -> Drift {
        let sigma = match self.initial {
            InitialBias::Drawn { sigma } => sigma,
            InitialBias::Given { .. } => self.sigma_prior(),
        };
        drift(self.evolution.at_random(), sigma)
    }

    /// The expectation of the true value `elapsed` after the start, at `time`.
    pub fn mean(&self, elapsed: Duration, time: Time) -> f64 {
        let initial = match self.initial {
            InitialBias::Drawn { .. } => 0.0,
            InitialBias::Given { value } => value,
        };
        self.true_drift().kept(elapsed) * initial + self.known_change(elapsed, time)
    }

    /// The variance of the true value at the start.
    pub fn initial_variance(&self) -> f64 {
        match self.initial {
            InitialBias::Drawn { sigma } => sigma * sigma,
            InitialBias::Given { .. } => 0.0,
        }
    }

    /// The part of the true value beyond its initial value and random changes, `elapsed` after the start, at `time`.
    pub(crate) fn known_change(&self, elapsed: Duration, time: Time) -> f64 {
        match self.evolution {
            Evolution::Jump { at_hours, size } if elapsed.as_f64() >= at_hours * 3600.0 => size,
            Evolution::Sinusoid { amplitude, period_hours, peak_hours } => {
                let hours = time.seconds() as f64 / 3600.0 - peak_hours;
                let phase = hours.rem_euclid(period_hours) / period_hours;
                amplitude * (std::f64::consts::TAU * phase).cos()
            }
            _ => 0.0,
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
            Evolution::FirstOrder { correlation_hours: hours } => {
                require(hours > 0.0, network, "biases.evolution.correlation_hours", hours, "above 0")?;
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
            match self.assumed_drift {
                None => {}
                Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day: sigma }) => {
                    require(sigma >= 0.0, network, "biases.assumed_drift.sigma_per_sqrt_day", sigma, "at least 0")?;
                }
                Some(AssumedDrift::FirstOrder { correlation_hours: hours }) => {
                    require(hours > 0.0, network, "biases.assumed_drift.correlation_hours", hours, "above 0")?;
                }
            }
        }
        Ok(())
    }
}

/// The drift with these random changes; `sigma` is the standard deviation of an AR(1) process.
fn drift(changes: Option<AssumedDrift>, sigma: f64) -> Drift {
    match changes {
        None => Drift::CONSTANT,
        Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day }) => Drift::RandomWalk { sigma_per_sqrt_day },
        Some(AssumedDrift::FirstOrder { correlation_hours }) => {
            // At least a second, which is the least that times differ by.
            let seconds = (correlation_hours * 3600.0).round().max(1.0);
            Drift::FirstOrder { sigma, correlation_time: Duration::from_seconds(seconds as i64) }
        }
    }
}
