//! What several kinds of instruments have in common.

use crate::reader::{Absent, AnyKey, Field, Key, Limits, Read, ScenarioError, Section, Table, Whole, YesNo};
use crate::text::clean_lines;
use isobar_obs::Faults;
use isobar_obs::table::TableError;

pub(super) const INTERVAL_CYCLES: Key<Whole> = Key::absent(
    "interval_cycles",
    "cycles",
    Whole(1, 1_000_000),
    Absent::Means(1),
    "interval between the cycles in which it reports",
);

pub(super) const FIRST_CYCLE: Key<Whole> =
    Key::absent("first_cycle", "", Whole(1, 1_000_000), Absent::Means(1), "first cycle in which it reports");

pub(super) const MISSING_RATE: Key<Limits> = Key::absent(
    "missing_rate",
    "1",
    Limits::Fraction,
    Absent::Means(0.0),
    "probability that a station or footprint does not report in a cycle",
);

pub(super) const ASSIMILATE: Key<YesNo> = Key::absent(
    "assimilate",
    "",
    YesNo,
    Absent::Means(true),
    "whether methods assimilate it; a passive network (`false`) is compared with their estimates and does nothing else",
);

pub(super) const WITHHOLD: Key<Limits> = Key::absent(
    "withhold",
    "1",
    Limits::Between(0.0, 0.9),
    Absent::Means(0.0),
    "share of the stations, chosen by the seed, that no method sees: they are compared with estimates and do nothing else",
);

pub(super) const TIMES_PER_WINDOW: Key<Whole> = Key::absent(
    "times_per_window",
    "",
    Whole(1, 100_000),
    Absent::Means(1),
    "at how many times of a cycle it observes, at equal intervals, the last at the analysis: scan lines follow each other, \
     stations take turns; the time steps of the truth must meet all of them",
);

const FAULTS: Key<Table> = Key::absent(
    "faults",
    "",
    Table(&[&GROSS_ERROR_RATE, &GROSS_ERROR_FACTOR, &NOT_FINITE_RATE, &DUPLICATE_RATE, &MISPLACED_RATE, &LATE_RATE]),
    Absent::Explained("no faults"),
    "reports that must not be believed, to try quality control on",
);

const GROSS_ERROR_RATE: Key<Limits> = rate("gross_error_rate", "probability of a gross error");

const GROSS_ERROR_FACTOR: Key<Limits> = Key::absent(
    "gross_error_factor",
    "1",
    Limits::Positive,
    Absent::Means(Faults::NONE.gross_error_factor),
    "size of gross errors in standard deviations of the random error",
);

const NOT_FINITE_RATE: Key<Limits> = rate("not_finite_rate", "probability of a value that is not a number");

const DUPLICATE_RATE: Key<Limits> = rate("duplicate_rate", "probability that an observation is reported twice");

const MISPLACED_RATE: Key<Limits> =
    rate("misplaced_rate", "probability that a report gives a place outside of the domain");

const LATE_RATE: Key<Limits> = rate("late_rate", "probability that a report is one cycle old");

const fn rate(name: &'static str, meaning: &'static str) -> Key<Limits> {
    Key::absent(name, "1", Limits::Fraction, Absent::Means(0.0), meaning)
}

/// What instruments that make their own observations have in common.
pub(super) const COMMON: &[&dyn AnyKey] =
    &[&ASSIMILATE, &INTERVAL_CYCLES, &FIRST_CYCLE, &TIMES_PER_WINDOW, &MISSING_RATE, &FAULTS];

/// The most groups that a list may name.
pub(super) const MOST_GROUPS: usize = 1000;

/// A list of at most `most` different names; empty where it is not given.
pub(super) fn texts(section: &Section<'_>, key: &str, most: usize) -> Read<Vec<String>> {
    section.optional(key).map_or(Ok(Vec::new()), |field| field.texts(most))
}

/// Reads the faults of a network.
pub(super) fn faults(section: &Section<'_>) -> Read<Faults> {
    let Some(field) = section.optional(FAULTS.name) else { return Ok(Faults::NONE) };
    let section = field.section_with(FAULTS.allowed.0)?;
    Ok(Faults {
        gross_error_rate: section.get(&GROSS_ERROR_RATE)?,
        gross_error_factor: section.get(&GROSS_ERROR_FACTOR)?,
        not_finite_rate: section.get(&NOT_FINITE_RATE)?,
        duplicate_rate: section.get(&DUPLICATE_RATE)?,
        misplaced_rate: section.get(&MISPLACED_RATE)?,
        late_rate: section.get(&LATE_RATE)?,
    })
}

/// The fault of a file, at the key that names it.
pub(super) fn at_file(field: &Field<'_>, error: &TableError) -> ScenarioError {
    field.invalid(clean_lines(&error.to_string()), "this file")
}
