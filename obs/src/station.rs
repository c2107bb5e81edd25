//! Stations: where they are, which are in the domain, and how they are grouped.

use crate::error::{ObservationError, list, require};
use crate::site::Site;
use crate::station_file::{Position, StationFile, StationRecord};
use isobar_model::Grid;
use rand::RngExt;
use std::sync::Arc;

/// The most stations that one network may have.
pub const MOST_STATIONS: usize = 1_000_000;

/// Where the stations of a network come from, and the groups that they form.
#[derive(Clone, Debug, PartialEq)]
pub enum StationSource {
    /// Those of a station file.
    File {
        /// The parsed file.
        stations: StationFile,
        /// The column that says to which group a station belongs (`country`); `None`: all are in the group `all`.
        group_by: Option<String>,
        /// The groups whose stations report; empty: all.
        groups: Vec<String>,
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

/// The stations of one network on the plane.
#[derive(Clone, Debug)]
pub(crate) struct PlacedStations {
    /// Those in the domain, in the order of the file; at least one.
    pub stations: Vec<Station>,
    /// Those outside of the domain, or too near to its edges.
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
    site: &Site<'_>,
    source: &StationSource,
    reference_groups: &[String],
    edge_margin_m: f64,
) -> Result<PlacedStations, ObservationError> {
    let (name, grid, margin) = (site.network, &site.layout.grid, edge_margin_m);
    let largest = 0.5 * grid.width_m().min(grid.height_m());
    let expected = format!("from 0 to below {largest} m, half of the domain");
    require((0.0..largest).contains(&margin), name, "edge_margin_m", margin, expected)?;
    let candidates = match source {
        StationSource::File { stations, group_by, groups } => from_file(site, stations, group_by.as_deref(), groups)?,
        StationSource::Regular { columns, rows, groups } => regular(name, *columns, *rows, groups, margin, grid)?,
        StationSource::Random { count, groups } => random(site, *count, groups, margin)?,
    };

    let mut all_groups: Vec<&str> = candidates.iter().map(|candidate| candidate.group.as_str()).collect();
    all_groups.sort_unstable();
    all_groups.dedup();
    for (index, group) in reference_groups.iter().enumerate() {
        if !all_groups.contains(&group.as_str()) {
            return Err(ObservationError::unknown_name(name, "reference_groups", group, &all_groups));
        }
        if reference_groups[..index].contains(group) {
            return Err(ObservationError::duplicate_name(name, "reference_groups", group));
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
        let problem = format!(
            "none of the {count} stations lies in the domain; check the centre of the projection, the domain's size and \
             edge_margin_m = {edge_margin_m}"
        );
        return Err(ObservationError::in_setting(name, "stations", problem));
    }
    let mut groups: Vec<Arc<str>> = stations.iter().map(|station| Arc::clone(&station.group)).collect();
    groups.sort_unstable();
    groups.dedup();
    Ok(PlacedStations { stations, left_out, groups })
}

fn from_file(
    site: &Site<'_>,
    stations: &StationFile,
    group_by: Option<&str>,
    chosen: &[String],
) -> Result<Vec<Candidate>, ObservationError> {
    let name = site.network;
    let Some(column) = group_by else {
        if !chosen.is_empty() {
            let problem = "groups are given, but not the column of the file that names them; add group_by";
            return Err(ObservationError::in_setting(name, "groups", problem));
        }
        return stations.records().iter().map(|record| candidate(site, stations, record, "all")).collect();
    };
    let Some(number) = stations.column(column) else {
        let (file, columns) = (stations.file(), list(stations.columns()));
        let problem = format!("there is no column `{column}` to group the stations of {file} by; it has {columns}");
        return Err(ObservationError::in_setting(name, "group_by", problem));
    };
    let groups = stations.groups(number).map_err(|error| ObservationError::from(error).of_network(name, "stations"))?;
    if let Some(missing) = chosen.iter().find(|group| !groups.contains(&group.as_str())) {
        let mut present = groups;
        present.sort_unstable();
        present.dedup();
        return Err(ObservationError::unknown_name(name, "groups", missing, present));
    }
    let is_chosen = |group: &str| chosen.is_empty() || chosen.iter().any(|other| other == group);
    let grouped = stations.records().iter().zip(groups).filter(|(_, group)| is_chosen(group));
    grouped.map(|(record, group)| candidate(site, stations, record, group)).collect()
}

/// The station of a line of a file.
fn candidate(
    site: &Site<'_>,
    stations: &StationFile,
    record: &StationRecord,
    group: &str,
) -> Result<Candidate, ObservationError> {
    let place_m = match (record.position, site.projection) {
        (Position::Plane { x_m, y_m }, _) => Some(site.layout.grid.first_image(x_m, y_m)),
        (Position::Geographic { latitude_deg, longitude_deg }, Some(projection)) => {
            projection.forward(latitude_deg, longitude_deg)
        }
        (Position::Geographic { .. }, None) => {
            return Err(no_projection(site.network, "stations", stations.file()));
        }
    };
    let long_name = stations.column("name").map(|column| &record.fields[column]).filter(|text| !text.is_empty());
    Ok(Candidate {
        name: record.id.clone(),
        long_name: long_name.unwrap_or(&record.id).clone(),
        group: group.to_owned(),
        line: Some(record.line),
        place_m,
    })
}

/// A file with latitudes and longitudes for a plane that does not lie on the Earth.
pub(crate) fn no_projection(network: &str, setting: &'static str, file: &str) -> ObservationError {
    let problem = format!(
        "{file} gives latitudes and longitudes, but the domain has no projection; give the latitude and longitude of its \
         centre, or places in x_m and y_m"
    );
    ObservationError::in_setting(network, setting, problem)
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
    let most = format!("such that there are at most {MOST_STATIONS} stations");
    require(count <= MOST_STATIONS, name, "stations.columns", columns as f64, most)?;
    let (width, height) = (grid.width_m() - 2.0 * margin, grid.height_m() - 2.0 * margin);
    let place = |number: usize| {
        let (row, column) = (number / columns, number % columns);
        let x = margin + (column as f64 + 0.5) * width / columns as f64;
        let y = margin + (row as f64 + 0.5) * height / rows as f64;
        (format!("row {} column {}", row + 1, column + 1), (x, y))
    };
    in_turn(name, (0..count).map(place), groups)
}

fn random(site: &Site<'_>, count: usize, groups: &[String], margin: f64) -> Result<Vec<Candidate>, ObservationError> {
    let (name, grid) = (site.network, &site.layout.grid);
    let expected = format!("from 1 to {MOST_STATIONS}");
    require((1..=MOST_STATIONS).contains(&count), name, "stations.count", count as f64, expected)?;
    let (width, height) = (grid.width_m() - 2.0 * margin, grid.height_m() - 2.0 * margin);
    let mut random = site.stream("stations");
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
            return Err(ObservationError::duplicate_name(name, "stations.groups", group));
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
