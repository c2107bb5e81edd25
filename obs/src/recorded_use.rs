//! What becomes of the observations of a file, and how many biases they have.

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
    /// Without the value of a predictor of their bias.
    pub no_predictor: usize,
    /// The same again.
    pub duplicate: usize,
    /// The rest.
    pub usable: usize,
    /// The biases that methods estimate.
    pub biases: Vec<BiasUse>,
}

/// How many parameters a bias of recorded observations has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BiasUse {
    /// The biased variable.
    pub variable: String,
    /// The column to which the bias is proportional, if it is.
    pub column: Option<String>,
    /// Whose biases they are: `station`, `group` or `all`.
    pub per: &'static str,
    /// The number of parameters.
    pub parameters: usize,
    /// The stations or groups that have none, since none of their observations can be used.
    pub without: Vec<String>,
}

impl fmt::Display for RecordedUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rows, missing, in_no_cycle, late, outside, no_predictor, duplicate, usable, biases: _ } = self;
        write!(f, "{usable} of {rows} observations can be used")?;
        let reasons = [
            (missing, "missing"),
            (in_no_cycle, "not valid in any cycle"),
            (
                late,
                "not valid at the end of a cycle (time_tolerance_minutes or observation_times = \"window\" allow for that)",
            ),
            (outside, "outside of the domain"),
            (no_predictor, "without a predictor of their bias"),
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

impl fmt::Display for BiasUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const MOST_NAMED: usize = 5;
        let Self { variable, column, per, parameters, without } = self;
        write!(f, "bias of {variable}")?;
        if let Some(column) = column {
            write!(f, " by {column}")?;
        }
        match *per {
            "all" => write!(f, ", the same for all")?,
            per => write!(f, " per {per}")?,
        }
        write!(f, ": {parameters} to estimate")?;
        if without.is_empty() {
            return Ok(());
        }
        let named = without.iter().take(MOST_NAMED).map(String::as_str).collect::<Vec<_>>().join(", ");
        let more = if without.len() > MOST_NAMED { ", …" } else { "" };
        write!(f, "; none for {} without an observation of it that can be used: {named}{more}", without.len())
    }
}
