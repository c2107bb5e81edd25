//! Warnings: a value beyond a threshold at a place or in an area, and how probable a forecast makes it.
//!
//! A forecast with mean m and standard deviation σ gives the value at a grid point the probability
//!
//! ```text
//! P = Φ((m − threshold)/σ)     to be above,        Φ((threshold − m)/σ)     to be below
//! ```
//!
//! as a normal distribution, which is what a Kalman filter claims. Ensembles are taken the same way, by the mean and the
//! standard deviation of their members, and not by the share of the members beyond the threshold: a share of 30 members cannot be
//! a probability between 0 and 1/30, and by one rule the forecasts of all methods can be compared.
//! A method that claims no standard deviation says 0 or 1.
//!
//! A place is the grid point of the variable that is nearest to it. In an area the event may occur at any grid point, and its
//! probability is taken as the largest of a single one,
//!
//! ```text
//! max_i P_i ≤ P(any i) ≤ Σ_i P_i
//! ```
//!
//! a lower bound, since forecasts have only standard deviations and no correlations. It is the probability itself if only one
//! grid point matters, or if all errors are fully correlated.

use crate::plot::with_unit;
use crate::scores::diagnostics::probability_below;
use isobar_assim::Estimate;
use isobar_model::{Layout, State, Variable};
use isobar_obs::{ObservationWindow, Report, Station};
use serde::{Deserialize, Serialize};

/// A warning, as a scenario describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThresholdWarning {
    /// Its name.
    pub name: String,
    /// Number of the variable in the state's layout.
    pub variable: usize,
    /// On which side of the threshold the event lies.
    pub side: Side,
    /// The threshold, in the variable's unit.
    pub threshold: f64,
    /// Where.
    pub at: Area,
    /// The probability from which on the warning is issued.
    pub issued_from: f64,
}

/// A side of a threshold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// Greater than it.
    Above,
    /// Less than it.
    Below,
}

/// Where an event is looked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Area {
    /// In the whole domain.
    Anywhere,
    /// At a station, `network/name`.
    Station(String),
    /// At a place \[m\].
    Place {
        /// x.
        x_m: f64,
        /// y.
        y_m: f64,
    },
    /// In a rectangle \[m\], its edges included.
    Box {
        /// From west to east.
        x_m: [f64; 2],
        /// From south to north.
        y_m: [f64; 2],
    },
}

/// A warning with its grid points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlacedWarning {
    /// The warning.
    pub warning: ThresholdWarning,
    /// Indices of their values in a state, in increasing order; at least one.
    pub points: Vec<usize>,
}

impl Side {
    /// How far a value is beyond the threshold: positive if it is.
    pub fn beyond(self, value: f64, threshold: f64) -> f64 {
        match self {
            Side::Above => value - threshold,
            Side::Below => threshold - value,
        }
    }

    /// `above` or `below`.
    pub fn word(self) -> &'static str {
        match self {
            Side::Above => "above",
            Side::Below => "below",
        }
    }
}

impl Area {
    /// In words, after the threshold.
    pub fn describe(&self) -> String {
        let km = |m: f64| m / 1e3;
        match self {
            Area::Anywhere => "anywhere".into(),
            Area::Station(name) => format!("at {name}"),
            Area::Place { x_m, y_m } => format!("at x = {} km, y = {} km", km(*x_m), km(*y_m)),
            Area::Box { x_m: [west, east], y_m: [south, north] } => {
                format!("in x = {} to {} km, y = {} to {} km", km(*west), km(*east), km(*south), km(*north))
            }
        }
    }

