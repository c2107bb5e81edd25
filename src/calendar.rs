//! Valid times as text.

use isobar_model::Time;

/// A valid time as text: `2026-01-15T06:00:00Z`; seconds since 1970 where the calendar ends.
pub fn utc(time: Time) -> String {
    match jiff::Timestamp::from_second(time.seconds()) {
        Ok(timestamp) => timestamp.to_string(),
        Err(_) => time.seconds().to_string(),
    }
}

/// The time that a text such as `2026-01-15T06:00:00Z` names; `None` unless it is a time in whole seconds.
pub fn parse(text: &str) -> Option<Time> {
    let timestamp: jiff::Timestamp = text.parse().ok()?;
    (timestamp.subsec_nanosecond() == 0).then(|| Time::from_seconds(timestamp.as_second()))
}
