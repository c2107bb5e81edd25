//! The tables of trackers and of their readings.
//!
//! A table of trackers has a row for each: `tracker`; its place `x_m`, `y_m`, `z_m`, eastward, northward and upward of any
//! origin; the standard deviations of its random errors `sigma_range_m`, `sigma_azimuth_deg`, `sigma_elevation_deg`, empty for a
//! quantity that it does not measure. It may have the prior standard deviations of its offsets, `sigma_range_offset_m`, `sigma_azimuth_offset_deg`, `sigma_elevation_offset_deg`, and of their change within a day,
//! `drift_range_m_per_sqrt_day`, `drift_azimuth_deg_per_sqrt_day`, `drift_elevation_deg_per_sqrt_day`.
//!
//! A table of readings has a row for each tracker and time: `time`, `tracker`, `range_m`, `azimuth_deg` from north, clockwise,
//! and `elevation_deg`. Fields without a value are empty.

use super::error::SoundingError;
use crate::safe_file;
use crate::sensors::table::refuse_unknown;
use crate::text::{listed, shown_path};
use isobar_assim::wind_finding::{Fix, Reading, Tracker};
use isobar_model::{Duration, Time};
use isobar_obs::table::{Faults, LARGEST, Row, Table, TableError, decode};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// The largest table \[bytes\].
const LARGEST_TABLE: u64 = 500_000_000;

/// The most trackers.
const MOST_TRACKERS: usize = 1000;

const PLACE: [&str; 3] = ["x_m", "y_m", "z_m"];
const SIGMAS: [&str; 3] = ["sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg"];
const OFFSETS: [&str; 3] = ["sigma_range_offset_m", "sigma_azimuth_offset_deg", "sigma_elevation_offset_deg"];
const DRIFTS: [&str; 3] =
    ["drift_range_m_per_sqrt_day", "drift_azimuth_deg_per_sqrt_day", "drift_elevation_deg_per_sqrt_day"];
const READINGS: [&str; 3] = ["range_m", "azimuth_deg", "elevation_deg"];

/// Units of what trackers measure, as databases of sensors name them.
const UNITS: [&str; 3] = ["m", "degree", "degree"];

/// What readings may be, in their units.
const BOUNDS: [(f64, f64); 3] = [(f64::MIN_POSITIVE, LARGEST), (-360.0, 720.0), (-90.0, 90.0)];

/// The factor from a unit of these tables to m or rad.
pub fn scale(unit: &str) -> f64 {
    if unit == "degree" { 1.0_f64.to_radians() } else { 1.0 }
}

/// The prior of an offset, and its drift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// Its unit: m or degree.
    pub unit: &'static str,
    /// Its standard deviation, if one is given.
    pub sigma_prior: Option<f64>,
    /// The standard deviation of its change within a day.
    pub drift_per_sqrt_day: f64,
}

impl Offset {
    /// The factor from its unit to m or rad.
    pub fn scale(&self) -> f64 {
        scale(self.unit)
    }
}

/// The trackers of a table.
#[derive(Clone, Debug)]
pub struct TrackerTable {
    file: String,
    /// The trackers.
    pub trackers: Vec<Tracker>,
    /// Their offsets, in the order of [`offset_names`](isobar_assim::wind_finding::offset_names).
    pub offsets: Vec<Offset>,
}

/// The readings of a flight.
#[derive(Clone, Debug)]
pub struct Readings {
    /// The time of the first fix.
    pub begin: Time,
    /// The fixes, one for each time, with their times since the first.
    pub fixes: Vec<Fix>,
}

fn text(path: &Path) -> Result<Vec<u8>, SoundingError> {
    let failure = |error: std::io::Error| SoundingError::File { file: shown_path(path), reason: error.to_string() };
    safe_file::read_named(path, LARGEST_TABLE).map_err(failure)
}

/// Refuses columns that the table cannot have, and a table without one of those that it needs.
fn check_columns(table: &Table<'_>, known: &[&str], needed: &[&str]) -> Result<(), TableError> {
    refuse_unknown(table, known)?;
    match needed.iter().find(|name| table.find(name).is_none()) {
        Some(name) => Err(table.missing(&format!("`{name}`"), &[name])),
        None => Ok(()),
    }
}

/// The number in a column that may be missing or empty.
fn optional(row: &Row<'_>, column: Option<usize>, bounds: (f64, f64), faults: &mut Faults) -> Option<f64> {
    let column = column.filter(|&column| !row.is_missing(column))?;
    row.number(column, bounds, faults)
}

