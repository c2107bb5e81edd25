//! The SQLite file of records. Every change is one transaction: whenever the process ends, the file holds all of it or
//! nothing.

use super::SensorError;
use super::record::{Record, Records};
use crate::place::parent_of;
use crate::safe_file;
use crate::shipped;
use crate::text::{clean, shown_path};
use isobar_model::Time;
use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags, Row, Transaction, TransactionBehavior, params};
use std::fs;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// "ISOB": what tells the file from databases of other programs.
const APPLICATION_ID: i32 = 0x4953_4f42;

const OTHER_PROGRAM: &str = "it is a database, but of another program: not one of sensors";

/// The beginning of every SQLite database.
const MAGIC: &[u8] = b"SQLite format 3\0";

/// Where the identifier is after that, and the length of the whole head.
const ID_AT: usize = 68 - MAGIC.len();
const HEAD_LENGTH: u64 = 100;

/// Of the tables below.
const SCHEMA_VERSION: i32 = 1;

/// The largest database \[bytes\].
const LARGEST_DATABASE: u64 = 1_000_000_000;

/// How long another process may keep the database.
const PATIENCE: Duration = Duration::from_secs(10);

/// The tables, by name: to the letter what SQLite keeps of them.
const TABLES: [(&str, &str); 5] = [
    (
        "sensor",
        "CREATE TABLE sensor (name TEXT NOT NULL PRIMARY KEY, unit TEXT NOT NULL, x_m REAL, y_m REAL, note TEXT NOT NULL) \
         STRICT, WITHOUT ROWID",
    ),
    (
        "calibration",
        "CREATE TABLE calibration (time INTEGER NOT NULL, origin TEXT NOT NULL, sensor TEXT NOT NULL REFERENCES sensor, \
         value REAL NOT NULL, sigma REAL NOT NULL, PRIMARY KEY (time, origin, sensor)) STRICT, WITHOUT ROWID",
    ),
    (
        "covariance",
        "CREATE TABLE covariance (time INTEGER NOT NULL, origin TEXT NOT NULL, sensor TEXT NOT NULL REFERENCES sensor, \
         other TEXT NOT NULL REFERENCES sensor, value REAL NOT NULL, PRIMARY KEY (time, origin, sensor, other)) STRICT, \
         WITHOUT ROWID",
    ),
    (
        "test_point",
        "CREATE TABLE test_point (sensor TEXT NOT NULL REFERENCES sensor, time INTEGER NOT NULL, reading REAL NOT NULL, \
         reference REAL NOT NULL, sigma REAL NOT NULL, PRIMARY KEY (sensor, time, reading, reference)) STRICT, WITHOUT ROWID",
    ),
    (
        "recalibration",
        "CREATE TABLE recalibration (sensor TEXT NOT NULL REFERENCES sensor, time INTEGER NOT NULL, step REAL NOT NULL, \
         sigma REAL NOT NULL, note TEXT NOT NULL, PRIMARY KEY (sensor, time)) STRICT, WITHOUT ROWID",
    ),
];

/// A database of sensors.
pub struct Database {
    path: PathBuf,
    connection: Connection,
}

/// Whether a database that is not there is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// It is an error.
    Refuse,
    /// It is made.
    Create,
}

