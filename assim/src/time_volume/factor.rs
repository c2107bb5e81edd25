//! The factors F^y and F^s: what errors of observations and of the model have in common over time (WO 97/18442, eq. (21)).

use crate::error::Error;
use isobar_model::{Duration, Layout, Location, Time};
use isobar_obs::Report;
use std::f64::consts::TAU;

/// A factor: unknown amplitudes of known functions of time, and of place if it has a pattern.
#[derive(Clone, Debug, PartialEq)]
pub struct Factor {
    /// Its name, for outputs.
    pub name: String,
    /// What it acts on.
    pub target: Target,
    /// How it depends on time.
    pub shape: TimeShape,
    /// How it depends on place: an amplitude for each field `[y, x]`, at centres of cells. Empty: the same everywhere.
    pub patterns: Vec<Vec<f64>>,
    /// How the amplitudes behave, and what is known of them before.
    pub evolution: AmplitudeEvolution,
}

/// What a factor acts on.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// F^y: the observations that these calibration parameters (by number) act on, by their coefficients.
    Observations(Vec<usize>),
    /// F^s: the forecast of a variable (by number), to which every cycle adds it.
    Forecast(usize),
}

/// A function of time, or several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeShape {
    /// 1.
    Constant,
    /// cos ωt and sin ωt; t from 1970-01-01T00:00Z, so that a period of a day begins at midnight UTC.
    Sinusoid {
        /// 2π/ω.
        period: Duration,
    },
    /// 1 in the first half of each period, −1 in the second.
    SquareWave {
        /// The period.
        period: Duration,
    },
    /// Piecewise linear: each is 1 at its own of `count` equidistant times of a period and 0 at the others.
    Hats {
        /// The period.
        period: Duration,
        /// How many.
        count: usize,
    },
}

/// How amplitudes behave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AmplitudeEvolution {
    /// Constant over the window.
    Constant {
        /// Standard deviation of a prior N(0, σ²); `None` for no prior.
        sigma_prior: Option<f64>,
    },
    /// A random walk from N(0, σ²).
    RandomWalk {
        /// σ.
        sigma_prior: f64,
        /// Standard deviation of the change over one day.
        sigma_per_sqrt_day: f64,
    },
    /// AR(1): C(t + Δt) = φ C(t) + w, φ = exp(−Δt/τ), with the stationary distribution N(0, σ²).
    FirstOrder {
        /// σ.
        sigma: f64,
        /// τ.
        correlation_time: Duration,
    },
}

impl AmplitudeEvolution {
    /// The variance of an amplitude that nothing is observed of, a time t after the start: the stationary σ² of a first-order
    /// process, σ² + q t of a random walk; infinite without a prior.
    pub(super) fn unobserved_variance(self, since_start: Duration) -> f64 {
        match self {
            AmplitudeEvolution::Constant { sigma_prior } => sigma_prior.map_or(f64::INFINITY, |sigma| sigma.powi(2)),
            AmplitudeEvolution::RandomWalk { sigma_prior, sigma_per_sqrt_day } => {
                sigma_prior.powi(2) + sigma_per_sqrt_day.powi(2) * since_start.days()
            }
            AmplitudeEvolution::FirstOrder { sigma, .. } => sigma.powi(2),
        }
    }
}

impl TimeShape {
    /// What its functions are called; an empty name if there is one only.
    fn names(self) -> Vec<String> {
        match self {
            TimeShape::Constant | TimeShape::SquareWave { .. } => vec![String::new()],
            TimeShape::Sinusoid { .. } => vec!["cosine".into(), "sine".into()],
            TimeShape::Hats { count, .. } => (1..=count).map(|number| format!("hat {number}")).collect(),
        }
    }

    /// The value of function `number` at a time.
    pub fn value(self, number: usize, time: Time) -> f64 {
        let phase = |period: Duration| time.seconds().rem_euclid(period.seconds()) as f64 / period.as_f64();
        match self {
            TimeShape::Constant => 1.0,
            TimeShape::Sinusoid { period } if number == 0 => (TAU * phase(period)).cos(),
            TimeShape::Sinusoid { period } => (TAU * phase(period)).sin(),
            TimeShape::SquareWave { period } => {
                if phase(period) < 0.5 {
                    1.0
                } else {
                    -1.0
                }
            }
            TimeShape::Hats { period, count } => {
                let distance = (phase(period) * count as f64 - number as f64).rem_euclid(count as f64);
                (1.0 - distance.min(count as f64 - distance)).max(0.0)
            }
        }
    }
}

