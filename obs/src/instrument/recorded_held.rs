//! A recorded observation as it is held until its cycle: without the lists for its row of X and its biases, which would take most of
//! the memory for millions of rows.

use crate::observation::{Observation, Reading};
use crate::report::Report;
use crate::state_operator::StateOperator;
use isobar_model::{Duration, Layout, Time};
use std::sync::Arc;

/// A recorded observation.
pub(super) struct Held {
    /// The cycle with which it arrives; 0: before the first.
    pub cycle: usize,
    /// The station, or the place. Observations of one platform share one name.
    pub platform: Arc<str>,
    /// Number of the observed variable in the layout.
    pub variable: u32,
    /// The number of its report within its network and cycle.
    pub report_number: u32,
    /// x on the plane \[m\].
    pub x_m: f64,
    /// y on the plane \[m\].
    pub y_m: f64,
    /// Standard deviation of the random error, in the variable's unit.
    pub sigma: f64,
    /// The value, in the variable's unit.
    pub value: f64,
    /// When it is valid.
    pub time: Time,
    /// How long before the end of the window it is compared with the state.
    pub lag: Duration,
    /// Whether it is valid too far from the end of the window.
    pub is_late: bool,
    /// Whether the number is missing to which a bias is proportional.
    pub lacks_predictor: bool,
    /// The number of weights of its row of X; 0 outside of the domain.
    weights: u8,
    seen: Seen,
    /// Its row of G.
    pub biases: Biases,
}

/// What it sees of the state.
pub(super) enum Seen {
    /// The variable at its place.
    Interpolated,
    /// The value of this index in the state.
    Point(usize),
    /// These two variables at its place, each with a weight.
    Turned(Box<[(usize, f64); 2]>),
}

/// A row of G: (number of the parameter, factor). Most have one entry at most.
#[derive(Default)]
pub(super) enum Biases {
    /// No entry.
    #[default]
    None,
    /// One entry.
    One(usize, f64),
    /// Several.
    Several(Vec<(usize, f64)>),
}

impl Biases {
    /// Appends an entry.
    pub fn push(&mut self, column: usize, factor: f64) {
        *self = match std::mem::take(self) {
            Self::None => Self::One(column, factor),
            Self::One(first, its_factor) => Self::Several(vec![(first, its_factor), (column, factor)]),
            Self::Several(mut entries) => {
                entries.push((column, factor));
                Self::Several(entries)
            }
        };
    }

    /// All entries, in their order.
    pub fn entries(&self) -> Vec<(usize, f64)> {
        match self {
            Self::None => Vec::new(),
            Self::One(column, factor) => vec![(*column, *factor)],
            Self::Several(entries) => entries.clone(),
        }
    }
}

impl FromIterator<(usize, f64)> for Biases {
    fn from_iter<I: IntoIterator<Item = (usize, f64)>>(entries: I) -> Self {
        let mut biases = Self::None;
        entries.into_iter().for_each(|(column, factor)| biases.push(column, factor));
        biases
    }
}

impl Held {
    /// An observation of a variable at a place, in time and without biases, that sees this of a state of the layout.
    pub fn new(
        (cycle, time, lag): (usize, Time, Duration),
        platform: Arc<str>,
        variable: usize,
        (x_m, y_m): (f64, f64),
        (value, sigma): (f64, f64),
        seen: Seen,
        layout: &Layout,
    ) -> Self {
        let mut held = Self {
            cycle,
            platform,
            variable: variable as u32,
            report_number: 0,
            x_m,
            y_m,
            sigma,
            value,
            time,
            lag,
            is_late: false,
            lacks_predictor: false,
            weights: 0,
            seen: Seen::Interpolated,
            biases: Biases::None,
        };
        held.see(seen, layout);
        held
    }

    /// Sees something else of a state of this layout.
    pub fn see(&mut self, seen: Seen, layout: &Layout) {
        self.seen = seen;
        self.weights = self.row(layout).len() as u8;
    }

    /// Whether it lies in the domain.
    pub fn is_inside(&self) -> bool {
        self.weights > 0
    }

    /// Whether it is valid at the end of a cycle, and lies in the domain.
    pub fn is_in_time_and_inside(&self) -> bool {
        self.cycle > 0 && !self.is_late && self.is_inside()
    }

    /// The number of weights of its row of X.
    pub fn weights(&self) -> usize {
        usize::from(self.weights)
    }

    /// Its row of X: (index in a state of this layout, weight); empty outside of the domain.
    fn row(&self, layout: &Layout) -> Vec<(usize, f64)> {
        let at_place = |variable: usize| row(layout, variable, self.x_m, self.y_m);
        match &self.seen {
            Seen::Interpolated => at_place(self.variable as usize),
            Seen::Point(index) => vec![(*index, 1.0)],
            Seen::Turned(components) => {
                let of_each = components.iter().flat_map(|&(variable, weight)| {
                    at_place(variable).into_iter().map(move |(index, entry)| (index, weight * entry))
                });
                of_each.filter(|entry| entry.1 != 0.0).collect()
            }
        }
    }

    /// The observation, as an instrument of this network makes it.
    pub fn observation(&self, network: &Arc<str>, layout: &Layout) -> Observation {
        let Self { platform, variable, x_m, y_m, sigma, value, time, is_late, lacks_predictor, .. } = self;
        let report = Report {
            network: Arc::clone(network),
            platform: Arc::clone(platform),
            variable: *variable as usize,
            x_m: *x_m,
            y_m: *y_m,
            scan: None,
        };
        let (is_late, lacks_predictor) = (*is_late, *lacks_predictor);
        Observation {
            reading: Reading::Recorded { value: *value, time: *time, is_late, lacks_predictor },
            calibration_row: self.biases.entries(),
            report_number: self.report_number as usize,
            lag: self.lag,
            ..Observation::new(report, *sigma, StateOperator::Linear(self.row(layout)))
        }
    }
}

/// The row of X of a variable at a point of the plane; empty outside of the domain.
fn row(layout: &Layout, variable: usize, x_m: f64, y_m: f64) -> Vec<(usize, f64)> {
    layout.interpolation(variable, x_m, y_m).unwrap_or_default()
}
