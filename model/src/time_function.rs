//! Known functions of time, with their exact integrals.

use crate::error::{ModelError, require_finite};
use crate::time::{Duration, Time};
use std::f64::consts::{PI, TAU};

/// A known function of time, u(t).
#[derive(Clone, Debug, PartialEq)]
pub enum TimeFunction {
    /// 1.
    Constant,
    /// cos(2π (t − t₀)/P), with t and t₀ from 1970-01-01T00:00Z, so that with a period of a day t₀ is a time of the day (UTC).
    Sinusoid {
        /// P.
        period: Duration,
        /// t₀, a time at which it is highest.
        highest_at: Duration,
    },
    /// Linear between times in ascending order; before the first and after the last of them as there.
    Table(Vec<(Time, f64)>),
}

impl TimeFunction {
    /// Fails for a period that is not positive, and a table that is empty, not in ascending order or not finite.
    ///
    /// # Errors
    /// [`ModelError`] that says what is wrong.
    pub fn check(&self) -> Result<(), ModelError> {
        match self {
            TimeFunction::Constant => Ok(()),
            TimeFunction::Sinusoid { period, .. } => crate::error::require_positive("period", period.as_f64()),
            TimeFunction::Table(knots) => {
                let fault =
                    |reason: &str| Err(ModelError::Source { reason: format!("a table of time and value {reason}") });
                if knots.is_empty() {
                    return fault("is empty");
                }
                if knots.windows(2).any(|pair| pair[0].0 >= pair[1].0) {
                    return fault("is not in ascending order of time");
                }
                knots.iter().try_for_each(|knot| require_finite("value", knot.1))
            }
        }
    }

    /// The first and the last time of a table; `None` if it is known at all times.
    pub fn span(&self) -> Option<(Time, Time)> {
        match self {
            TimeFunction::Table(knots) => Some((knots.first()?.0, knots.last()?.0)),
            _ => None,
        }
    }

    /// ∫ u dt from `from_s` to `to_s` seconds after a time \[s\], without any error but rounding.
    ///
    /// That of the sinusoid is P/π cos(2π (t_m − t₀)/P) sin(π Δ/P), with t_m the middle and Δ the length of the interval: a
    /// difference of two sines would lose digits where Δ is short.
    pub fn integral(&self, time: Time, [from_s, to_s]: [f64; 2]) -> f64 {
        match self {
            TimeFunction::Constant => to_s - from_s,
            TimeFunction::Sinusoid { period, highest_at } => {
                // Whole seconds are reduced as such: a time is a large number beside a step.
                let since = (time.seconds() - highest_at.seconds()).rem_euclid(period.seconds()) as f64;
                let (period, middle) = (period.as_f64(), since + 0.5 * (from_s + to_s));
                period / PI * (TAU * middle / period).cos() * (PI * (to_s - from_s) / period).sin()
            }
            TimeFunction::Table(knots) => {
                let at = |knot: usize| ((knots[knot].0 - time).as_f64(), knots[knot].1);
                let ((first_s, first), (last_s, last)) = (at(0), at(knots.len() - 1));
                let mut sum =
                    first * (first_s.min(to_s) - from_s).max(0.0) + last * (to_s - last_s.max(from_s)).max(0.0);
                let begin = knots.partition_point(|knot| (knot.0 - time).as_f64() <= from_s).max(1);
                for next in begin..knots.len() {
                    let ((left_s, left), (right_s, right)) = (at(next - 1), at(next));
                    if left_s >= to_s {
                        break;
                    }
                    let (start_s, end_s) = (left_s.max(from_s), right_s.min(to_s));
                    let part = (0.5 * (start_s + end_s) - left_s) / (right_s - left_s);
                    sum += (end_s - start_s) * (left + part * (right - left));
                }
                sum
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: Duration = Duration::from_seconds(86_400);

    /// Simpson's rule with many points.
    fn by_quadrature(value: impl Fn(f64) -> f64, [from_s, to_s]: [f64; 2]) -> f64 {
        let (count, width) = (2000, (to_s - from_s) / 2000.0);
        let weight = |point: usize| match point {
            0 => 1.0,
            _ if point == count => 1.0,
            _ => (2 + 2 * (point % 2)) as f64,
        };
        (0..=count).map(|point| weight(point) * value(from_s + point as f64 * width)).sum::<f64>() * width / 3.0
    }

    #[test]
    fn integrals_are_those_of_the_functions() {
        let noon = Time::from_seconds(20_000 * 86_400 + 43_200);
        let sinusoid = TimeFunction::Sinusoid { period: DAY, highest_at: Duration::from_seconds(43_200) };
        for span in [[0.0, 86_400.0], [0.0, 300.0], [-7.5, 30_000.0], [40_000.0, 40_001.0]] {
            assert_eq!(TimeFunction::Constant.integral(noon, span), span[1] - span[0]);
            let expected = by_quadrature(|t| (TAU * t / 86_400.0).cos(), span);
            assert!((sinusoid.integral(noon, span) - expected).abs() < 1e-11 * 86_400.0, "{span:?}: {expected}");
        }
    }

    #[test]
    fn a_table_is_linear_between_its_times_and_constant_beyond() {
        let start = Time::from_seconds(1_000_000);
        let knots = [(0, 1.0), (100, 3.0), (400, 0.0)].map(|(s, value)| (start + Duration::from_seconds(s), value));
        let table = TimeFunction::Table(knots.to_vec());
        for (span, expected) in [
            ([0.0, 100.0], 200.0),
            ([0.0, 50.0], 75.0),
            ([50.0, 250.0], 125.0 + 150.0 * 2.25),
            ([-10.0, 0.0], 10.0),
            ([-10.0, 500.0], 10.0 + 200.0 + 450.0),
            ([300.0, 300.0], 0.0),
            ([450.0, 500.0], 0.0),
        ] {
            let found = table.integral(start, span);
            assert!((found - expected).abs() < 1e-10, "{span:?}: {found}");
            // Whatever the time from which seconds are counted.
            let later = table.integral(start + Duration::from_seconds(30), span.map(|s| s - 30.0));
            assert!((later - expected).abs() < 1e-10, "{span:?}: {later}");
        }
    }

    #[test]
    fn what_is_no_function_is_refused() {
        let sinusoid = |seconds| TimeFunction::Sinusoid { period: Duration::from_seconds(seconds), highest_at: DAY };
        let table = |knots: &[(i64, f64)]| {
            TimeFunction::Table(knots.iter().map(|&(s, value)| (Time::from_seconds(s), value)).collect())
        };
        for (bad, expected) in [
            (sinusoid(0), "period = 0"),
            (table(&[]), "is empty"),
            (table(&[(5, 1.0), (5, 2.0)]), "ascending"),
            (table(&[(5, 1.0), (6, f64::NAN)]), "value = NaN"),
        ] {
            let message = bad.check().unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        assert!(sinusoid(1).check().is_ok() && table(&[(5, 1.0)]).check().is_ok());
    }
}
