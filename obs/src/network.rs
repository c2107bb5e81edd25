//! Networks: where stations are, which are in the domain, and how they are grouped.

use crate::error::{ObservationError, list, require};
use crate::instrument::MOST_PLATFORMS;
use crate::projection::Projection;
use crate::stations::{Position, Stations};
use isobar_model::Grid;
use isobar_model::random::stream;
use rand::RngExt;
use std::sync::Arc;

/// Where the stations of a network come from.
#[derive(Clone, Debug, PartialEq)]
pub enum StationSource {
    /// A station file.
    File {
        /// The parsed file.
        stations: Stations,
        /// The column that says to which group a station belongs (`country`); `None`: all are in the group `all`.
        group_by: Option<String>,
    },
    /// Stations at the centres of `columns` × `rows` equal rectangles.
    Regular {
        /// Number of stations in x.
        columns: usize,
        /// Number of stations in y.
        rows: usize,
        /// Groups, to which the stations belong in turn; empty: all are in the group `all`.
        groups: Vec<String>,
    },
    /// Stations anywhere, uniformly distributed.
    Random {
        /// Number of stations.
        count: usize,
        /// Groups, to which the stations belong in turn; empty: all are in the group `all`.
        groups: Vec<String>,
    },
}

/// A station in the domain.
#[derive(Clone, Debug, PartialEq)]
pub struct Station {
    /// The network.
    pub network: Arc<str>,
    /// Identifier, unique in the network: a WMO number.
    pub name: Arc<str>,
    /// The station's name in words; its identifier if the file has no column `name`.
    pub long_name: Arc<str>,
    /// Its group.
    pub group: Arc<str>,
    /// Whether its group is a reference, without bias.
    pub is_reference: bool,
    /// x \[m\].
    pub x_m: f64,
    /// y \[m\].
    pub y_m: f64,
}

/// A station that the domain leaves out.
#[derive(Clone, Debug, PartialEq)]
pub struct LeftOutStation {
    /// The network.
    pub network: Arc<str>,
    /// Identifier.
    pub name: Arc<str>,
    /// The station's name in words.
    pub long_name: Arc<str>,
    /// Its line in the station file.
    pub line: Option<usize>,
    /// Where it would be (x, y) \[m\]; `None` at the antipode of the projection's centre.
    pub place_m: Option<(f64, f64)>,
}

/// The stations of one network.
#[derive(Clone, Debug)]
pub(crate) struct Network {
    /// Those in the domain, in the order of the file; at least one.
    pub stations: Vec<Station>,
    pub left_out: Vec<LeftOutStation>,
    /// The groups of the stations in the domain, sorted.
    pub groups: Vec<Arc<str>>,
}

/// A station before it is known whether it lies in the domain.
struct Candidate {
    name: String,
    long_name: String,
    group: String,
    line: Option<usize>,
    place_m: Option<(f64, f64)>,
}

/// Puts the stations of `source` on the plane; leaves out those outside of the domain or nearer than `edge_margin_m`
/// to its edges.
pub(crate) fn place(
    name: &str,
    source: &StationSource,
    reference_groups: &[String],
    edge_margin_m: f64,
    grid: &Grid,
    projection: Option<&Projection>,
    seed: u64,
) -> Result<Network, ObservationError> {
    let margin = edge_margin_m;
    let largest = 0.5 * grid.width_m().min(grid.height_m());
    let expected = format!("from 0 to below {largest} m, half of the domain");
    require((0.0..largest).contains(&margin), name, "edge_margin_m", margin, expected)?;
    let candidates = match source {
        StationSource::File { stations, group_by } => from_file(name, stations, group_by.as_deref(), grid, projection)?,
        StationSource::Regular { columns, rows, groups } => regular(name, *columns, *rows, groups, margin, grid)?,
        StationSource::Random { count, groups } => random(name, *count, groups, margin, grid, seed)?,
    };

    let mut all_groups: Vec<&str> = candidates.iter().map(|candidate| candidate.group.as_str()).collect();
    all_groups.sort_unstable();
    all_groups.dedup();
    for (index, group) in reference_groups.iter().enumerate() {
        let (instrument, value) = (name.to_owned(), group.clone());
        if !all_groups.contains(&group.as_str()) {
            let valid = list(&all_groups);
            return Err(ObservationError::UnknownName { instrument, setting: "reference_groups", value, valid });
        }
        if reference_groups[..index].contains(group) {
            return Err(ObservationError::DuplicateName { instrument, setting: "reference_groups", value });
        }
    }

    let network: Arc<str> = name.into();
    let inside = |&(x, y): &(f64, f64)| {
        grid.contains(x, y)
            && x >= margin
            && y >= margin
            && x <= grid.width_m() - margin
            && y <= grid.height_m() - margin
    };
    let count = candidates.len();
    let (mut stations, mut left_out): (Vec<Station>, Vec<LeftOutStation>) = (Vec::new(), Vec::new());
    for Candidate { name, long_name, group, line, place_m } in candidates {
        let (network, name, long_name) = (Arc::clone(&network), name.into(), long_name.into());
        match place_m.filter(inside) {
            Some((x_m, y_m)) => {
                let is_reference = reference_groups.contains(&group);
                stations.push(Station { network, name, long_name, group: group.into(), is_reference, x_m, y_m });
            }
            None => left_out.push(LeftOutStation { network, name, long_name, line, place_m }),
        }
    }
    if stations.is_empty() {
        let instrument = name.to_owned();
        return Err(ObservationError::NoStationInDomain { instrument, stations: count, edge_margin_m });
    }
    let mut groups: Vec<Arc<str>> = stations.iter().map(|station| Arc::clone(&station.group)).collect();
    groups.sort_unstable();
    groups.dedup();
    Ok(Network { stations, left_out, groups })
}

