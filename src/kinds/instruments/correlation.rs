//! `error_correlation` of a network: within what, and how far, its random errors are correlated.

use crate::kinds::{Kind, Kinds, form, read as read_kind};
use crate::reader::{Absent, AnyKey, Described, Form, Key, Limits, Read, Section};
use isobar_obs::{ErrorCorrelation, ErrorCorrelationKind, InstrumentSettings};

/// A correlation length in a scenario \[km\].
const LENGTH: Limits = Limits::Between(0.0, 1e5);

const LENGTH_KM: Key<Limits> =
    Key::required("length_km", "km", LENGTH, "distance over which the correlation of two errors falls by a factor e");

const ASSUMED_LENGTH_KM: Key<Limits> = Key::absent(
    "assumed_length_km",
    "km",
    LENGTH,
    Absent::Explained("`length_km`"),
    "the same as methods assume it; 0: independent errors",
);

const REPORT_BY: Key<Described> = Key::absent(
    "report_by",
    "",
    Described("a column of the file", Form::text),
    Absent::Explained("all observations of a variable in a cycle are one report"),
    "the column whose entries say which observations form a report; errors of different reports are independent",
);

const SYNTHETIC: &[&dyn AnyKey] = &[&LENGTH_KM, &ASSUMED_LENGTH_KM];

const SCAN_LINE: Kind<ErrorCorrelation, dyn InstrumentSettings> = Kind::new(
    "scan_line",
    "Along each scan line, exp(−d/length) with d the distance along the line",
    &[SYNTHETIC],
    |section, _| synthetic(section, ErrorCorrelationKind::ScanLine),
)
.only_if(|instrument| instrument.has_scan_lines());

const BY_DISTANCE: Kind<ErrorCorrelation, dyn InstrumentSettings> = Kind::new(
    "by_distance",
    "Between all observations of a variable in a cycle, exp(−d/length) with d the distance on the plane",
    &[SYNTHETIC],
    |section, _| synthetic(section, ErrorCorrelationKind::ByDistance),
)
.only_if(|instrument| !instrument.is_recorded());

const RECORDED_BY_DISTANCE: Kind<ErrorCorrelation, dyn InstrumentSettings> = Kind::new(
    "by_distance",
    "Between the observations of a variable in a report, exp(−d/length) with d the distance on the plane",
    &[&[&LENGTH_KM, &REPORT_BY]],
    |section, _| {
        let length_m = section.get(&LENGTH_KM)? * 1e3;
        let kind = ErrorCorrelationKind::ByDistance;
        Ok(Box::new(ErrorCorrelation { kind, length_m, assumed_length_m: length_m }))
    },
)
.only_if(|instrument| instrument.is_recorded());

/// The correlations that stations may have.
const OF_STATIONS: &Kinds<ErrorCorrelation, dyn InstrumentSettings> = &[&BY_DISTANCE];

/// Those that a satellite may have.
const OF_SATELLITES: &Kinds<ErrorCorrelation, dyn InstrumentSettings> = &[&SCAN_LINE, &BY_DISTANCE];

/// Those that recorded observations may have.
const OF_FILES: &Kinds<ErrorCorrelation, dyn InstrumentSettings> = &[&RECORDED_BY_DISTANCE];

const ALL: &Kinds<ErrorCorrelation, dyn InstrumentSettings> = &[&SCAN_LINE, &BY_DISTANCE, &RECORDED_BY_DISTANCE];

const NAME: &str = "error_correlation";

const fn key(words: &'static str, form: fn() -> Form) -> Key<Described> {
    Key::absent(
        NAME,
        "",
        Described(words, form),
        Absent::Explained("the errors are independent"),
        "how random errors of one variable are correlated within a report",
    )
}

/// The key of a network of stations.
pub(super) const STATIONS: Key<Described> = key("a table of kind \"by_distance\"", || form(OF_STATIONS));

/// The key of a satellite.
pub(super) const SATELLITE: Key<Described> =
    key("a table of kind \"scan_line\" or \"by_distance\"", || form(OF_SATELLITES));

/// The key of recorded observations.
pub(super) const FILE: Key<Described> = key("a table of kind \"by_distance\"", || form(OF_FILES));

/// Reads the key, if it is given.
pub(super) fn read(
    section: &Section<'_>,
    instrument: &(dyn InstrumentSettings + 'static),
) -> Read<Option<ErrorCorrelation>> {
    let Some(field) = section.optional(NAME) else { return Ok(None) };
    Ok(Some(*read_kind(&field, ALL, instrument)?))
}

/// The column that divides recorded observations into reports, if one does.
pub(super) fn report_by(section: &Section<'_>) -> Read<Option<String>> {
    let Some(field) = section.optional(NAME) else { return Ok(None) };
    field.any_section()?.optional(REPORT_BY.name).map(|field| field.text()).transpose()
}

fn synthetic(section: &Section<'_>, kind: ErrorCorrelationKind) -> Read<Box<ErrorCorrelation>> {
    let length_km = section.get(&LENGTH_KM)?;
    let assumed_length_km = section.find(&ASSUMED_LENGTH_KM)?.unwrap_or(length_km);
    Ok(Box::new(ErrorCorrelation { kind, length_m: length_km * 1e3, assumed_length_m: assumed_length_km * 1e3 }))
}
