//! Calibration c: the observing systems' unknown bias parameters, with names, units and prior knowledge.

use isobar_model::Duration;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Where a calibration parameter belongs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Placement {
    /// Common to many observations: a country, a sonde type, a satellite.
    Shared,
    /// Belongs to one place alone: the bias of the one station that stands there.
    Local {
        /// x of the station \[m\].
        x_m: f64,
        /// y of the station \[m\].
        y_m: f64,
    },
}

/// One calibration parameter, and what a method may assume about it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Unique name: `europe/h/FR`, `polar/scan_linear`.
    pub name: String,
    /// Unit, in UDUNITS spelling.
    pub unit: String,
    /// Shared or local.
    pub placement: Placement,
    /// Standard deviation of the prior N(0, σ²) at the start, in `unit`.
    pub sigma_prior: f64,
    /// How methods take it to change.
    pub drift: Drift,
}

/// How methods take a calibration parameter to change: A_c and Q_c of the recursion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Drift {
    /// c(t + Δt) = c(t) + N(0, σ² Δt), Δt in days; a constant if σ is 0.
    RandomWalk {
        /// σ, the standard deviation of the change over one day, in the parameter's unit.
        sigma_per_sqrt_day: f64,
    },
    /// c(t + Δt) = φ c(t) + N(0, σ² (1 − φ²)), φ = exp(−Δt/τ), an AR(1) process: what nobody observes goes back to N(0, σ²).
    FirstOrder {
        /// σ, the standard deviation in the long run, in the parameter's unit.
        sigma: f64,
        /// τ, above 0.
        correlation_time: Duration,
    },
}

impl Drift {
    /// No change at all.
    pub const CONSTANT: Drift = Drift::RandomWalk { sigma_per_sqrt_day: 0.0 };

    /// φ, the part of a value that is left after a time; at least 10⁻¹⁰⁰, so that it can be a divisor.
    pub fn kept(self, time: Duration) -> f64 {
        const LEAST: f64 = 1e-100;
        match self {
            Drift::RandomWalk { .. } => 1.0,
            Drift::FirstOrder { correlation_time, .. } => (-time.as_f64() / correlation_time.as_f64()).exp().max(LEAST),
        }
    }

    /// The variance that is added over a time.
    pub fn added_variance(self, time: Duration) -> f64 {
        match self {
            Drift::RandomWalk { sigma_per_sqrt_day } => sigma_per_sqrt_day.powi(2) * time.days(),
            // 1 − φ², accurate where the time is short.
            Drift::FirstOrder { sigma, correlation_time } => {
                -sigma.powi(2) * (-2.0 * time.as_f64() / correlation_time.as_f64()).exp_m1()
            }
        }
    }

    /// The standard deviation of what is added over a time.
    pub fn added_sigma(self, time: Duration) -> f64 {
        match self {
            Drift::RandomWalk { sigma_per_sqrt_day } => sigma_per_sqrt_day * time.days().sqrt(),
            Drift::FirstOrder { .. } => self.added_variance(time).sqrt(),
        }
    }

    /// Whether values change.
    pub fn changes(self) -> bool {
        self != Drift::CONSTANT
    }
}

/// The calibration parameters of an experiment, in a fixed order; values are a slice in this order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// The parameters.
    pub parameters: Vec<Parameter>,
    /// Prior covariances of pairs (i, j) of parameters with i > j, where they are not zero: of sensors that were calibrated
    /// together before.
    pub covariances: BTreeMap<(usize, usize), f64>,
}

impl Calibration {
    /// φ of each parameter over a time.
    pub fn kept(&self, time: Duration) -> Vec<f64> {
        self.parameters.iter().map(|parameter| parameter.drift.kept(time)).collect()
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.parameters.len()
    }

    /// Whether there are no parameters.
    pub fn is_empty(&self) -> bool {
        self.parameters.is_empty()
    }

    /// Prior covariance of the errors of two parameters: the matrix P_c that every method starts from.
    pub fn prior_covariance(&self, i: usize, j: usize) -> f64 {
        if i == j {
            return self.parameters[i].sigma_prior.powi(2);
        }
        self.covariances.get(&(i.max(j), i.min(j))).copied().unwrap_or(0.0)
    }

    /// The number of the parameter of this name.
    pub fn position(&self, name: &str) -> Option<usize> {
        self.parameters.iter().position(|parameter| parameter.name == name)
    }

    /// The numbers of the parameters, by where they belong.
    pub fn by_placement(&self) -> ByPlacement {
        let mut result = ByPlacement { shared: Vec::new(), local: Vec::new() };
        for (number, parameter) in self.parameters.iter().enumerate() {
            match parameter.placement {
                Placement::Shared => result.shared.push(number),
                Placement::Local { x_m, y_m } => result.local.push((number, (x_m, y_m))),
            }
        }
        result
    }
}

/// The numbers of calibration parameters, by where these belong.
#[derive(Clone, Debug, PartialEq)]
pub struct ByPlacement {
    /// Those that many observations share.
    pub shared: Vec<usize>,
    /// Those of one place, with its x and y \[m\].
    pub local: Vec<(usize, (f64, f64))>,
}
