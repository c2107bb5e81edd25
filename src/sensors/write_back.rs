//! What a run has found out of its sensors: the calibration of the method that writes, as a table beside the run's other
//! files, and from there into the database.

use super::database::{Database, Missing};
use super::record::{Record, Records};
use super::{SensorError, table};
use crate::event::RunInfo;
use faer::MatRef;
use isobar_model::Time;
use isobar_obs::Placement;
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
    let time: Time = info.time(info.cycles);
    let origin = format!("{} {method} seed {}", info.scenario, info.seed);
    let parameters = &info.calibration.parameters;
    let mut records = Records::default();
    for (i, parameter) in parameters.iter().enumerate() {
        let place = match parameter.placement {
            Placement::Local { x_m, y_m } => Some((x_m, y_m)),
            Placement::Shared => None,
        };
        let (name, unit) = (parameter.name.clone(), parameter.unit.clone());
        records.add(Record::Sensor { name: name.clone(), unit, place, note: String::new() })?;
        let (origin, sigma) = (origin.clone(), covariance[(i, i)].sqrt());
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
                    origin: origin.clone(),
                    covariance: covariance[(i, j)].clamp(-most, most),
                })?;
            }
        }
    }
    Ok(records)
}

/// Takes the table of a complete run into a database, in one transaction; how many records are new. A calibration of the
/// same time and origin, from an earlier run of the same experiment, is replaced; a sensor that is there keeps its place
/// and note.
///
/// # Errors
/// As [`table::read`] and [`Database::update`].
pub fn write_back(run: &Path, database: &Path) -> Result<usize, SensorError> {
    let path = run.join(SENSORS_FILE);
    let rows = table::read(&path)?;
    Database::open(database, Missing::Create)?.update(|records| {
        for (_, row) in &rows {
            if let Record::Calibration { time, origin, .. } = row {
                records.remove_calibration(*time, origin);
                break;
            }
        }
        for (line, row) in rows {
            if matches!(row, Record::Sensor { .. }) && known_sensor(records, &row) {
                continue;
            }
            records.add(row).map_err(|reason| SensorError::at(&path, line, reason))?;
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