    /// The grid points of a variable of this number in it, as indices of values of a state, in increasing order; at least one.
    ///
    /// # Errors
    /// In words: an unknown station, or an area without a grid point.
    pub fn points(&self, variable: usize, layout: &Layout, stations: &[Station]) -> Result<Vec<usize>, String> {
        let grid = &layout.grid;
        let Variable { name: of_variable, location, .. } = &layout.variables[variable];
        let nearest = |x_m: f64, y_m: f64| vec![grid.nearest(*location, x_m, y_m)];
        let cells = match self {
            Area::Anywhere => (0..grid.cells()).collect(),
            Area::Place { x_m, y_m } => nearest(*x_m, *y_m),
            Area::Station(name) => {
                let is_it = |it: &&Station| {
                    let own = name.strip_prefix(&*it.network).and_then(|rest| rest.strip_prefix('/'));
                    own.is_some_and(|own| *own == *it.name || *own == *it.long_name)
                };
                let station = stations.iter().find(is_it).ok_or_else(|| unknown_station(name, stations))?;
                nearest(station.x_m, station.y_m)
            }
            Area::Box { x_m: [west, east], y_m: [south, north] } => {
                let is_inside = |cell: &usize| {
                    let x_m = grid.x_m(*location, cell % grid.nx);
                    let y_m = grid.y_m(*location, cell / grid.nx);
                    (*west..=*east).contains(&x_m) && (*south..=*north).contains(&y_m)
                };
                (0..grid.cells()).filter(is_inside).collect::<Vec<_>>()
            }
        };
        if cells.is_empty() {
            let (dx_km, dy_km) = (grid.dx_m / 1e3, grid.dy_m / 1e3);
            return Err(format!("the box holds no grid point of {of_variable}: cells are {dx_km} × {dy_km} km"));
        }
        Ok(cells.into_iter().map(|cell| variable * grid.cells() + cell).collect())
    }
}

impl ThresholdWarning {
    /// In words: `h above 1010 m anywhere`.
    pub fn describe(&self, layout: &Layout) -> String {
        let variable = &layout.variables[self.variable];
        let threshold = with_unit(self.threshold, variable.unit);
        format!("{} {} {threshold} {}", variable.name, self.side.word(), self.at.describe())
    }

    /// Finds the grid points of the warning.
    ///
    /// # Errors
    /// As [`Area::points`].
    pub fn place(&self, layout: &Layout, stations: &[Station]) -> Result<PlacedWarning, String> {
        let points = self.at.points(self.variable, layout, stations)?;
        Ok(PlacedWarning { warning: self.clone(), points })
    }

    /// The probability of a value with this mean and standard deviation to be beyond the threshold.
    pub fn probability(&self, mean: f64, sigma: Option<f64>) -> f64 {
        let beyond = self.side.beyond(mean, self.threshold);
        match sigma {
            Some(sigma) if sigma > 0.0 => probability_below(beyond / sigma),
            _ => f64::from(u8::from(beyond > 0.0)),
        }
    }
}

fn unknown_station(name: &str, stations: &[Station]) -> String {
    let names: Vec<String> = stations.iter().map(|it| format!("{}/{}", it.network, it.name)).collect();
    let near = crate::text::nearest(name, names.iter().map(String::as_str));
    let hint = match (near, names.first()) {
        (Some(near), _) => format!("; did you mean \"{near}\"?"),
        (None, Some(first)) => format!("; there are {} stations, such as \"{first}\"", names.len()),
        (None, None) => "; no network has stations".into(),
    };
    format!("there is no station \"{}\" in the domain{hint}", crate::text::clean(name))
}

impl PlacedWarning {
    /// The probability of the event by a forecast: that of the grid point where it is largest.
    pub fn probability(&self, forecast: &Estimate) -> f64 {
        self.points.iter().map(|&point| self.at(forecast, point)).fold(0.0, f64::max)
    }

    /// The probability of the event at each grid point of the variable, `[y, x]`, also outside of the area.
    pub fn field(&self, forecast: &Estimate) -> Vec<f64> {
        let cells = forecast.state.layout().grid.cells();
        (self.warning.variable * cells..(self.warning.variable + 1) * cells)
            .map(|point| self.at(forecast, point))
            .collect()
    }

    fn at(&self, forecast: &Estimate, point: usize) -> f64 {
        let sigma = forecast.state_spread.as_ref().map(|spread| spread[point]);
        self.warning.probability(forecast.state.values()[point], sigma)
    }

    /// Whether the event has occurred at one of the grid points.
    pub fn occurred(&self, truth: &State) -> bool {
        let is_beyond = |&point: &usize| self.is_beyond(truth.values()[point]);
        self.points.iter().any(is_beyond)
    }

