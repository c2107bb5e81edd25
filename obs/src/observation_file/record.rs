//! A line of a file of observations.

use isobar_model::Time;
use std::collections::HashSet;
use std::sync::Arc;

/// The columns that biases and correlated errors need, and which rows are read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FurtherColumns {
    /// The column that says to which group a station belongs.
    pub group_by: Option<String>,
    /// The column that says to which report an observation belongs.
    pub report_by: Option<String>,
    /// The network whose rows are read, by the column `network`; `None`: all rows.
    pub network: Option<String>,
    /// Columns of numbers.
    pub predictors: Vec<String>,
}

/// One line or row of a file of observations.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationRecord {
    /// Number of its line, or of its row in a file that is no text, from 1.
    pub line: usize,
    /// When it is valid.
    pub valid: ValidTime,
    /// Where.
    pub place: ObservationPlace,
    /// The variable's name, if the file says it.
    pub variable: Option<Arc<str>>,
    /// The observed value; finite.
    pub value: f64,
    /// Standard deviation of its random error, above 0, if the file says it.
    pub sigma: Option<f64>,
    /// The station, if the file says it.
    pub id: Option<Arc<str>>,
    /// The station's group, if that is read.
    pub group: Option<Arc<str>>,
    /// Its report, if that is read.
    pub report: Option<Arc<str>>,
    /// The numbers of the [further columns](FurtherColumns::predictors); nothing where one is missing.
    pub predictors: Vec<Option<f64>>,
}

/// The names of a file, each held once: millions of rows have those of few stations.
#[derive(Default)]
pub(super) struct Names(HashSet<Arc<str>>);

impl Names {
    /// The one copy of a name.
    pub fn shared(&mut self, name: &str) -> Arc<str> {
        if let Some(held) = self.0.get(name) {
            return Arc::clone(held);
        }
        let held: Arc<str> = name.into();
        self.0.insert(Arc::clone(&held));
        held
    }
}

/// When an observation is valid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ValidTime {
    /// At the end of the cycle of this number, from 1.
    Cycle(usize),
    /// At this time.
    Time(Time),
}

/// Where an observation is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObservationPlace {
    /// On the plane.
    Plane {
        /// x \[m\].
        x_m: f64,
        /// y \[m\].
        y_m: f64,
    },
    /// On the Earth.
    Geographic {
        /// Degrees north.
        latitude_deg: f64,
        /// Degrees east.
        longitude_deg: f64,
    },
    /// At a point of the grid.
    GridPoint {
        /// From 1, from the west.
        column: usize,
        /// From 1, from the south.
        row: usize,
    },
}