impl TrackerTable {
    /// Reads a table.
    ///
    /// # Errors
    /// A file that cannot be read; all lines that are not trackers, with what would be right.
    pub fn read(path: &Path) -> Result<Self, SoundingError> {
        let (bytes, file) = (text(path)?, shown_path(path));
        let text = decode(&bytes, &file)?;
        let known: Vec<&str> = ["tracker"].into_iter().chain([PLACE, SIGMAS, OFFSETS, DRIFTS].concat()).collect();
        let none = || TableError::whole(&file, "has no trackers: it needs a header line and a line for each tracker");
        let table = Table::new(text, &file, &known)?.ok_or_else(none)?;
        check_columns(&table, &known, &["tracker", PLACE[0], PLACE[1], PLACE[2]])?;
        let find = |names: [&str; 3]| names.map(|name| table.find(name));
        let (name, places) =
            (table.find("tracker").unwrap_or_default(), PLACE.map(|it| table.find(it).unwrap_or_default()));
        let (sigmas, priors, drifts) = (find(SIGMAS), find(OFFSETS), find(DRIFTS));
        let (mut faults, mut trackers, mut offsets) = (Faults::default(), Vec::<Tracker>::new(), Vec::new());
        let above_zero = (f64::MIN_POSITIVE, LARGEST);
        table.each_row(&mut faults, |row, faults| {
            let place = places.map(|column| row.number(column, (-LARGEST, LARGEST), faults));
            let sigma =
                |i: usize, faults: &mut Faults| Some(optional(&row, sigmas[i], above_zero, faults)? * scale(UNITS[i]));
            let sigma = [0, 1, 2].map(|i| sigma(i, faults));
            if sigma.iter().all(Option::is_none) {
                faults.add(row.line, format!("the tracker measures nothing: it needs one of {}", listed(SIGMAS)));
            }
            for i in (0..3).filter(|&i| sigma[i].is_some()) {
                offsets.push(Offset {
                    unit: UNITS[i],
                    sigma_prior: optional(&row, priors[i], above_zero, faults),
                    drift_per_sqrt_day: optional(&row, drifts[i], (0.0, LARGEST), faults).unwrap_or(0.0),
                });
            }
            let Some(name) = row.name(name, faults) else { return };
            if trackers.iter().any(|other| other.name == name) {
                faults.add(row.line, format!("the tracker `{name}` is there twice"));
            }
            trackers.push(Tracker {
                name: name.to_owned(),
                place_m: place.map(Option::unwrap_or_default),
                sigma_range_m: sigma[0],
                sigma_azimuth_rad: sigma[1],
                sigma_elevation_rad: sigma[2],
            });
        });
        faults.check(&file)?;
        if trackers.is_empty() {
            return Err(none().into());
        }
        if trackers.len() > MOST_TRACKERS {
            return Err(TableError::whole(&file, format!("has more than {MOST_TRACKERS} trackers")).into());
        }
        Ok(Self { file, trackers, offsets })
    }

    /// Whether the table gives prior standard deviations of the offsets.
    ///
    /// # Errors
    /// If it gives those of some offsets only.
    pub fn has_priors(&self) -> Result<bool, TableError> {
        let given = self.offsets.iter().filter(|offset| offset.sigma_prior.is_some()).count();
        if given == 0 || given == self.offsets.len() {
            return Ok(given > 0);
        }
        let problem = format!("has standard deviations of some offsets only: give all of {}, or none", listed(OFFSETS));
        Err(TableError::whole(&self.file, problem))
    }

    /// The error that the table has no priors, which a database needs for the sensors that it does not know.
    pub(super) fn without_priors(&self) -> SoundingError {
        let columns = listed(OFFSETS);
        TableError::whole(
            &self.file,
            format!("needs {columns} with a database of sensors: the priors of the sensors that it does not know"),
        )
        .into()
    }
}

impl Readings {
    /// Reads a table.
    ///
    /// # Errors
    /// A file that cannot be read; all lines that are not readings of these trackers, with what would be right.
    pub fn read(path: &Path, trackers: &TrackerTable) -> Result<Self, SoundingError> {
        let (bytes, file) = (text(path)?, shown_path(path));
        let text = decode(&bytes, &file)?;
        let known: Vec<&str> = ["time", "tracker"].into_iter().chain(READINGS).collect();
        let none = || TableError::whole(&file, "has no readings: it needs a header line and a line for each reading");
        let table = Table::new(text, &file, &known)?.ok_or_else(none)?;
        check_columns(&table, &known, &["time", "tracker"])?;
        let column = |name: &str| table.find(name).unwrap_or_default();
        let (time, name, values) = (column("time"), column("tracker"), READINGS.map(|name| table.find(name)));
        let numbers: HashMap<&str, usize> =
            trackers.trackers.iter().enumerate().map(|(number, it)| (it.name.as_str(), number)).collect();
        let empty = || vec![Reading::default(); trackers.trackers.len()];
        let (mut faults, mut fixes) = (Faults::default(), BTreeMap::<i64, Vec<Reading>>::new());
        table.each_row(&mut faults, |row, faults| {
            let Some(&tracker) = numbers.get(row.text(name)) else {
                let names = listed(trackers.trackers.iter().map(|tracker| tracker.name.as_str()).take(20));
                return faults
                    .add(row.line, format!("`tracker` is `{}`, but the trackers are {names}", row.text(name)));
            };
            let sigmas = trackers.trackers[tracker].sigmas();
            let read = [0, 1, 2].map(|i| {
                let value = optional(&row, values[i], BOUNDS[i], faults)?;
                if sigmas[i].is_none() {
                    let (column, sigma) = (READINGS[i], SIGMAS[i]);
                    faults.add(row.line, format!("`{column}` is given, but the tracker has no {sigma}"));
                }
                Some(value * scale(UNITS[i]))
            });
            let Some(time) = row.time(time, faults) else { return };
            let reading = Reading { range_m: read[0], azimuth_rad: read[1], elevation_rad: read[2] };
            if reading == Reading::default() {
                return;
            }
            let place = &mut fixes.entry(time.seconds()).or_insert_with(empty)[tracker];
            if *place != Reading::default() {
                faults.add(row.line, format!("`{}` has another reading of this time", row.text(name)));
            }
            *place = reading;
        });
        faults.check(&file)?;
        let Some(begin) = fixes.keys().next().copied() else { return Err(none().into()) };
        let fixes = fixes.into_iter();
        let fixes = fixes.map(|(seconds, readings)| Fix { seconds: (seconds - begin) as f64, readings }).collect();
        Ok(Self { begin: Time::from_seconds(begin), fixes })
    }

    /// The time of the last fix.
    pub fn end(&self) -> Time {
        let seconds = self.fixes.last().map_or(0.0, |fix| fix.seconds);
        self.begin + Duration::from_seconds(seconds as i64)
    }
}
