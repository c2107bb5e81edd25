//! The station files that come with the program.

use crate::common::*;
use isobar_model::{Boundary, Grid, Layout};
use isobar_obs::{
    BiasProcess, BiasScope, Network, Position, Projection, RadiosondeSettings, StationBias, StationFile, StationSource,
};
use std::sync::Arc;

const EUROPE: &str = include_str!("../../scenarios/stations/europe.csv");
const CONTINENTAL_US: &str = include_str!("../../scenarios/stations/continental_us.csv");

fn domain(nx: usize, ny: usize) -> Arc<Layout> {
    layout_of(Grid { nx, ny, dx_m: 80e3, dy_m: 80e3, boundary: Boundary::Channel })
}

fn grouped(text: &str, column: &str) -> RadiosondeSettings {
    let stations = StationFile::parse(text, "shipped.csv").unwrap();
    RadiosondeSettings::new(StationSource::File { stations, group_by: Some(column.to_owned()), groups: Vec::new() })
}

#[test]
fn the_files_have_the_columns_and_lie_in_the_boxes_that_their_headers_state() {
    let cases = [(EUROPE, 121, (35.0, 70.0), (-12.0, 40.0)), (CONTINENTAL_US, 89, (24.0, 50.0), (-126.0, -66.0))];
    for (text, count, (south, north), (west, east)) in cases {
        let stations = StationFile::parse(text, "shipped.csv").unwrap();
        let columns =
            ["id", "latitude_deg", "longitude_deg", "elevation_m", "name", "country", "wmo_series", "igra_id"];
        assert_eq!(stations.columns(), columns);
        assert_eq!(stations.records().len(), count);
        assert!(text.lines().next().unwrap().contains(&format!("{count} stations")));
        assert!(text.contains("IGRA") && text.contains("December 2019"));
        for record in stations.records() {
            let Position::Geographic { latitude_deg, longitude_deg } = record.position else { panic!("{record:?}") };
            assert!((south..=north).contains(&latitude_deg) && (west..=east).contains(&longitude_deg), "{record:?}");
            assert!(record.id.len() == 5 && record.fields[7].ends_with(&record.id), "{record:?}");
            assert!(record.fields[5].len() > 2, "a country has a readable name: {record:?}");
            assert!(record.id.starts_with(&record.fields[6]), "{record:?}");
        }
    }
}

#[test]
fn the_stations_of_europe_lie_in_a_domain_about_its_middle() {
    let layout = domain(64, 48);
    let projection = Projection::centered(&layout.grid, 52.5, 14.0);
    let mut config = grouped(EUROPE, "country");
    config.reference_groups = vec!["Germany".to_owned()];
    let process = BiasProcess::constant(10.0);
    config.biases = vec![StationBias { variable: "h".to_owned(), scope: BiasScope::EachGroup, process }];
    let system = try_system(&layout, Some(&projection), &[Network::new("net", config)]).unwrap();
    assert_eq!(system.stations().len(), 120);
    let [murmansk] = system.left_out() else { panic!("{:?}", system.left_out()) };
    assert_eq!((&*murmansk.name, &*murmansk.long_name), ("22113", "MURMANSK"));
    assert!((murmansk.place_m.unwrap().1 - 3_854e3).abs() < 1e3, "14 km north of the domain");
    let reference = system.stations().iter().filter(|station| station.is_reference).count();
    assert_eq!((reference, system.calibration().len()), (14, 34));
    assert!(system.calibration().position("net/h/France").is_some());
    assert_eq!(system.calibration().position("net/h/Germany"), None);
    // Lindenberg, 52.2167 N 14.1167 E, is 32 km from the centre.
    let lindenberg = system.stations().iter().find(|station| &*station.name == "10393").unwrap();
    assert_eq!((&*lindenberg.long_name, &*lindenberg.group), ("LINDENBERG", "Germany"));
    let distance = (lindenberg.x_m - 2_560e3).hypot(lindenberg.y_m - 1_920e3);
    assert!((distance - 32.5e3).abs() < 0.5e3, "{distance}");
}

#[test]
fn the_stations_of_the_continental_us_lie_in_a_domain_about_its_middle() {
    let layout = domain(72, 40);
    let projection = Projection::centered(&layout.grid, 38.0, -96.0);
    let by = |column: &str| {
        let config = Network::new("net", grouped(CONTINENTAL_US, column));
        try_system(&layout, Some(&projection), &[config]).unwrap()
    };
    let groups = |column: &str| {
        let system = by(column);
        let mut groups: Vec<_> = system.stations().iter().map(|station| station.group.to_string()).collect();
        groups.sort();
        groups.dedup();
        groups
    };
    assert_eq!((by("country").stations().len(), by("country").left_out().len()), (89, 0));
    assert_eq!(groups("country"), ["Bahamas", "Canada", "Mexico", "United States"]);
    assert_eq!(groups("wmo_series").len(), 19);
}