impl Database {
    /// Opens a database.
    ///
    /// # Errors
    /// A file that is not there, is no database of sensors, is of another version, too large, or damaged.
    pub fn open(path: &Path, missing: Missing) -> Result<Self, SensorError> {
        if let Some(bytes) = shipped::bytes(path).filter(|_| missing == Missing::Refuse) {
            return Self::of_program(path, bytes);
        }
        let real = real_path(path)?;
        let fresh = match fs::metadata(&real) {
            Ok(metadata) if !metadata.is_file() => return Err(SensorError::new(path, "it is not a file")),
            Ok(metadata) if metadata.len() > LARGEST_DATABASE => {
                let most = LARGEST_DATABASE / 1_000_000;
                return Err(SensorError::new(path, format!("it is larger than {most} MB, the largest database")));
            }
            Ok(metadata) => {
                check_program(path, &real, missing)?;
                metadata.len() == 0
            }
            Err(error) if error.kind() == ErrorKind::NotFound && missing == Missing::Create => true,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                return Err(SensorError::new(
                    path,
                    "there is no such database; `isobar sensors import --help` says how to make one",
                ));
            }
            Err(error) => return Err(SensorError::new(path, error)),
        };
        if fresh && missing == Missing::Refuse {
            return Err(SensorError::new(path, "it is empty, and so no database of sensors"));
        }
        let mut flags =
            OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_NOFOLLOW;
        if missing == Missing::Create {
            flags |= OpenFlags::SQLITE_OPEN_CREATE;
        }
        let opened = Connection::open_with_flags(&real, flags).and_then(|connection| {
            connection.busy_timeout(PATIENCE)?;
            // The file may come from anywhere: nothing in its schema is to be run.
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
            connection.pragma_update(None, "cell_size_check", true)?;
            connection.pragma_update(None, "foreign_keys", true)?;
            connection.pragma_update(None, "synchronous", "FULL")?;
            Ok(connection)
        });
        let connection = opened.map_err(|error| SensorError::new(path, in_words(&error)))?;
        let mut database = Self { path: path.to_path_buf(), connection };
        if missing == Missing::Create {
            database.create()?;
        }
        database.check()?;
        Ok(database)
    }

    /// The records of a database. One that is not there has none if it may be made, and is not made for that: the first of a chain
    /// of runs finds nothing, and writes the database.
    ///
    /// # Errors
    /// As [`Database::open`] and [`Database::records`].
    pub fn records_at(path: &Path, missing: Missing) -> Result<Records, SensorError> {
        if missing == Missing::Create && !path.exists() {
            return Ok(Records::default());
        }
        Self::open(path, Missing::Refuse)?.records()
    }

    /// A database inside the program, to be read only.
    fn of_program(path: &Path, bytes: &'static [u8]) -> Result<Self, SensorError> {
        let opened = Connection::open_in_memory().and_then(|mut connection| {
            connection.deserialize_bytes("main", bytes)?;
            Ok(connection)
        });
        let connection = opened.map_err(|error| SensorError::new(path, in_words(&error)))?;
        let database = Self { path: path.to_path_buf(), connection };
        database.check()?;
        Ok(database)
    }

    fn failure(&self, error: &rusqlite::Error) -> SensorError {
        SensorError::new(&self.path, in_words(error))
    }

    /// Makes the tables in a file without any; whoever else does so at the same time waits.
    fn create(&mut self) -> Result<(), SensorError> {
        let connection = &mut self.connection;
        let mut make = || -> rusqlite::Result<()> {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let objects: i64 = transaction.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
            let application: i32 = transaction.pragma_query_value(None, "application_id", |row| row.get(0))?;
            if objects == 0 && application == 0 {
                TABLES.iter().try_for_each(|(_, sql)| transaction.execute(sql, []).map(drop))?;
                transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
                transaction.pragma_update(None, "user_version", SCHEMA_VERSION)?;
            }
            transaction.commit()
        };
        make().map_err(|error| SensorError::new(&self.path, in_words(&error)))
    }

    /// Whether the file is what it should be.
    fn check(&self) -> Result<(), SensorError> {
        let number = |pragma: &str| -> Result<i32, SensorError> {
            let value = self.connection.pragma_query_value(None, pragma, |row| row.get(0));
            value.map_err(|error| self.failure(&error))
        };
        if number("application_id")? != APPLICATION_ID {
            return Err(SensorError::new(&self.path, OTHER_PROGRAM));
        }
        let version = number("user_version")?;
        if version != SCHEMA_VERSION {
            let reason = format!(
                "its tables are of version {version}, but this isobar knows version {SCHEMA_VERSION}: export it with the \
                 isobar that wrote it, and import the table"
            );
            return Err(SensorError::new(&self.path, reason));
        }
        let read = || -> rusqlite::Result<Vec<(String, String)>> {
            let mut statement = self.connection.prepare(
                "SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL AND name NOT LIKE 'sqlite_stat%' ORDER BY name",
            )?;
            statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
        };
        let found = read().map_err(|error| self.failure(&error))?;
        let mut expected: Vec<(String, String)> =
            TABLES.iter().map(|(name, sql)| (name.to_string(), sql.to_string())).collect();
        expected.sort();
        if found != expected {
            return Err(SensorError::new(&self.path, "its tables are not those of a database of sensors"));
        }
        let verdict: rusqlite::Result<String> =
            self.connection.query_row("PRAGMA quick_check(1)", [], |row| row.get(0));
        match verdict.map_err(|error| self.failure(&error))?.as_str() {
            "ok" => Ok(()),
            fault => Err(SensorError::new(&self.path, format!("it is damaged: {}", clean(fault)))),
        }
    }

    /// All records.
    ///
    /// # Errors
    /// If it cannot be read, or if somebody has put something into it that is no record or contradicts another.
    pub fn records(&mut self) -> Result<Records, SensorError> {
        let path = self.path.clone();
        let transaction = self.connection.transaction().map_err(|error| SensorError::new(&path, in_words(&error)))?;
        read(&path, &transaction)
    }

    /// Lets `change` change the records, all in one transaction; how many records are new or changed.
    ///
    /// # Errors
    /// Those of `change`, after which nothing has changed, and of the file.
    pub fn update(
        &mut self,
        change: impl FnOnce(&mut Records) -> Result<(), SensorError>,
    ) -> Result<usize, SensorError> {
        let path = self.path.clone();
        let failure = |error: rusqlite::Error| SensorError::new(&path, in_words(&error));
        let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate).map_err(failure)?;
        let before = read(&path, &transaction)?;
        let mut after = before.clone();
        change(&mut after)?;
        let changed = write(&transaction, &before, &after).map_err(failure)?;
        transaction.commit().map_err(failure)?;
        Ok(changed)
    }
}

