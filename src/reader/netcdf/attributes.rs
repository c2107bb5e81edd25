//! What attributes of variables say by the CF conventions: units of lengths and times.

use crate::text::clean;
use isobar_model::Time;
use isobar_obs::times;
use netcdf_reader::NcVariable;

/// An attribute that is text.
pub(super) fn text(variable: &NcVariable, attribute: &str) -> Option<String> {
    variable.attribute(attribute)?.value.as_string()
}

/// A unit as it can be compared with others.
pub(super) fn plain_unit(unit: &str) -> String {
    let unit = unit.trim().replace("**", "").replace(['^', '.', '*'], " ");
    let unit = unit.split_whitespace().collect::<Vec<_>>().join(" ");
    match unit.as_str() {
        "m/s" | "meter/second" | "m / s" => "m s-1".to_string(),
        "metre" | "metres" | "meter" | "meters" | "gpm" => "m".to_string(),
        "" => "1".to_string(),
        _ => unit,
    }
}

/// The metres in a unit of length, if it is one of a plane.
pub(super) fn metres(unit: &str) -> Option<f64> {
    match unit.trim() {
        "m" | "metre" | "metres" | "meter" | "meters" => Some(1.0),
        "km" | "kilometre" | "kilometres" | "kilometer" | "kilometers" => Some(1e3),
        _ => None,
    }
}

/// Seconds, minutes, hours or days since a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeUnits {
    since: Time,
    seconds: f64,
}

impl TimeUnits {
    /// Those of a variable of times.
    pub fn of(variable: &NcVariable) -> Result<Self, String> {
        let units = text(variable, "units").unwrap_or_default();
        let (shown, name) = (clean(&units), clean(variable.name()));
        let fault = || format!("`{name}` is in `{shown}`, but must be in seconds, minutes, hours or days since a time");
        let (unit, since) = units.split_once(" since ").ok_or_else(fault)?;
        let seconds = match unit.trim() {
            "s" | "sec" | "secs" | "second" | "seconds" => 1.0,
            "min" | "mins" | "minute" | "minutes" => 60.0,
            "h" | "hr" | "hrs" | "hour" | "hours" => 3600.0,
            "d" | "day" | "days" => 86_400.0,
            _ => return Err(fault()),
        };
        let calendar = text(variable, "calendar").unwrap_or_else(|| "standard".into());
        if !["standard", "gregorian", "proleptic_gregorian"].contains(&calendar.trim()) {
            return Err(format!("`{name}` has the calendar `{}`, but must have the standard one", clean(&calendar)));
        }
        let since = since.trim().trim_end_matches(".0");
        let since = if since.contains(':') { since.to_string() } else { format!("{since} 00:00:00") };
        Ok(Self { since: times::parse(&since).map_err(|_| fault())?, seconds })
    }

    /// The time of a value; `None` unless it is a whole number of seconds.
    pub fn time(&self, value: f64) -> Option<Time> {
        let seconds = value * self.seconds;
        let whole = seconds.round();
        // Days in double precision are known to a microsecond.
        let is_whole = seconds.abs() < 1e12 && (seconds - whole).abs() < 1e-3;
        is_whole.then(|| Time::from_seconds(self.since.seconds() + whole as i64))
    }
}