fn from_file(
    name: &str,
    stations: &Stations,
    group_by: Option<&str>,
    grid: &Grid,
    projection: Option<&Projection>,
) -> Result<Vec<Candidate>, ObservationError> {
    let groups = match group_by {
        None => vec!["all"; stations.records().len()],
        Some(column) => match stations.column(column) {
            Some(number) => stations.groups(number)?,
            None => {
                return Err(ObservationError::UnknownGroupColumn {
                    instrument: name.to_owned(),
                    file: stations.file().to_owned(),
                    column: column.to_owned(),
                    valid: list(stations.columns()),
                });
            }
        },
    };
    let long_name = stations.column("name");
    let candidate = |(record, group): (&crate::stations::StationRecord, &str)| {
        let place_m = match (record.position, projection) {
            (Position::Plane { x_m, y_m }, _) => Some(grid.first_image(x_m, y_m)),
            (Position::Geographic { latitude_deg, longitude_deg }, Some(projection)) => {
                projection.forward(latitude_deg, longitude_deg)
            }
            (Position::Geographic { .. }, None) => {
                let (instrument, file) = (name.to_owned(), stations.file().to_owned());
                return Err(ObservationError::NoProjection { instrument, file });
            }
        };
        let long_name = long_name.map(|column| &record.fields[column]).filter(|text| !text.is_empty());
        Ok(Candidate {
            name: record.id.clone(),
            long_name: long_name.unwrap_or(&record.id).clone(),
            group: group.to_owned(),
            line: Some(record.line),
            place_m,
        })
    };
    stations.records().iter().zip(groups).map(candidate).collect()
}

fn regular(
    name: &str,
    columns: usize,
    rows: usize,
    groups: &[String],
    margin: f64,
    grid: &Grid,
) -> Result<Vec<Candidate>, ObservationError> {
    require(columns >= 1, name, "stations.columns", columns as f64, "at least 1")?;
    require(rows >= 1, name, "stations.rows", rows as f64, "at least 1")?;
    let count = columns.saturating_mul(rows);
    let most = format!("such that there are at most {MOST_PLATFORMS} stations");
    require(count <= MOST_PLATFORMS, name, "stations.columns", columns as f64, most)?;
    let (width, height) = (grid.width_m() - 2.0 * margin, grid.height_m() - 2.0 * margin);
    let place = |number: usize| {
        let (row, column) = (number / columns, number % columns);
        let x = margin + (column as f64 + 0.5) * width / columns as f64;
        let y = margin + (row as f64 + 0.5) * height / rows as f64;
        (format!("row {} column {}", row + 1, column + 1), (x, y))
    };
    in_turn(name, (0..count).map(place), groups)
}

fn random(
    name: &str,
    count: usize,
    groups: &[String],
    margin: f64,
    grid: &Grid,
    seed: u64,
) -> Result<Vec<Candidate>, ObservationError> {
    let expected = format!("from 1 to {MOST_PLATFORMS}");
    require((1..=MOST_PLATFORMS).contains(&count), name, "stations.count", count as f64, expected)?;
    let (width, height) = (grid.width_m() - 2.0 * margin, grid.height_m() - 2.0 * margin);
    let mut random = stream(seed, &format!("stations/{name}"));
    let place = |number: usize| {
        let x = margin + random.random::<f64>() * width;
        let y = margin + random.random::<f64>() * height;
        (format!("random {}", number + 1), (x, y))
    };
    in_turn(name, (0..count).map(place), groups)
}

/// Candidates that belong to the groups in turn.
fn in_turn(
    name: &str,
    places: impl Iterator<Item = (String, (f64, f64))>,
    groups: &[String],
) -> Result<Vec<Candidate>, ObservationError> {
    for (index, group) in groups.iter().enumerate() {
        if groups[..index].contains(group) {
            return Err(ObservationError::DuplicateName {
                instrument: name.to_owned(),
                setting: "stations.groups",
                value: group.clone(),
            });
        }
    }
    let group = |number: usize| match groups {
        [] => "all".to_owned(),
        groups => groups[number % groups.len()].clone(),
    };
    let candidate = |(number, (name, place_m)): (usize, (String, (f64, f64)))| Candidate {
        long_name: name.clone(),
        name,
        group: group(number),
        line: None,
        place_m: Some(place_m),
    };
    Ok(places.enumerate().map(candidate).collect())
}
