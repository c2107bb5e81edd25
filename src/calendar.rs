//! Valid times as text.

use isobar_model::Time;

/// A valid time as text: `2026-01-15T06:00:00Z`; seconds since 1970 where the calendar ends.
pub fn utc(time: Time) -> String {
    match jiff::Timestamp::from_second(time.seconds()) {
        Ok(timestamp) => timestamp.to_string(),
        Err(_) => time.seconds().to_string(),
    }
}
