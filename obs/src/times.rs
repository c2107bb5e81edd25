//! Times as files and scenarios write them: one rule for all.

use isobar_model::Time;
use jiff::civil::{self, Date};

/// The days of universal time that ended with a second 60, as year, month, day (IERS Bulletin C).
const LEAP_SECONDS: [(i16, i8, i8); 27] = [
    (1972, 6, 30),
    (1972, 12, 31),
    (1973, 12, 31),
    (1974, 12, 31),
    (1975, 12, 31),
    (1976, 12, 31),
    (1977, 12, 31),
    (1978, 12, 31),
    (1979, 12, 31),
    (1981, 6, 30),
    (1982, 6, 30),
    (1983, 6, 30),
    (1985, 6, 30),
    (1987, 12, 31),
    (1989, 12, 31),
    (1990, 12, 31),
    (1992, 6, 30),
    (1993, 6, 30),
    (1994, 6, 30),
    (1995, 12, 31),
    (1997, 6, 30),
    (1998, 12, 31),
    (2005, 12, 31),
    (2008, 12, 31),
    (2012, 6, 30),
    (2015, 6, 30),
    (2016, 12, 31),
];

/// What is accepted, in words.
const FORM: &str = "such as 2026-01-15T06:00:00Z, in whole seconds";

const DAY: i64 = 86_400;

/// A time such as `2026-01-15T06:00:00Z`: ISO 8601 with `T` or a blank, seconds or none, and whole seconds. The zone is `Z`,
/// `UTC`, `GMT` or an offset such as `+02:00`; without a zone it is universal time. A day may end at 24:00:00. A leap second
/// is the first second of the next day, as POSIX counts.
///
/// # Errors
/// What would be right, for this text, as it continues "must be a time".
pub fn parse(text: &str) -> Result<Time, String> {
    let text = text.trim();
    if text.contains('[') {
        return Err(format!("{FORM}; names of time zones are not read, give the offset such as +02:00"));
    }
    if text.contains('/') || text.find('.').is_some_and(|point| point < 8) {
        return Err(format!("{FORM}; year, month and day in this order"));
    }
    let mut rest = text;
    let form = || FORM.to_owned();
    let date = date(&mut rest).ok_or_else(form)?;
    let (hour, minute, second) = match rest.strip_prefix(['T', 't', ' ']) {
        Some(clock) => {
            rest = clock.trim_start();
            time_of_day(&mut rest)?
        }
        None if rest.is_empty() => return Err(format!("{FORM}; the time of day is missing")),
        None => return Err(form()),
    };
    let offset = offset(rest.trim()).ok_or_else(form)?;
    let seconds = days(date) * DAY + hour * 3600 + minute * 60 + second - offset;
    if second == 60 {
        let last = seconds - 1;
        let is_leap = |&(year, month, day): &(i16, i8, i8)| days(civil::date(year, month, day)) == last.div_euclid(DAY);
        if last.rem_euclid(DAY) != DAY - 1 || !LEAP_SECONDS.iter().any(is_leap) {
            return Err(format!("{FORM}; there was no second 60 then"));
        }
    }
    Ok(Time::from_seconds(seconds))
}

/// Days since 1970.
fn days(date: Date) -> i64 {
    date.duration_since(civil::date(1970, 1, 1)).as_hours() / 24
}

/// Takes a date from the beginning, `2026-01-15` or `20260115`.
fn date(rest: &mut &str) -> Option<Date> {
    let year = digits(rest, 4)?;
    let extended = take(rest, '-');
    let month = digits(rest, 2)?;
    if extended && !take(rest, '-') {
        return None;
    }
    let day = digits(rest, 2)?;
    Date::new(year as i16, month as i8, day as i8).ok()
}

/// Takes hour, minute and second from the beginning.
fn time_of_day(rest: &mut &str) -> Result<(i64, i64, i64), String> {
    let form = || FORM.to_owned();
    let hour = digits(rest, 2).ok_or_else(form)?;
    let extended = take(rest, ':');
    let minute = digits(rest, 2).ok_or_else(form)?;
    let second = match (extended, rest.starts_with(|c: char| c.is_ascii_digit())) {
        (true, _) if !take(rest, ':') => 0,
        (false, false) => 0,
        _ => digits(rest, 2).ok_or_else(form)?,
    };
    if take(rest, '.') || take(rest, ',') {
        let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
        if end == 0 || rest[..end].contains(|c| c != '0') {
            return Err(format!("{FORM}; there is a fraction of a second"));
        }
        *rest = &rest[end..];
    }
    if hour == 24 && (minute, second) != (0, 0) || hour > 24 || minute > 59 || second > 60 {
        return Err(format!("{FORM}; a day ends at 24:00:00"));
    }
    Ok((hour, minute, second))
}