/// The path of the file from the root, without links: SQLite takes names such as `:memory:` and `file:…` for something else.
fn real_path(path: &Path) -> Result<PathBuf, SensorError> {
    let failure = |reason: &dyn std::fmt::Display| SensorError::new(path, reason);
    match path.canonicalize() {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            if fs::symlink_metadata(path).is_ok() {
                return Err(failure(&"it is a link to a file that is not there"));
            }
            let name = path.file_name().ok_or_else(|| failure(&"the path does not end in a file's name"))?;
            let directory = parent_of(path);
            let cannot = |error| failure(&format!("its directory {}: {error}", shown_path(directory)));
            Ok(directory.canonicalize().map_err(cannot)?.join(name))
        }
        real => real.map_err(|error| failure(&error)),
    }
}

/// Refuses the file of another program before SQLite opens it: it might change it, as far as that program left it unfinished.
fn check_program(path: &Path, real: &Path, missing: Missing) -> Result<(), SensorError> {
    let mut head = Vec::new();
    let file = safe_file::open(real).map_err(|error| SensorError::new(path, error))?;
    file.take(HEAD_LENGTH).read_to_end(&mut head).map_err(|error| SensorError::new(path, error))?;
    let Some(id) = head.strip_prefix(MAGIC).and_then(|head| head.get(ID_AT..)?.first_chunk::<4>()) else {
        return Ok(());
    };
    match i32::from_be_bytes(*id) {
        APPLICATION_ID => Ok(()),
        // An empty one may be about to become a database of sensors.
        0 if missing == Missing::Create => Ok(()),
        _ => Err(SensorError::new(path, OTHER_PROGRAM)),
    }
}

/// Writes what is different; removes what is gone.
fn write(transaction: &Transaction<'_>, before: &Records, after: &Records) -> rusqlite::Result<usize> {
    let mut of_calibration =
        transaction.prepare("DELETE FROM calibration WHERE time = ?1 AND origin = ?2 AND sensor = ?3")?;
    let mut of_covariance =
        transaction.prepare("DELETE FROM covariance WHERE time = ?1 AND origin = ?2 AND sensor = ?3 AND other = ?4")?;
    for record in before.iter().filter(|record| after.get(&record.key()).is_none()) {
        match record {
            Record::Calibration { sensor, time, origin, .. } => {
                of_calibration.execute(params![time.seconds(), origin, sensor])?
            }
            Record::Covariance { sensor, other, time, origin, .. } => {
                of_covariance.execute(params![time.seconds(), origin, sensor, other])?
            }
            // Nothing else is ever taken out.
            _ => 0,
        };
    }
    let mut sensors = transaction.prepare(
        "INSERT INTO sensor VALUES (?1, ?2, ?3, ?4, ?5) ON CONFLICT DO UPDATE SET x_m = ?3, y_m = ?4, note = ?5",
    )?;
    let mut calibrations = transaction.prepare("INSERT OR REPLACE INTO calibration VALUES (?1, ?2, ?3, ?4, ?5)")?;
    let mut covariances = transaction.prepare("INSERT OR REPLACE INTO covariance VALUES (?1, ?2, ?3, ?4, ?5)")?;
    let mut test_points = transaction.prepare("INSERT INTO test_point VALUES (?1, ?2, ?3, ?4, ?5)")?;
    let mut recalibrations = transaction.prepare("INSERT INTO recalibration VALUES (?1, ?2, ?3, ?4, ?5)")?;
    let mut changed = 0;
    for record in after.iter().filter(|record| before.get(&record.key()) != Some(record)) {
        changed += 1;
        match record {
            Record::Sensor { name, unit, place, note } => {
                let (x_m, y_m) = place.unzip();
                sensors.execute(params![name, unit, x_m, y_m, note])?
            }
            Record::Calibration { sensor, time, origin, value, sigma } => {
                calibrations.execute(params![time.seconds(), origin, sensor, value, sigma])?
            }
            Record::Covariance { sensor, other, time, origin, covariance } => {
                covariances.execute(params![time.seconds(), origin, sensor, other, covariance])?
            }
            Record::TestPoint { sensor, time, reading, reference, sigma } => {
                test_points.execute(params![sensor, time.seconds(), reading, reference, sigma])?
            }
            Record::Recalibration { sensor, time, step, sigma, note } => {
                recalibrations.execute(params![sensor, time.seconds(), step, sigma, note])?
            }
        };
    }
    Ok(changed)
}

