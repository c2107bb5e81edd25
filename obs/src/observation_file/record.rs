//! A line of a file of observations.

use isobar_model::Time;
use std::collections::HashMap;
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

/// The names of a column, each held once: millions of rows have those of few stations.
#[derive(Default)]
pub(super) struct Names {
    /// In order of appearance.
    held: Vec<Arc<str>>,
    numbers: HashMap<Arc<str>, usize>,
    /// The number of the last.
    last: usize,
}

impl Names {
    /// The one copy of a name.
    pub fn shared(&mut self, name: &str) -> Arc<str> {
        // Most rows have the name of the row before, or that which came after it when it was new: these need no search.
        let after = if self.last + 1 < self.held.len() { self.last + 1 } else { 0 };
        let likely =
            [self.last, after].into_iter().find(|&number| self.held.get(number).is_some_and(|it| **it == *name));
        self.last = likely.or_else(|| self.numbers.get(name).copied()).unwrap_or_else(|| {
            let held: Arc<str> = name.into();
            self.numbers.insert(Arc::clone(&held), self.held.len());
            self.held.push(held);
            self.held.len() - 1
        });
        Arc::clone(&self.held[self.last])
    }
}

/// What is remembered from row to row.
#[derive(Default)]
pub(super) struct Memory {
    pub variables: Names,
    pub ids: Names,
    pub groups: Names,
    pub reports: Names,
    /// The last time, as it is written, and what it is.
    pub time: Option<(String, Time)>,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_name_is_held_once_in_whatever_order_it_comes() {
        let mut names = Names::default();
        let all = ["a", "b", "c", "a", "b", "c", "c", "a", "c", "b", "d", "a", "b"];
        let shared: Vec<Arc<str>> = all.iter().map(|name| names.shared(name)).collect();
        assert_eq!(names.held.iter().map(|name| &**name).collect::<Vec<_>>(), ["a", "b", "c", "d"]);
        for (name, own) in all.iter().zip(&shared) {
            assert!(**own == **name && names.held.iter().any(|held| Arc::ptr_eq(held, own)), "{name}");
        }
    }
}
