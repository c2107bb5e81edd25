//! Records of sensors, and which of them contradict each other.

use crate::text::{clean, is_unprintable};
use isobar_model::Time;
use std::collections::BTreeMap;

/// The longest name or note \[characters\].
pub const LONGEST_TEXT: usize = 200;

/// The most records of a database or a table.
pub const MOST_RECORDS: usize = 2_000_000;

/// Times of records: the years 1900 to 2199, as in scenarios \[s\].
const TIMES: std::ops::Range<i64> = -2_208_988_800..7_258_118_400;

/// Something that is known of a sensor. A sensor is named as its calibration parameter: `europe/h/Germany`.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// The sensor itself.
    Sensor {
        /// Its name.
        name: String,
        /// The unit of its bias.
        unit: String,
        /// Where it stands (x, y) \[m\], if anywhere.
        place: Option<(f64, f64)>,
        /// What else is to be said of it.
        note: String,
    },
    /// Its bias as it was found to be.
    Calibration {
        /// The sensor.
        sensor: String,
        /// When.
        time: Time,
        /// By whom: a laboratory, a run. All calibrations of one time and origin belong together.
        origin: String,
        /// The bias.
        value: f64,
        /// Standard deviation of its error.
        sigma: f64,
    },
    /// Covariance of the errors of two calibrations of one time and origin.
    Covariance {
        /// One sensor.
        sensor: String,
        /// The other.
        other: String,
        /// When.
        time: Time,
        /// By whom.
        origin: String,
        /// The covariance.
        covariance: f64,
    },
    /// What it showed where the truth was known.
    TestPoint {
        /// The sensor.
        sensor: String,
        /// When.
        time: Time,
        /// What it showed.
        reading: f64,
        /// What it should have shown.
        reference: f64,
        /// Standard deviation of the difference for a sensor without bias.
        sigma: f64,
    },
    /// A change of its bias that was announced.
    Recalibration {
        /// The sensor.
        sensor: String,
        /// From when on.
        time: Time,
        /// The change.
        step: f64,
        /// Standard deviation of the error of the change.
        sigma: f64,
        /// Why.
        note: String,
    },
}

/// What tells a record from others.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Key {
    /// A sensor.
    Sensor(String),
    /// A calibration: time \[s\], origin, sensor.
    Calibration(i64, String, String),
    /// A covariance: time \[s\], origin, the two sensors in ascending order.
    Covariance(i64, String, String, String),
    /// A test point: sensor, time \[s\], bits of reading and reference.
    TestPoint(String, i64, u64, u64),
    /// A recalibration: sensor, time \[s\].
    Recalibration(String, i64),
}

impl Record {
    /// What tells it from others.
    pub fn key(&self) -> Key {
        match self {
            Record::Sensor { name, .. } => Key::Sensor(name.clone()),
            Record::Calibration { sensor, time, origin, .. } => {
                Key::Calibration(time.seconds(), origin.clone(), sensor.clone())
            }
            Record::Covariance { sensor, other, time, origin, .. } => {
                let (first, second) = if sensor <= other { (sensor, other) } else { (other, sensor) };
                Key::Covariance(time.seconds(), origin.clone(), first.clone(), second.clone())
            }
            Record::TestPoint { sensor, time, reading, reference, .. } => {
                Key::TestPoint(sensor.clone(), time.seconds(), reading.to_bits(), reference.to_bits())
            }
            Record::Recalibration { sensor, time, .. } => Key::Recalibration(sensor.clone(), time.seconds()),
        }
    }

    /// The sensors of which it is, for all but a sensor itself.
    fn sensors(&self) -> Vec<&str> {
        match self {
            Record::Sensor { .. } => vec![],
            Record::Covariance { sensor, other, .. } => vec![sensor, other],
            Record::Calibration { sensor, .. }
            | Record::TestPoint { sensor, .. }
            | Record::Recalibration { sensor, .. } => vec![sensor],
        }
    }