/// Reads all records: they go the same way as those of a table.
fn read(path: &Path, transaction: &Transaction<'_>) -> Result<Records, SensorError> {
    let mut records = Records::default();
    let time = |row: &Row<'_>, column: usize| row.get(column).map(Time::from_seconds);
    let mut table = |sql: &str, record: &dyn Fn(&Row<'_>) -> rusqlite::Result<Record>| -> Result<(), SensorError> {
        let failure = |error: rusqlite::Error| SensorError::new(path, in_words(&error));
        let mut statement = transaction.prepare(sql).map_err(failure)?;
        for record in statement.query_map([], record).map_err(failure)? {
            records.add(record.map_err(failure)?).map_err(|reason| SensorError::new(path, reason))?;
        }
        Ok(())
    };
    table("SELECT name, unit, x_m, y_m, note FROM sensor", &|row| {
        let (x_m, y_m): (Option<f64>, Option<f64>) = (row.get(2)?, row.get(3)?);
        Ok(Record::Sensor { name: row.get(0)?, unit: row.get(1)?, place: x_m.zip(y_m), note: row.get(4)? })
    })?;
    table("SELECT time, origin, sensor, value, sigma FROM calibration", &|row| {
        Ok(Record::Calibration {
            time: time(row, 0)?,
            origin: row.get(1)?,
            sensor: row.get(2)?,
            value: row.get(3)?,
            sigma: row.get(4)?,
        })
    })?;
    table("SELECT time, origin, sensor, other, value FROM covariance", &|row| {
        Ok(Record::Covariance {
            time: time(row, 0)?,
            origin: row.get(1)?,
            sensor: row.get(2)?,
            other: row.get(3)?,
            covariance: row.get(4)?,
        })
    })?;
    table("SELECT sensor, time, reading, reference, sigma FROM test_point", &|row| {
        Ok(Record::TestPoint {
            sensor: row.get(0)?,
            time: time(row, 1)?,
            reading: row.get(2)?,
            reference: row.get(3)?,
            sigma: row.get(4)?,
        })
    })?;
    table("SELECT sensor, time, step, sigma, note FROM recalibration", &|row| {
        Ok(Record::Recalibration {
            sensor: row.get(0)?,
            time: time(row, 1)?,
            step: row.get(2)?,
            sigma: row.get(3)?,
            note: row.get(4)?,
        })
    })?;
    Ok(records)
}

/// What SQLite says, as somebody who has not read its manual would say it.
fn in_words(error: &rusqlite::Error) -> String {
    use rusqlite::ErrorCode;
    match error.sqlite_error_code() {
        Some(ErrorCode::NotADatabase) => "it is not an SQLite database".into(),
        Some(ErrorCode::DatabaseCorrupt) => "it is damaged".into(),
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            format!("another process has kept it for {} seconds", PATIENCE.as_secs())
        }
        Some(ErrorCode::ReadOnly) => "it cannot be written".into(),
        Some(ErrorCode::DiskFull) => "the disk is full".into(),
        _ => clean(&error.to_string()),
    }
}
