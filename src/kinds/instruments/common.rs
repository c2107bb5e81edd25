//! What several kinds of instruments have in common.

use crate::reader::{Absent, AnyKey, Described, Field, Key, Limits, Read, ScenarioError, Section, Whole, YesNo};
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

pub(super) const FIRST_CYCLE: Key<Described> = Key::absent(
    "first_cycle",
    "",
    Described("a whole number from 1 to `interval_cycles`"),
    Absent::Means("1"),
    "first cycle in which it reports",
);

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

const FAULTS: Key<Described> = Key::absent(
    "faults",
    "",
    Described(
        "a table of the probabilities `gross_error_rate`, `not_finite_rate`, `duplicate_rate`, `misplaced_rate` and \
         `late_rate`, and of `gross_error_factor` (20), the size of gross errors in standard deviations",
    ),
    Absent::Explained("no faults"),
    "reports that must not be believed, to try quality control on",
);

/// What instruments that make their own observations have in common.
pub(super) const COMMON: &[&dyn AnyKey] = &[&ASSIMILATE, &INTERVAL_CYCLES, &FIRST_CYCLE, &MISSING_RATE, &FAULTS];

/// The most groups that a list may name.
pub(super) const MOST_GROUPS: usize = 1000;

/// A list of at most `most` different names; empty where it is not given.
pub(super) fn texts(section: &Section<'_>, key: &str, most: usize) -> Read<Vec<String>> {
    section.optional(key).map_or(Ok(Vec::new()), |field| field.texts(most))
}

/// Reads the faults of a network.
pub(super) fn faults(section: &Section<'_>) -> Read<Faults> {
    let none = Faults::NONE;
    let Some(field) = section.optional(FAULTS.name) else { return Ok(none) };
    let keys =
        ["gross_error_rate", "gross_error_factor", "not_finite_rate", "duplicate_rate", "misplaced_rate", "late_rate"];
    let section = field.section(&keys)?;
    let rate = |key| section.number_or(key, 0.0, Limits::Fraction);
    Ok(Faults {
        gross_error_rate: rate("gross_error_rate")?,
        gross_error_factor: section.number_or("gross_error_factor", none.gross_error_factor, Limits::Positive)?,
        not_finite_rate: rate("not_finite_rate")?,
        duplicate_rate: rate("duplicate_rate")?,
        misplaced_rate: rate("misplaced_rate")?,
        late_rate: rate("late_rate")?,
    })
}

/// The fault of a file, at the key that names it.
pub(super) fn at_file(field: &Field<'_>, error: &TableError) -> ScenarioError {
    field.invalid(clean_lines(&error.to_string()), "this file")
}
