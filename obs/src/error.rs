//! What can be wrong with a file of stations or observations or with the description of an observing system.

use crate::table::TableError;

/// Everything that can be wrong with a file of stations or observations or with the configuration of an instrument.
/// Variants about a file carry its name and the line; variants about a configuration carry the instrument and the
/// setting.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ObservationError {
    /// A file of stations or observations is not such a table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A file of observations does not say what its network does not say either.
    #[error("{instrument}: {file} has no column `{setting}`; add it, or give `{setting}` for the network")]
    NotSaid {
        /// The network.
        instrument: String,
        /// The file.
        file: String,
        /// The setting, which is also the name of the column.
        setting: &'static str,
    },
    /// Winds to the east and north are said to be in a file without places on the Earth.
    #[error("{instrument}: {file} has no latitudes and longitudes, without which east and north are not known")]
    WindsNotOnEarth {
        /// The network.
        instrument: String,
        /// The file.
        file: String,
    },
    /// No observation of a file is valid after the start.
    #[error("{instrument}: none of the {observations} observations of {file} is valid after the start of the run")]
    NoneAfterStart {
        /// The network.
        instrument: String,
        /// The file.
        file: String,
        /// Number of observations.
        observations: usize,
    },
    /// The saved memory of an observing system is of another one.
    #[error("the saved observing system is not that of this experiment")]
    UnfitSavedSystem,
    /// The file gives latitudes and longitudes, but the domain has no place on the Earth.
    #[error(
        "{instrument}: {file} gives latitudes and longitudes, but the domain has no projection; give the latitude and longitude of its centre, or stations in x_m and y_m"
    )]
    NoProjection {
        /// The network.
        instrument: String,
        /// The station file.
        file: String,
    },
    /// No station lies in the domain.
    #[error(
        "{instrument}: none of the {stations} stations lies in the domain; check the centre of the projection, the domain's size and edge_margin_m = {edge_margin_m}"
    )]
    NoStationInDomain {
        /// The network.
        instrument: String,
        /// Number of stations offered.
        stations: usize,
        /// Distance to the edges that was asked for \[m\].
        edge_margin_m: f64,
    },
    /// The column to group by is not in the station file.
    #[error("{instrument}: there is no column `{column}` to group the stations of {file} by; it has {valid}")]
    UnknownGroupColumn {
        /// The network.
        instrument: String,
        /// The station file.
        file: String,
        /// The column asked for.
        column: String,
        /// The columns that are there.
        valid: String,
    },
    /// A setting names something that is not there.
    #[error("{instrument}: {setting} names `{value}`, which is not known; valid: {valid}")]
    UnknownName {
        /// The instrument.
        instrument: String,
        /// The setting, as the configuration calls it.
        setting: &'static str,
        /// The name that is not known.
        value: String,
        /// The names that are.
        valid: String,
    },
    /// Two things that must differ have the same name.
    #[error("{instrument}: {setting} has `{value}` twice; each may occur once")]
    DuplicateName {
        /// The instrument.
        instrument: String,
        /// The setting, as the configuration calls it.
        setting: &'static str,
        /// The name.
        value: String,
    },
    /// A name is empty or contains a slash.
    #[error("the instrument name `{value}` is not usable: a name must not be empty and must not contain `/`")]
    InvalidInstrumentName {
        /// The name.
        value: String,
    },
    /// A list that needs at least one entry is empty.
    #[error("{instrument}: {setting} is empty; it needs at least one entry")]
    EmptyList {
        /// The instrument.
        instrument: String,
        /// The setting, as the configuration calls it.
        setting: &'static str,
    },
    /// A number is not what it must be.
    #[error("{instrument}: {setting} is {value}, but must be {expected}")]
    InvalidNumber {
        /// The instrument.
        instrument: String,
        /// The setting, as the configuration calls it.
        setting: &'static str,
        /// The number.
        value: f64,
        /// What would be right.
        expected: String,
    },
    /// A bias is given to a group or station that is to be the reference.
    #[error(
        "{instrument}: a bias is given to `{value}`, which is in the reference group `{group}`; reference groups have no bias"
    )]
    BiasOnReference {
        /// The network.
        instrument: String,
        /// The group or station.
        value: String,
        /// The reference group.
        group: String,
    },
    /// Every group is a reference, so that a bias for each of the others has nothing to apply to.
    #[error(
        "{instrument}: the bias on `{variable}` applies to nothing, since every station is in a reference group ({reference_groups})"
    )]
    BiasOnNothing {
        /// The network.
        instrument: String,
        /// The biased variable.
        variable: String,
        /// The reference groups.
        reference_groups: String,
    },
    /// The length of a cycle is not positive.
    #[error("the assimilation window is {seconds} s, but must be at least 1 s")]
    InvalidWindow {
        /// The window \[s\].
        seconds: i64,
    },
}

impl ObservationError {
    /// The instrument that is concerned, if it is one.
    pub fn instrument(&self) -> Option<&str> {
        use ObservationError::*;
        match self {
            NoProjection { instrument, .. }
            | NoStationInDomain { instrument, .. }
            | NoneAfterStart { instrument, .. }
            | NotSaid { instrument, .. }
            | WindsNotOnEarth { instrument, .. }
            | UnknownGroupColumn { instrument, .. }
            | UnknownName { instrument, .. }
            | DuplicateName { instrument, .. }
            | EmptyList { instrument, .. }
            | InvalidNumber { instrument, .. }
            | BiasOnReference { instrument, .. }
            | BiasOnNothing { instrument, .. } => Some(instrument),
            InvalidInstrumentName { value } => Some(value),
            Table(_) | UnfitSavedSystem | InvalidWindow { .. } => None,
        }
    }

    /// The file in which the fault is, as it was called; `None` if it is not within a file.
    pub fn file(&self) -> Option<&str> {
        match self {
            ObservationError::Table(error) => Some(&error.file),
            _ => None,
        }
    }

    /// The setting of the instrument that is concerned: the path of fields in its configuration, without the numbers of
    /// list entries (`biases.initial.sigma`).
    pub fn setting(&self) -> Option<&'static str> {
        use ObservationError::*;
        match self {
            UnknownName { setting, .. }
            | DuplicateName { setting, .. }
            | EmptyList { setting, .. }
            | InvalidNumber { setting, .. } => Some(setting),
            UnknownGroupColumn { .. } => Some("group_by"),
            NoneAfterStart { .. } | NotSaid { .. } => Some("file"),
            WindsNotOnEarth { .. } => Some("winds"),
            NoStationInDomain { .. } | NoProjection { .. } => Some("stations"),
            BiasOnReference { .. } | BiasOnNothing { .. } => Some("biases"),
            InvalidInstrumentName { .. } => Some("name"),
            _ => None,
        }
    }
}

/// Names as a message lists them: `a`, `b`, `c`.
pub(crate) fn list<S: AsRef<str>>(names: impl IntoIterator<Item = S>) -> String {
    let quoted: Vec<String> = names.into_iter().map(|name| format!("`{}`", name.as_ref())).collect();
    if quoted.is_empty() { "none".to_owned() } else { quoted.join(", ") }
}

/// `Ok` if `value` is finite and `right`, else the error that says what it must be.
pub(crate) fn require(
    right: bool,
    instrument: &str,
    setting: &'static str,
    value: f64,
    expected: impl Into<String>,
) -> Result<(), ObservationError> {
    if right && value.is_finite() {
        return Ok(());
    }
    Err(ObservationError::InvalidNumber {
        instrument: instrument.to_owned(),
        setting,
        value,
        expected: expected.into(),
    })
}
