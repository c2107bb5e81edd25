//! Observations that could be made at the next analysis.

use super::error::AdviceError;
use super::request::Request;
use crate::event::RunInfo;
use crate::plot::with_unit;
use crate::text::clean;
use indexmap::IndexMap;
use isobar_assim::{Estimate, Unknown};
use isobar_obs::{ObservationWindow, Station};
use serde::Serialize;

/// The most sensors that are compared pair by pair.
const MOST_COMPARED: usize = 200;

/// The most places of a grid.
pub const MOST_PLACES: usize = 1_000_000;

/// Kinds of candidates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The next report of an existing platform, with its biases.
    Report,
    /// A radiosonde without bias at a station.
    RadiosondeAtStation,
    /// A radiosonde without bias at a place of the grid.
    RadiosondeAtPlace,
    /// A sensor against a reference.
    TestPoint,
    /// Two sensors against each other.
    Comparison,
}

impl Kind {
    /// All of them, in the order of tables.
    pub const ALL: [Kind; 5] =
        [Kind::Report, Kind::RadiosondeAtStation, Kind::RadiosondeAtPlace, Kind::TestPoint, Kind::Comparison];

    /// The title of its table.
    pub fn title(self) -> &'static str {
        match self {
            Kind::Report => "The next reports of existing platforms",
            Kind::RadiosondeAtStation => "A new radiosonde without bias at a station",
            Kind::RadiosondeAtPlace => "A new radiosonde without bias at a place",
            Kind::TestPoint => "A sensor against a reference",
            Kind::Comparison => "Two sensors against each other",
        }
    }
}

/// An observation that could be made, and how much it would reduce the variance of the functional.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// Its kind.
    pub kind: Kind,
    /// Its platform, place or sensors.
    pub name: String,
    /// x \[m\], if it is at a place.
    pub x_m: Option<f64>,
    /// y \[m\].
    pub y_m: Option<f64>,
    /// How much it reduces the variance of the functional, in the square of its unit.
    pub reduction: f64,
    /// That as a share of the variance.
    pub share: f64,
    /// The standard deviation of the functional with it.
    pub sigma: f64,
}

/// An observation that could be made.
pub(super) struct Proposal {
    kind: Kind,
    name: String,
    place_m: Option<(f64, f64)>,
    /// Combinations of unknowns, each with the variance of its error.
    pub rows: Vec<(Vec<(Unknown, f64)>, f64)>,
}

/// All proposals, with notes on them.
pub(super) struct Proposed {
    pub proposals: Vec<Proposal>,
    pub notes: Vec<String>,
}

impl Proposal {
    /// The candidate, with its reduction of the variance.
    pub fn with(self, reduction: f64, variance: f64) -> Candidate {
        let share = if variance > 0.0 { reduction / variance } else { 0.0 };
        Candidate {
            kind: self.kind,
            name: self.name,
            x_m: self.place_m.map(|place| place.0),
            y_m: self.place_m.map(|place| place.1),
            reduction,
            share,
            sigma: (variance - reduction).max(0.0).sqrt(),
        }
    }
}

/// What could be observed at the time of `observed`, the window of the next analysis, by the networks of the run and by others.
/// For a method that does not estimate biases, observations have none.
pub(super) fn propose(
    request: &Request,
    info: &RunInfo,
    stations: &[Station],
    observed: &ObservationWindow,
    estimate: &Estimate,
    estimates_biases: bool,
) -> Result<Proposed, AdviceError> {
    let mut proposals = reports(observed, estimate, estimates_biases);
    let mut notes = Vec::new();
    let sigmas = sigmas(request, info, stations, observed)?;
    if sigmas.is_empty() {
        notes.push("No station reports at that time: give the errors of a new radiosonde with --sigma.".to_string());
    } else {
        let radiosonde = |kind: Kind, name: String, (x_m, y_m): (f64, f64)| Proposal {
            kind,
            name,
            place_m: Some((x_m, y_m)),
            rows: sigmas
                .iter()
                .filter_map(|&(number, sigma)| Some((seen(info, number, x_m, y_m)?, sigma * sigma)))
                .collect(),
        };
        let at_station = |it: &Station| {
            radiosonde(Kind::RadiosondeAtStation, format!("{}/{}", it.network, it.name), (it.x_m, it.y_m))
        };
        proposals.extend(stations.iter().map(at_station));
        let ([nx, ny], grid) = (request.grid, &info.layout.grid);
        if nx.saturating_mul(ny) > MOST_PLACES {
            return Err(AdviceError::Request(format!("a grid of {nx} x {ny} has more than {MOST_PLACES} places")));
        }
        let middle = |number: usize, count: usize, extent_m: f64| (number as f64 + 0.5) / count as f64 * extent_m;
        for (j, i) in (0..ny).flat_map(|j| (0..nx).map(move |i| (j, i))) {
            let place_m = (middle(i, nx, grid.width_m()), middle(j, ny, grid.height_m()));
            let name = format!("place {},{}", i + 1, j + 1);
            proposals.push(radiosonde(Kind::RadiosondeAtPlace, name, place_m));
        }
        let named = sigmas.iter().map(|&(number, sigma)| {
            let variable = &info.layout.variables[number];
            format!("{} {}", variable.name, with_unit(sigma, variable.unit))
        });
        notes.push(format!("A new radiosonde has errors of {}.", named.collect::<Vec<_>>().join(", ")));
    }
    if estimates_biases {
        let variance = request.comparison_sigma * request.comparison_sigma;
        proposals.extend(sensors(info, variance));
        let exact = if request.comparison_sigma > 0.0 {
            format!("have errors of {}, in the sensors' unit", request.comparison_sigma)
        } else {
            "are taken as exact: no real one would reduce the variance more".into()
        };
        notes.push(format!("Test points and comparisons {exact}."));
        if info.calibration.len() > MOST_COMPARED {
            notes.push(format!("There are more than {MOST_COMPARED} sensors, so that no pairs are compared."));
        }
    }
    Ok(Proposed { proposals, notes })
}