/// Seconds by which a zone is ahead of universal time.
fn offset(zone: &str) -> Option<i64> {
    if ["", "Z", "UTC", "GMT"].iter().any(|name| zone.eq_ignore_ascii_case(name)) {
        return Some(0);
    }
    let mut rest = zone;
    let sign = if take(&mut rest, '+') {
        1
    } else if take(&mut rest, '-') {
        -1
    } else {
        return None;
    };
    let hours = digits(&mut rest, 2)?;
    take(&mut rest, ':');
    let minutes = if rest.is_empty() { 0 } else { digits(&mut rest, 2)? };
    (rest.is_empty() && hours <= 18 && minutes <= 59).then_some(sign * (hours * 3600 + minutes * 60))
}

/// Takes a number of exactly this many digits.
fn digits(rest: &mut &str, count: usize) -> Option<i64> {
    let number = rest.get(..count).filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()))?;
    *rest = &rest[count..];
    number.parse().ok()
}

/// Takes a character, if it is the first.
fn take(rest: &mut &str, character: char) -> bool {
    match rest.strip_prefix(character) {
        Some(after) => {
            *rest = after;
            true
        }
        None => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_moment_may_be_written_in_many_ways() {
        for text in [
            "2026-01-15T06:00:00Z",
            "2026-01-15t06:00:00z",
            "2026-01-15T06:00:00",
            "2026-01-15 06:00",
            "2026-01-15 06:00:00 UTC",
            "2026-01-15 06:00:00GMT",
            "2026-01-15T06:00:00.000Z",
            "2026-01-15 01:00:00-05:00",
            "2026-01-15T08:00:00+0200",
            "2026-01-15 08:00:00 +02",
            "20260115T060000Z",
        ] {
            assert_eq!(parse(text), Ok(Time::from_seconds(1_768_456_800)), "{text}");
        }
        assert_eq!(parse("2026-01-14T24:00:00Z"), parse("2026-01-15T00:00:00Z"));
        assert_eq!(parse("1969-12-31T23:59:59Z"), Ok(Time::from_seconds(-1)));
    }

    #[test]
    fn a_leap_second_is_the_next_second_and_another_second_60_is_refused() {
        let new_year = parse("2017-01-01T00:00:00Z");
        assert_eq!(parse("2016-12-31T23:59:60Z"), new_year);
        assert_eq!(parse("2017-01-01T01:59:60+02:00"), new_year);
        assert_eq!(parse("1972-06-30 23:59:60"), parse("1972-07-01 00:00:00"));
        for text in
            ["2026-01-15T05:59:60Z", "2016-12-31T18:00:60Z", "2016-12-31T23:59:60+02:00", "2017-12-31T23:59:60Z"]
        {
            assert!(parse(text).unwrap_err().contains("no second 60"), "{text}");
        }
    }

    #[test]
    fn what_is_not_such_a_time_is_refused() {
        for (text, expected) in [
            ("noon", "such as"),
            ("2026-01-15", "time of day"),
            ("", "such as"),
            ("2026-01-15T06:00:00.5Z", "fraction"),
            ("2026-01-15T06:00:00[Europe/Helsinki]", "+02:00"),
            ("2026-01-15T06:00:00+02:00[Europe/Helsinki]", "+02:00"),
            ("2026-02-30T06:00:00Z", "such as"),
            ("2026-01-15T24:00:01Z", "24:00:00"),
            ("2026-01-15T25:00Z", "24:00:00"),
            ("2026-01-15T06:00 EST", "such as"),
            ("2026-01-15T06:00:00+25:00", "such as"),
            ("15.01.2026 06:00", "in this order"),
            ("01/15/2026 06:00", "in this order"),
            ("2026-1-5 06:00", "such as"),
            ("2026-01-15T6:00", "such as"),
            ("1768456800", "such as"),
            ("2026-01-15T06:00:00ZZ", "such as"),
            ("é026-01-15", "such as"),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }
}
