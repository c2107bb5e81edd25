//! Wind-finding from files: a table of trackers and one of their readings of a balloon make its positions, the wind, and the
//! trackers' offsets, which a database of sensors keeps from flight to flight.
//!
//! | module | what it does |
//! |---|---|
//! | [`tables`] | reads the two tables |
//! | [`page`] | the sounding as a page with figures |
//!
//! The mathematics is in [`isobar_assim::wind_finding`].

mod error;
pub mod page;
pub mod tables;

pub use error::SoundingError;

use crate::calendar::utc;
use crate::sensors::database::{Database, Missing};
use crate::sensors::knowledge::warm_start;
use crate::sensors::{SensorError, write_back};
use crate::text::shown_path;
use faer::Mat;
use isobar_assim::block_angular::Prior;
use isobar_assim::wind_finding::{Flight, Motion, find_winds, offset_names};
use isobar_model::{Duration, Time};
use isobar_obs::{Calibration, Drift, Parameter, Placement};
use std::path::{Path, PathBuf};
use tables::{Offset, Readings, TrackerTable};

/// What a sounding is computed from.
#[derive(Clone, Debug)]
pub struct Request {
    /// The table of readings.
    pub flight: PathBuf,
    /// The table of trackers.
    pub trackers: PathBuf,
    /// A database in which offsets may be known.
    pub sensors: Option<PathBuf>,
    /// Whether the offsets will be written into the database, so that it need not be there yet.
    pub writes_back: bool,
    /// How the balloon is assumed to move.
    pub motion: Option<Motion>,
}

/// A sounding: a flight, and what it says of its trackers.
#[derive(Clone, Debug)]
pub struct Sounding {
    /// Name of the flight: that of its table.
    pub name: String,
    /// The readings.
    pub readings: Readings,
    /// Number of trackers.
    pub trackers: usize,
    /// The offsets, with the standard deviations that were assumed of them before the flight.
    pub calibration: Calibration,
    /// Their means before the flight; `None` if nothing was assumed.
    pub prior_mean: Option<Vec<f64>>,
    /// Number of offsets of which the database knew something.
    pub known: usize,
    /// Positions, winds, offsets: in m and rad.
    pub flight: Flight,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Sounding {
    /// Finds the winds.
    ///
    /// # Errors
    /// [`SoundingError`].
    pub fn find(request: &Request) -> Result<Self, SoundingError> {
        let table = TrackerTable::read(&request.trackers)?;
        let readings = Readings::read(&request.flight, &table)?;
        let (begin, end) = (readings.begin, readings.end());
        let calibration = Calibration {
            parameters: offset_names(&table.trackers)
                .into_iter()
                .zip(&table.offsets)
                .map(|(name, offset)| Parameter {
                    name,
                    unit: offset.unit.into(),
                    placement: Placement::Shared,
                    sigma_prior: offset.sigma_prior.unwrap_or(0.0),
                    drift: Drift::RandomWalk { sigma_per_sqrt_day: offset.drift_per_sqrt_day },
                })
                .collect(),
            ..Calibration::default()
        };
        let has_priors = table.has_priors()?;
        let (mut warnings, mut known, mut calibration, mut prior_mean) = (Vec::new(), 0, calibration, None);
        if let Some(path) = &request.sensors {
            if !has_priors {
                return Err(table.without_priors());
            }
            let missing = if request.writes_back { Missing::Create } else { Missing::Refuse };
            let records = Database::records_at(path, missing)?;
            let start = warm_start(&records, &calibration, begin, end);
            let start = start.map_err(|reason| SensorError::new(path, reason))?;
            if let Some(it) = start.knowledge.recalibrations.first() {
                let reason = format!(
                    "{} is recalibrated at {}, within the flight: give the flight as two",
                    calibration.parameters[it.parameter].name,
                    utc(it.time)
                );
                return Err(SensorError::new(path, reason).into());
            }
            (calibration, known, warnings) = (start.calibration, start.known, start.warnings);
            prior_mean = Some(start.knowledge.mean);
        } else if has_priors {
            prior_mean = Some(vec![0.0; calibration.len()]);
        }
        let scales: Vec<f64> = table.offsets.iter().map(Offset::scale).collect();
        let prior = prior_mean.as_ref().map(|mean| Prior {
            mean: mean.iter().zip(&scales).map(|(value, scale)| value * scale).collect(),
            covariance: Mat::from_fn(mean.len(), mean.len(), |i, j| {
                calibration.prior_covariance(i, j) * scales[i] * scales[j]
            }),
        });
        let found = find_winds(&table.trackers, &readings.fixes, prior.as_ref(), request.motion);
        let flight = found
            .map_err(|error| SoundingError::File { file: shown_path(&request.flight), reason: error.to_string() })?;
        let name = request.flight.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        Ok(Self { name, readings, trackers: table.trackers.len(), calibration, prior_mean, known, flight, warnings })
    }

    /// The factor from the unit of an offset to m or rad.
    fn scale(&self, offset: usize) -> f64 {
        tables::scale(&self.calibration.parameters[offset].unit)
    }

    /// An offset in its unit.
    pub fn offset(&self, offset: usize) -> f64 {
        self.flight.offsets[offset] / self.scale(offset)
    }

    /// The standard deviation of the error of an offset, in its unit.
    pub fn sigma_offset(&self, offset: usize) -> f64 {
        self.flight.offsets_covariance[(offset, offset)].sqrt() / self.scale(offset)
    }

    /// The time of a fix.
    pub fn time(&self, fix: usize) -> Time {
        self.readings.begin + Duration::from_seconds(self.readings.fixes[fix].seconds as i64)
    }

    /// Takes the offsets of the flight into a database, with their covariance, as of the end of the flight; the number of
    /// records that are new. Those of an earlier computation of the same flight are replaced.
    ///
    /// # Errors
    /// As [`write_back::store`].
    pub fn store(&self, database: &Path) -> Result<usize, SensorError> {
        let p = self.calibration.len();
        let mean: Vec<f64> = (0..p).map(|offset| self.offset(offset)).collect();
        let covariance =
            Mat::from_fn(p, p, |i, j| self.flight.offsets_covariance[(i, j)] / (self.scale(i) * self.scale(j)));
        let (time, origin) = (self.readings.end(), format!("winds {}", self.name));
        let records =
            write_back::calibration(&self.calibration.parameters, (time, &origin), &mean, covariance.as_ref());
        let records = records.map_err(|reason| SensorError::new(database, reason))?;
        write_back::store(records.iter().cloned(), database, |_, reason| SensorError::new(database, reason))
    }
}
