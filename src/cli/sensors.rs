//! `isobar sensors`.

use super::console::{print, width};
use crate::calendar::utc;
use crate::safe_file;
use crate::sensors::database::Missing;
use crate::sensors::record::Key;
use crate::sensors::{Database, Record, Records, SensorError, table};
use crate::tables::{Cell, NONE, Table};
use crate::text::{clean, listed, nearest, printable, shown_path};
use clap::Subcommand;
use indexmap::IndexMap;
use isobar_model::Time;
use miette::{Report, miette};
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What to do with a database of sensors.
#[derive(Debug, Subcommand)]
pub enum SensorsCommand {
    /// List the sensors, each with its last calibration
    List {
        /// The database
        database: PathBuf,
    },
    /// Show all that is known of a sensor
    Show {
        /// The database
        database: PathBuf,
        /// The sensor, named as its bias parameter: sondes/h/DE
        sensor: String,
    },
    /// Take the records of a table into a database, all or none; makes the database if there is none
    #[command(after_help = import_help())]
    Import {
        /// The database
        database: PathBuf,
        /// The table, CSV as `export` writes it: see below
        table: PathBuf,
    },
    /// Print all records as CSV, which can be imported again
    Export {
        /// The database
        database: PathBuf,
        /// Write the table into this new file instead
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Announce that the bias of a sensor is another one from a time on
    Recalibrate {
        /// The database
        database: PathBuf,
        /// The sensor
        sensor: String,
        /// From when on: 2026-03-01T00:00:00Z
        #[arg(long, value_parser = time)]
        time: isobar_model::Time,
        /// The change of the bias, in its unit
        #[arg(long, allow_negative_numbers = true)]
        step: f64,
        /// Standard deviation of the error of the change
        #[arg(long, default_value_t = 0.0)]
        sigma: f64,
        /// Why
        #[arg(long, default_value = "")]
        note: String,
    },
}

/// Does it.
pub fn sensors(command: &SensorsCommand) -> Result<ExitCode, Report> {
    let read = |path: &Path| Database::open(path, Missing::Refuse)?.records();
    match command {
        SensorsCommand::List { database } => print(&list(&read(database)?))?,
        SensorsCommand::Show { database, sensor } => {
            let records = read(database)?;
            check_sensor(&records, sensor, database)?;
            print(&show(&records, sensor))?;
        }
        SensorsCommand::Import { database, table: path } => {
            let rows = table::read(path)?;
            let (all, path) = (rows.len(), path.clone());
            let new = Database::open(database, Missing::Create)?.update(|records| {
                rows.into_iter().try_for_each(|(line, record)| {
                    records.add(record).map(drop).map_err(|reason| SensorError::at(&path, line, reason))
                })
            })?;
            print(&format!("{}: {new} of {all} records are new", shown_path(database)))?;
        }
        SensorsCommand::Export { database, out } => {
            let text = table::write(&read(database)?);
            match out {
                Some(path) => {
                    safe_file::write_new(path, text.as_bytes()).map_err(|error| cannot_write(path, &error))?
                }
                None => print(text.trim_end())?,
            }
        }
        SensorsCommand::Recalibrate { database, sensor, time, step, sigma, note } => {
            let mut opened = Database::open(database, Missing::Refuse)?;
            check_sensor(&opened.records()?, sensor, database)?;
            let (sensor, time, note) = (sensor.clone(), *time, note.clone());
            let record = Record::Recalibration { sensor: sensor.clone(), time, step: *step, sigma: *sigma, note };
            let new = opened
                .update(|records| records.add(record).map(drop).map_err(|reason| SensorError::new(database, reason)))?;
            print(&match new {
                0 => format!("{}: it was announced before", clean(&sensor)),
                _ => format!("{}: {step:+} from {} on", clean(&sensor), utc(time)),
            })?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn cannot_write(path: &Path, error: &Error) -> Report {
    let shown = shown_path(path);
    match error.kind() {
        ErrorKind::AlreadyExists => {
            miette!(help = "give another path, or remove the file first", "{shown} exists; nothing was written")
        }
        _ => miette!("cannot write {shown}: {error}"),
    }
}

/// What a table looks like.
fn import_help() -> String {
    format!(
        "`value` is the bias of a calibration, the covariance of two, the reading of a test point whose true value is \
         `reference`,\nor the step of a recalibration. Columns may come in any order; those that are empty in all records \
         may be left out:\n\n{}",
        table::EXAMPLE
    )
}

fn names(records: &Records) -> impl Iterator<Item = &str> {
    records.iter().filter_map(|record| match record {
        Record::Sensor { name, .. } => Some(name.as_str()),
        _ => None,
    })
}

fn check_sensor(records: &Records, sensor: &str, database: &Path) -> Result<(), Report> {
    if records.get(&Key::Sensor(sensor.to_string())).is_some() {
        return Ok(());
    }
    let near = nearest(sensor, names(records)).map_or(String::new(), |near| format!("did you mean `{near}`?\n"));
    let help = printable(&format!("{near}sensors: {}", listed(names(records).take(20))));
    let database = shown_path(database);
    Err(miette!(help = help, "{database} has no sensor `{}`", clean(sensor)))
}

/// What there is of a sensor.
#[derive(Default)]
struct Known<'a> {
    unit: &'a str,
    /// Time, value and σ of the last calibration.
    last: Option<(Time, f64, f64)>,
    calibrations: usize,
    test_points: usize,
    recalibrations: usize,
}

fn list(records: &Records) -> String {
    // Sensors come before what is known of them, and calibrations in the order of their times.
    let mut sensors: IndexMap<&str, Known<'_>> = IndexMap::new();
    for record in records.iter() {
        if let Record::Sensor { name, unit, .. } = record {
            sensors.insert(name, Known { unit, ..Known::default() });
            continue;
        }
        let (Record::Calibration { sensor, .. }
        | Record::TestPoint { sensor, .. }
        | Record::Recalibration { sensor, .. }) = record
        else {
            continue;
        };
        let Some(known) = sensors.get_mut(sensor.as_str()) else { continue };
        match record {
            Record::Calibration { time, value, sigma, .. } => {
                known.calibrations += 1;
                known.last = Some((*time, *value, *sigma));
            }
            Record::TestPoint { .. } => known.test_points += 1,
            _ => known.recalibrations += 1,
        }
    }
    let row = |(name, known): (&str, Known<'_>)| {
        let last = known.last.map(|(time, value, sigma)| [format!("{value:.4} ± {sigma:.4}"), utc(time)]);
        let mut row = vec![name.into(), known.unit.into()];
        row.extend(last.map_or([NONE, NONE].map(Cell::from), |last| last.map(Cell::from)));
        row.extend([known.calibrations, known.test_points, known.recalibrations].map(Cell::from));
        row
    };
    let rows = sensors.into_iter().map(row).collect();
    let columns = ["sensor", "unit", "last bias ± σ", "of", "calibrations", "test points", "recalibrations"];
    Table::new(&columns, rows).terminal(width())
}

fn show(records: &Records, wanted: &str) -> String {
    let mut text = String::new();
    for record in records.iter() {
        let line = match record {
            Record::Sensor { name, unit, place, note } if name == wanted => {
                let place = place.map_or(String::new(), |(x_m, y_m)| format!(", at x = {x_m} m, y = {y_m} m"));
                let note = if note.is_empty() { String::new() } else { format!("; {note}") };
                format!("{name} [{unit}]{place}{note}")
            }
            Record::Calibration { sensor, time, origin, value, sigma } if sensor == wanted => {
                format!("{}  bias {value} ± {sigma}, by {origin}", utc(*time))
            }
            Record::Covariance { sensor, other, time, origin, covariance } if sensor == wanted || other == wanted => {
                let other = if sensor == wanted { other } else { sensor };
                format!("{}  covariance {covariance} with {other}, by {origin}", utc(*time))
            }
            Record::TestPoint { sensor, time, reading, reference, sigma } if sensor == wanted => {
                format!("{}  showed {reading} for {reference}, ± {sigma}", utc(*time))
            }
            Record::Recalibration { sensor, time, step, sigma, note } if sensor == wanted => {
                let note = if note.is_empty() { String::new() } else { format!("; {note}") };
                format!("{}  recalibrated by {step:+} ± {sigma}{note}", utc(*time))
            }
            _ => continue,
        };
        text.push_str(&line);
        text.push('\n');
    }
    text.trim_end().to_string()
}

/// A time of the command line.
fn time(text: &str) -> Result<Time, String> {
    isobar_obs::times::parse(text).map_err(|expected| format!("must be a time {expected}"))
}
