//! Time as an integer: seconds since 1970-01-01T00:00:00Z, never an accumulated floating-point number.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::{Add, Mul, Sub};

/// A valid time, in whole seconds since 1970-01-01T00:00:00Z.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Time(i64);

/// A span of time, in whole seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Duration(i64);

impl Time {
    /// The time `seconds` after 1970-01-01T00:00:00Z.
    pub const fn from_seconds(seconds: i64) -> Self {
        Self(seconds)
    }

    /// Seconds since 1970-01-01T00:00:00Z.
    pub const fn seconds(self) -> i64 {
        self.0
    }
}

impl Duration {
    /// A span of `seconds`.
    pub const fn from_seconds(seconds: i64) -> Self {
        Self(seconds)
    }

    /// The span in seconds.
    pub const fn seconds(self) -> i64 {
        self.0
    }

    /// The span in seconds, as a number to compute with.
    pub const fn as_f64(self) -> f64 {
        self.0 as f64
    }

    /// The span in hours.
    pub fn hours(self) -> f64 {
        self.as_f64() / 3600.0
    }

    /// The span in days.
    pub fn days(self) -> f64 {
        self.as_f64() / 86_400.0
    }

    /// How often `step` fits into this span, if it does so a whole number of times (at least once).
    pub fn steps_of(self, step: Duration) -> Option<usize> {
        (step.0 > 0 && self.0 > 0 && self.0 % step.0 == 0).then(|| (self.0 / step.0) as usize)
    }
}

impl Add<Duration> for Time {
    type Output = Time;
    fn add(self, span: Duration) -> Time {
        Time(self.0 + span.0)
    }
}

impl Sub for Time {
    type Output = Duration;
    fn sub(self, earlier: Time) -> Duration {
        Duration(self.0 - earlier.0)
    }
}

impl Mul<usize> for Duration {
    type Output = Duration;
    fn mul(self, count: usize) -> Duration {
        Duration(self.0 * count as i64)
    }
}

impl fmt::Display for Duration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} s", self.0)
    }
}