    /// Whether an observation whose nearest grid point is one of these is beyond the threshold, as reported, with its errors;
    /// `None` if there is no observation of the variable there. Either the passive observations count or those that are used.
    pub fn observed(&self, observed: &ObservationWindow, passive: bool, layout: &Layout) -> Option<bool> {
        let operator = if passive { &observed.aside.operator } else { &observed.operator };
        // Those of the valid time, not within the window before it.
        let used = observed.reports.iter().zip(&observed.values).enumerate();
        let used = used.filter(|(row, _)| operator.is_at_end(*row)).map(|(_, (report, &value))| (report, value));
        let others = observed.aside.passive().filter(|(row, _)| operator.is_at_end(*row));
        let others = others.map(|(_, it)| (&it.report, it.value));
        let all: Box<dyn Iterator<Item = (&Report, f64)>> = if passive { Box::new(others) } else { Box::new(used) };
        let cells = layout.grid.cells();
        let is_of_it = |report: &Report| {
            let location = layout.variables[report.variable].location;
            let point = report.variable * cells + layout.grid.nearest(location, report.x_m, report.y_m);
            self.points.binary_search(&point).is_ok()
        };
        let mut occurred = None;
        for (_, value) in all.filter(|(report, value)| value.is_finite() && is_of_it(report)) {
            if self.is_beyond(value) {
                return Some(true);
            }
            occurred = Some(false);
        }
        occurred
    }

    fn is_beyond(&self, value: f64) -> bool {
        self.warning.side.beyond(value, self.warning.threshold) > 0.0
    }

    /// Whether a forecast of this probability issues the warning.
    pub fn issues(&self, probability: f64) -> bool {
        probability >= self.warning.issued_from
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::{Boundary, Grid, Location};
    use std::sync::Arc;

    fn layout() -> Arc<Layout> {
        let variable = |name, location| Variable { name, long_name: name, standard_name: None, unit: "m", location };
        let grid = Grid { nx: 4, ny: 3, dx_m: 1e3, dy_m: 2e3, boundary: Boundary::Channel };
        Arc::new(Layout { grid, variables: vec![variable("h", Location::Center), variable("u", Location::XFace)] })
    }

    fn warning(side: Side, at: Area) -> ThresholdWarning {
        ThresholdWarning { name: "w".into(), variable: 1, side, threshold: 5.0, at, issued_from: 0.5 }
    }

    #[test]
    fn an_area_is_the_grid_points_of_the_variable_in_it() {
        let layout = layout();
        let placed = |at: Area| warning(Side::Above, at).place(&layout, &[]);
        assert_eq!(placed(Area::Anywhere).unwrap().points, (12..24).collect::<Vec<_>>());
        // u is on western faces: x = 0, 1, 2, 3 km, and y = 1, 3, 5 km.
        assert_eq!(placed(Area::Place { x_m: 1400.0, y_m: 2100.0 }).unwrap().points, [12 + 4 + 1]);
        let found = placed(Area::Box { x_m: [1000.0, 2000.0], y_m: [900.0, 3000.0] }).unwrap();
        assert_eq!(found.points, [13, 14, 17, 18]);
        let error = placed(Area::Box { x_m: [1100.0, 1900.0], y_m: [0.0, 6000.0] }).unwrap_err();
        assert_eq!(error, "the box holds no grid point of u: cells are 1 × 2 km");
        let error = placed(Area::Station("sondes/a".into())).unwrap_err();
        assert_eq!(error, "there is no station \"sondes/a\" in the domain; no network has stations");
    }

    #[test]
    fn the_probability_of_an_area_is_the_largest_of_its_points() {
        let layout = layout();
        let mut values = vec![0.0; 24];
        let mut spread = vec![1.0; 24];
        (values[13], spread[13], values[14], spread[14]) = (4.0, 2.0, 4.5, 0.1);
        let state = State::from_values(&layout, values);
        let estimate =
            Estimate { state, calibration: Vec::new(), state_spread: Some(spread), calibration_spread: None };
        let placed = warning(Side::Above, Area::Anywhere).place(&layout, &[]).unwrap();
        // Φ(−½) at the first, Φ(−5) at the second, whose mean is nearer.
        assert!((placed.probability(&estimate) - 0.308_537_538_7).abs() < 1e-9);
        assert!((placed.field(&estimate)[2] - 2.866_515_7e-7).abs() < 1e-13);
        assert!(!placed.occurred(&estimate.state));
        let sure = Estimate { state_spread: None, ..estimate };
        assert_eq!(placed.probability(&sure), 0.0);
        let below = warning(Side::Below, Area::Anywhere).place(&layout, &[]).unwrap();
        assert_eq!((below.probability(&sure), below.occurred(&sure.state)), (1.0, true));
    }
}
