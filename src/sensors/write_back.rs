//! What a run has found out of its sensors: the calibration of the method that writes, as a table beside the run's other
//! files, and from there into the database.

use super::database::{Database, Missing};
use super::record::{Record, Records};
use super::{SensorError, table};
use crate::event::RunInfo;
use faer::MatRef;
use isobar_model::Time;
use isobar_obs::{Parameter, Placement};
use std::path::Path;

/// The table in the directory of a run.
pub const SENSORS_FILE: &str = "sensors.csv";

/// The most parameters whose covariances are written; of more only the variances are.
const MOST_TOGETHER: usize = 1000;

/// The last calibration of a method, as records.
///
/// # Errors
/// In words: a parameter whose name or value no record can have.
pub fn records(info: &RunInfo, method: &str, mean: &[f64], covariance: MatRef<'_, f64>) -> Result<Records, String> {
    let origin = format!("{} {method} seed {}", info.scenario, info.seed);
    calibration(&info.calibration.parameters, (info.time(info.cycles), &origin), mean, covariance)
}

/// Sensors and their calibration at a time by an origin, in the parameters' units: mean `[p]` and covariance `[p, p]`.
///
/// # Errors
/// In words: a parameter whose name or value no record can have.
pub fn calibration(
    parameters: &[Parameter],
    (time, origin): (Time, &str),
    mean: &[f64],
    covariance: MatRef<'_, f64>,
) -> Result<Records, String> {
    let mut records = Records::default();
    for (i, parameter) in parameters.iter().enumerate() {
        let place = match parameter.placement {
            Placement::Local { x_m, y_m } => Some((x_m, y_m)),
            Placement::Shared => None,
        };
        let (name, unit) = (parameter.name.clone(), parameter.unit.clone());
        records.add(Record::Sensor { name: name.clone(), unit, place, note: String::new() })?;
        let (origin, sigma) = (origin.to_string(), covariance[(i, i)].sqrt());
        records.add(Record::Calibration { sensor: name, time, origin, value: mean[i], sigma })?;
    }
    if parameters.len() <= MOST_TOGETHER {
        for (i, parameter) in parameters.iter().enumerate() {
            for (j, other) in parameters.iter().enumerate().take(i).filter(|(j, _)| covariance[(i, *j)] != 0.0) {
                // A correlation of one in rounding.
                let most = (covariance[(i, i)].sqrt() * covariance[(j, j)].sqrt()).abs();
                records.add(Record::Covariance {
                    sensor: parameter.name.clone(),
                    other: other.name.clone(),
                    time,
                    origin: origin.to_string(),
                    covariance: covariance[(i, j)].clamp(-most, most),
                })?;
            }
        }
    }
    Ok(records)
}

/// Takes the table of a complete run into a database, as [`store`].
///
/// # Errors
/// As [`table::read`] and [`store`].
pub fn write_back(run: &Path, database: &Path) -> Result<usize, SensorError> {
    let path = run.join(SENSORS_FILE);
    let (lines, records): (Vec<u64>, Vec<Record>) = table::read(&path)?.into_iter().unzip();
    store(records, database, |number, reason| SensorError::at(&path, lines[number], reason))
}

/// Takes sensors and one calibration of them into a database, in one transaction; how many records are new. A calibration of
/// the same time and origin, from an earlier run of the same experiment, is replaced; a sensor that is there keeps its place
/// and note. `fault` makes the error of a record, given its number.
///
/// # Errors
/// As [`Database::open`] and [`Database::update`]; a record that contradicts another one.
pub fn store(
    new: impl IntoIterator<Item = Record>,
    database: &Path,
    fault: impl Fn(usize, String) -> SensorError,
) -> Result<usize, SensorError> {
    let new: Vec<Record> = new.into_iter().collect();
    Database::open(database, Missing::Create)?.update(|records| {
        for row in &new {
            if let Record::Calibration { time, origin, .. } = row {
                records.remove_calibration(*time, origin);
                break;
            }
        }
        for (number, row) in new.into_iter().enumerate() {
            if matches!(row, Record::Sensor { .. }) && known_sensor(records, &row) {
                continue;
            }
            records.add(row).map_err(|reason| fault(number, reason))?;
        }
        Ok(())
    })
}

/// Whether the sensor is there, in the same unit.
fn known_sensor(records: &Records, sensor: &Record) -> bool {
    match (records.get(&sensor.key()), sensor) {
        (Some(Record::Sensor { unit, .. }), Record::Sensor { unit: other, .. }) => unit == other,
        _ => false,
    }
}