/// The next reports; those of a platform are one proposal.
fn reports(observed: &ObservationWindow, estimate: &Estimate, estimates_biases: bool) -> Vec<Proposal> {
    if observed.is_empty() {
        return Vec::new();
    }
    let jacobian = observed.operator.linearize(&estimate.state, &estimate.calibration);
    let mut proposals: IndexMap<(String, String), Proposal> = IndexMap::new();
    for (row, report) in observed.reports.iter().enumerate() {
        let of_state = jacobian.state.row(row).iter().map(|&(number, weight)| (Unknown::Value(number), weight));
        let of_biases = jacobian.calibration.row(row).iter().filter(|_| estimates_biases);
        let of_biases = of_biases.map(|&(number, weight)| (Unknown::Parameter(number), weight));
        let entry = proposals.entry((report.network.to_string(), report.platform.to_string()));
        let proposal = entry.or_insert_with(|| Proposal {
            kind: Kind::Report,
            name: format!("{}/{}", report.network, report.platform),
            place_m: Some((report.x_m, report.y_m)),
            rows: Vec::new(),
        });
        proposal.rows.push((of_state.chain(of_biases).collect(), observed.sigma[row].powi(2)));
    }
    proposals.into_values().collect()
}

/// The variables of a new radiosonde by their numbers, with standard deviations.
fn sigmas(
    request: &Request,
    info: &RunInfo,
    stations: &[Station],
    observed: &ObservationWindow,
) -> Result<Vec<(usize, f64)>, AdviceError> {
    let given = |(name, &sigma): (&String, &f64)| match info.layout.variable(name) {
        Some(number) => Ok((number, sigma)),
        None => Err(AdviceError::Request(format!("there is no variable {} for a radiosonde", clean(name)))),
    };
    if !request.sigmas.is_empty() {
        return request.sigmas.iter().map(given).collect();
    }
    let of_station = |row: &usize| {
        let report = &observed.reports[*row];
        stations.iter().any(|it| *it.network == *report.network && *it.name == *report.platform)
    };
    let rows: Vec<usize> = (0..observed.len()).filter(of_station).collect();
    let least = |number: usize| {
        let of_variable = rows.iter().filter(|&&row| observed.reports[row].variable == number);
        of_variable.map(|&row| observed.sigma[row]).min_by(f64::total_cmp).map(|sigma| (number, sigma))
    };
    Ok((0..info.layout.variables.len()).filter_map(least).collect())
}

/// The value of a variable at a place, as an interpolation of the state; `None` outside of the grid points.
fn seen(info: &RunInfo, number: usize, x_m: f64, y_m: f64) -> Option<Vec<(Unknown, f64)>> {
    let grid = &info.layout.grid;
    let stencil = grid.stencil(info.layout.variables[number].location, x_m, y_m)?;
    let first = number * grid.cells();
    let entries = stencil.entries.into_iter().map(|(index, weight)| (Unknown::Value(first + index), weight));
    Some(entries.collect()).filter(|entries: &Vec<_>| !entries.is_empty())
}

/// Test points of every sensor, and comparisons of all pairs with the same unit.
fn sensors(info: &RunInfo, variance: f64) -> Vec<Proposal> {
    let parameters = &info.calibration.parameters;
    let proposal =
        |kind, name, combination| Proposal { kind, name, place_m: None, rows: vec![(combination, variance)] };
    let test_point = |(number, parameter): (usize, &isobar_obs::Parameter)| {
        proposal(Kind::TestPoint, parameter.name.clone(), vec![(Unknown::Parameter(number), 1.0)])
    };
    let mut proposals: Vec<Proposal> = parameters.iter().enumerate().map(test_point).collect();
    if parameters.len() <= MOST_COMPARED {
        for (i, first) in parameters.iter().enumerate() {
            for (j, second) in parameters.iter().enumerate().skip(i + 1).filter(|(_, it)| it.unit == first.unit) {
                let combination = vec![(Unknown::Parameter(i), 1.0), (Unknown::Parameter(j), -1.0)];
                let name = format!("{} − {}", first.name, second.name);
                proposals.push(proposal(Kind::Comparison, name, combination));
            }
        }
    }
    proposals
}