    /// What is wrong with the record by itself.
    fn check(&self) -> Result<(), String> {
        let text = |what: &str, text: &str, may_be_empty: bool| {
            if text.is_empty() && !may_be_empty {
                Err(format!("`{what}` is empty"))
            } else if text.chars().count() > LONGEST_TEXT || text.chars().any(is_unprintable) {
                Err(format!("`{what}` must be at most {LONGEST_TEXT} printable characters"))
            } else if text.trim() != text {
                Err(format!("`{what}` begins or ends with a blank: \"{}\"", clean(text)))
            } else {
                Ok(())
            }
        };
        let require = |right: bool, fault: String| if right { Ok(()) } else { Err(fault) };
        let number = |what: &str, value: f64| {
            require(value.abs() <= 1e18, format!("`{what}` is {value:?}, but must be a number from -1e18 to 1e18"))
        };
        let positive = |what: &str, value: f64| {
            let fault = if value > 0.0 {
                format!("`{what}` is {value:?}, but must be a number from 1e-18 to 1e18")
            } else {
                format!("`{what}` is {value}, but must be a number greater than 0")
            };
            require((1e-18..=1e18).contains(&value), fault)
        };
        let time =
            |time: &Time| require(TIMES.contains(&time.seconds()), "`time` must be from 1900 to 2200".to_string());
        for sensor in self.sensors() {
            text("sensor", sensor, false)?;
        }
        match self {
            Record::Sensor { name, unit, place, note } => {
                text("sensor", name, false)?;
                text("unit", unit, false)?;
                place.map_or(Ok(()), |(x_m, y_m)| number("x_m", x_m).and_then(|()| number("y_m", y_m)))?;
                text("note", note, true)
            }
            Record::Calibration { time: when, origin, value, sigma, .. } => {
                time(when)?;
                text("origin", origin, false)?;
                number("value", *value)?;
                positive("sigma", *sigma)
            }
            Record::Covariance { sensor, other, time: when, origin, covariance } => {
                time(when)?;
                text("origin", origin, false)?;
                number("value", *covariance)?;
                let fault = "`other_sensor` is the sensor itself, whose variance its calibration has";
                require(sensor != other, fault.to_string())
            }
            Record::TestPoint { time: when, reading, reference, sigma, .. } => {
                time(when)?;
                number("value", *reading)?;
                number("reference", *reference)?;
                positive("sigma", *sigma)
            }
            Record::Recalibration { time: when, step, sigma, note, .. } => {
                time(when)?;
                number("value", *step)?;
                if *sigma != 0.0 {
                    positive("sigma", *sigma)?;
                }
                text("note", note, true)
            }
        }
    }
}

/// Records that do not contradict each other, in a fixed order: sensors, calibrations by time, covariances, test points,
/// recalibrations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Records {
    all: BTreeMap<Key, Record>,
}

impl Records {
    /// All of them, in their order.
    pub fn iter(&self) -> impl Iterator<Item = &Record> {
        self.all.values()
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The record of this key.
    pub fn get(&self, key: &Key) -> Option<&Record> {
        self.all.get(key)
    }

    /// Takes a record in; whether it is new. One that is there to the letter is none; a sensor's place and note may change.
    ///
    /// # Errors
    /// In words: a record that is wrong by itself, that contradicts another, or of a sensor that is not there.
    pub fn add(&mut self, mut record: Record) -> Result<bool, String> {
        record.check()?;
        if let Record::Covariance { sensor, other, .. } = &mut record
            && sensor > other
        {
            std::mem::swap(sensor, other);
        }
        for sensor in record.sensors() {
            if !self.all.contains_key(&Key::Sensor(sensor.to_string())) {
                let name = clean(sensor);
                return Err(format!("there is no sensor \"{name}\"; a record of kind `sensor` must come before"));
            }
        }
        if let Record::Covariance { sensor, other, time, origin, covariance } = &record {
            let sigma = |sensor: &str| match self.all.get(&Key::Calibration(
                time.seconds(),
                origin.clone(),
                sensor.to_string(),
            )) {
                Some(Record::Calibration { sigma, .. }) => Ok(*sigma),
                _ => Err(format!("\"{}\" has no calibration of this time and origin", clean(sensor))),
            };
            let most = sigma(sensor)? * sigma(other)?;
            if covariance.abs() > most {
                return Err(format!("a covariance of {covariance} is more than the standard deviations allow, {most}"));
            }
        }
        let key = record.key();
        match (self.all.get(&key), &record) {
            (Some(before), _) if *before == record => return Ok(false),
            (Some(Record::Sensor { unit, .. }), Record::Sensor { unit: other, name, .. }) if unit != other => {
                return Err(format!("the unit of \"{}\" is {}, not {}", clean(name), clean(unit), clean(other)));
            }
            (None, _) | (Some(_), Record::Sensor { .. }) => {}
            (Some(Record::Recalibration { step, sigma, .. }), Record::Recalibration { sensor, .. }) => {
                return Err(format!(
                    "contradicts another recalibration of \"{}\" at the same time, by {step} with sigma {sigma}",
                    clean(sensor)
                ));
            }
            (Some(_), _) => {
                return Err("contradicts another record of the same sensor, time and origin".into());
            }
        }
        if self.all.len() == MOST_RECORDS && !self.all.contains_key(&key) {
            return Err(format!("there are more than {MOST_RECORDS} records"));
        }
        self.all.insert(key, record);
        Ok(true)
    }

    /// Takes out all calibrations of a time and origin, with their covariances.
    pub fn remove_calibration(&mut self, time: Time, origin: &str) {
        self.all.retain(|key, _| match key {
            Key::Calibration(seconds, own, _) | Key::Covariance(seconds, own, ..) => {
                *seconds != time.seconds() || own != origin
            }
            _ => true,
        });
    }
}
