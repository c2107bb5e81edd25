//! What becomes of the observations of a file.

use std::fmt;

/// What becomes of the observations of a file, before quality control looks at their values.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordedUse {
    /// Rows of the file.
    pub rows: usize,
    /// Of these: without a value or a place.
    pub missing: usize,
    /// Valid before the first window or after the last.
    pub in_no_cycle: usize,
    /// Not valid at the end of a window.
    pub late: usize,
    /// Outside of the domain.
    pub outside: usize,
    /// The same again.
    pub duplicate: usize,
    /// The rest.
    pub usable: usize,
}

impl fmt::Display for RecordedUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rows, missing, in_no_cycle, late, outside, duplicate, usable } = self;
        write!(f, "{usable} of {rows} observations can be used")?;
        let reasons = [
            (missing, "missing"),
            (in_no_cycle, "not valid in any cycle"),
            (late, "not valid at the end of a cycle (time_tolerance_minutes allows for that)"),
            (outside, "outside of the domain"),
            (duplicate, "duplicate"),
        ];
        let mut separator = ": ";
        for (count, reason) in reasons.iter().filter(|reason| *reason.0 > 0) {
            write!(f, "{separator}{count} {reason}")?;
            separator = ", ";
        }
        Ok(())
    }
}