impl Factor {
    /// Fails if the factor makes no sense for these variables and `parameters` calibration parameters.
    pub(super) fn check(&self, layout: &Layout, parameters: usize) -> Result<(), Error> {
        let fault = |what: String| Err(Error::Setting(format!("factor {}: {what}", self.name)));
        match &self.target {
            Target::Observations(numbers) if numbers.is_empty() => return fault("it acts on no observation".into()),
            Target::Observations(numbers) if numbers.iter().any(|&number| number >= parameters) => {
                return fault("there is no such calibration parameter".into());
            }
            Target::Forecast(variable) if *variable >= layout.variables.len() => {
                return fault("there is no such variable".into());
            }
            _ => {}
        }
        match self.shape {
            TimeShape::Sinusoid { period } | TimeShape::SquareWave { period } | TimeShape::Hats { period, .. }
                if period.seconds() < 1 =>
            {
                return fault(format!("the period must be positive, not {period}"));
            }
            TimeShape::Hats { count, .. } if count < 2 => return fault("hat functions must be two at least".into()),
            _ => {}
        }
        let cells = layout.grid.cells();
        match self.patterns.iter().find(|pattern| pattern.len() != cells) {
            Some(pattern) => fault(format!("a pattern has {} values, but the grid {cells} cells", pattern.len())),
            None => Ok(()),
        }
    }

    /// Its amplitudes: name, pattern and function of time of each.
    pub(super) fn amplitudes(&self) -> Vec<(String, Option<usize>, usize)> {
        let patterns: Vec<Option<usize>> = match self.patterns.len() {
            0 => vec![None],
            count => (0..count).map(Some).collect(),
        };
        let mut amplitudes = Vec::new();
        for pattern in patterns {
            for (function, own) in self.shape.names().into_iter().enumerate() {
                let mut name = self.name.clone();
                if let Some(pattern) = pattern {
                    name += &format!("/eof {}", pattern + 1);
                }
                if !own.is_empty() {
                    name += &format!("/{own}");
                }
                amplitudes.push((name, pattern, function));
            }
        }
        amplitudes
    }

    /// The pattern at an observation; 1 without one.
    pub(super) fn at_report(&self, pattern: Option<usize>, report: &Report, layout: &Layout) -> f64 {
        let Some(pattern) = pattern else { return 1.0 };
        let stencil = layout.grid.stencil(Location::Center, report.x_m, report.y_m);
        let field = &self.patterns[pattern];
        stencil.map_or(0.0, |it| it.entries.iter().map(|&(index, weight)| weight * field[index]).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_of_time_have_their_shapes() {
        let period = Duration::from_seconds(86_400);
        let at =
            |shape: TimeShape, number, hour: i64| shape.value(number, Time::from_seconds(1_000 * 86_400 + 3600 * hour));
        let sinusoid = TimeShape::Sinusoid { period };
        assert!((at(sinusoid, 0, 0) - 1.0).abs() < 1e-12 && (at(sinusoid, 1, 6) - 1.0).abs() < 1e-12);
        assert!((at(sinusoid, 0, 12) + 1.0).abs() < 1e-12 && at(sinusoid, 0, 6).abs() < 1e-12);
        let square = TimeShape::SquareWave { period };
        assert_eq!([0, 11, 12, 23, 24].map(|hour| at(square, 0, hour)), [1.0, 1.0, -1.0, -1.0, 1.0]);
        let hats = TimeShape::Hats { period, count: 4 };
        assert_eq!([0, 3, 6, 9, 21].map(|hour| at(hats, 0, hour)), [1.0, 0.5, 0.0, 0.0, 0.5]);
        for hour in 0..24 {
            let sum: f64 = (0..4).map(|number| at(hats, number, hour)).sum();
            assert!((sum - 1.0).abs() < 1e-12, "they are a partition of unity");
        }
    }
}
