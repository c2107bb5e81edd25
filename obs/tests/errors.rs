//! Every mistake in a configuration is an error that says where, what, and what would be right.

use crate::common::*;
use isobar_model::{Boundary, Duration, Time};
use isobar_obs::{
    AirMassBias, BiasProcess, BiasScope, Network, ObservationError, ObservedVariable, ObservingSystem,
    RadiosondeSettings, SatelliteSettings, ScanBias, ScanTerm, Schedule, StationBias, StationFile, StationSource,
};

fn error(configs: &[Network]) -> ObservationError {
    match try_system(&layout(Boundary::Channel), None, configs) {
        Err(error) => error,
        Ok(_) => panic!("this must not be accepted: {configs:?}"),
    }
}

/// The error of a network that is right but for `change` must name it, the setting, and contain `expected`.
#[track_caller]
fn network_error(setting: &str, expected: &str, change: impl FnOnce(&mut RadiosondeSettings)) {
    let mut config = radiosondes(6);
    change(&mut config);
    let error = error(&[Network::new("net", config)]);
    let message = error.to_string();
    assert!(message.contains(expected), "{message}");
    assert_eq!((error.network(), error.setting()), (Some("net"), Some(setting)), "{message}");
}

#[track_caller]
fn satellite_error(setting: &str, expected: &str, change: impl FnOnce(&mut SatelliteSettings)) {
    let mut config = satellite();
    change(&mut config);
    let error = error(&[Network::new("polar", config)]);
    let message = error.to_string();
    assert!(message.contains(expected), "{message}");
    assert_eq!((error.network(), error.setting()), (Some("polar"), Some(setting)), "{message}");
}

fn bias(variable: &str, scope: BiasScope) -> StationBias {
    StationBias { variable: variable.to_owned(), scope, process: BiasProcess::constant(1.0) }
}

fn file(text: &str, group_by: Option<&str>) -> StationSource {
    let stations = StationFile::parse(text, "some.csv").unwrap();
    StationSource::File { stations, group_by: group_by.map(str::to_owned), groups: Vec::new() }
}

#[test]
fn what_a_network_reports() {
    network_error("variables", "names `q`, which is not known; valid: `h`, `u`, `v`, `tracer`", |config| {
        config.variables.push(ObservedVariable::new("q", 1.0));
    });
    network_error("variables", "has `u` twice", |config| config.variables.push(ObservedVariable::new("u", 1.0)));
    network_error("variables", "needs at least one", |config| config.variables.clear());
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let expected = format!("variables.sigma is {sigma}, but must be above 0");
        network_error("variables.sigma", &expected, |config| config.variables[0].sigma = sigma);
    }
    let network = || Network::new("net", radiosondes(6));
    let check = |network: Network, setting: &str, expected: &str| {
        let error = error(&[network]);
        assert!(error.to_string().contains(expected), "{error}");
        assert_eq!((error.network(), error.setting()), (Some("net"), Some(setting)), "{error}");
    };
    for missing_rate in [-0.1, 1.5, f64::NAN] {
        check(Network { missing_rate, ..network() }, "missing_rate", "a probability from 0 to 1");
    }
    let schedule = Schedule { every_cycles: 0, first_cycle: 1 };
    check(Network { schedule, ..network() }, "schedule.every_cycles", "is 0, but must be at least 1");
    let schedule = Schedule { every_cycles: 2, first_cycle: 0 };
    check(Network { schedule, ..network() }, "schedule.first_cycle", "is 0, but must be at least 1");
}

#[test]
fn where_its_stations_are() {
    let random = |count| StationSource::Random { count, groups: vec![] };
    let regular = |columns, rows| StationSource::Regular { columns, rows, groups: vec![] };
    network_error("stations.count", "is 0, but must be from 1 to 1000000", |config| config.stations = random(0));
    network_error("stations.count", "from 1 to 1000000", |config| config.stations = random(usize::MAX));
    network_error("stations.columns", "at least 1", |config| config.stations = regular(0, 3));
    network_error("stations.rows", "at least 1", |config| config.stations = regular(3, 0));
    network_error("stations.columns", "at most 1000000", |config| config.stations = regular(usize::MAX, 2));
    network_error("stations.groups", "has `a` twice", |config| {
        config.stations = random_stations(6, &["a", "b", "a"]);
    });
    for margin in [-1.0, 720e3, f64::NAN] {
        network_error("edge_margin_m", "from 0 to below 720000 m", |config| config.edge_margin_m = margin);
    }
    network_error("stations", "none of the 1 stations lies in the domain", |config| {
        config.stations = file("id,x_m,y_m\na,5,-5\n", None);
    });
    network_error("stations", "some.csv gives latitudes and longitudes, but the domain has no projection", |config| {
        config.stations = file("id,latitude_deg,longitude_deg\na,50,5\n", None);
    });
    network_error("group_by", "no column `state` to group the stations of some.csv by; it has `id`, `x_m`", |config| {
        config.stations = file("id,x_m,y_m\na,5,5\n", Some("state"));
    });
    let mut config = radiosondes(6);
    config.stations = file("id,x_m,y_m,type\na,5,5,A\nb,5,5,\n", Some("type"));
    let message = error(&[Network::new("net", config)]).to_string();
    assert!(message.contains("some.csv, line 3: the column `type` is empty"), "{message}");
}

#[test]
fn which_groups_and_biases_it_has() {
    network_error("reference_groups", "names `d`, which is not known; valid: `a`, `b`, `c`", |config| {
        config.reference_groups = vec!["d".to_owned()];
    });
    network_error("reference_groups", "has `a` twice", |config| {
        config.reference_groups = vec!["a".to_owned(), "a".to_owned()];
    });
    network_error("biases.variable", "names `tracer`, which is not known; valid: `h`, `u`, `v`", |config| {
        config.biases = vec![bias("tracer", BiasScope::EachGroup)];
    });
    network_error("biases.scope", "names `d`, which is not known; valid: `a`, `b`, `c`", |config| {
        config.biases = vec![bias("h", BiasScope::Group("d".to_owned()))];
    });
    network_error("biases.scope", "the identifiers of the 6 stations in the domain", |config| {
        config.biases = vec![bias("h", BiasScope::Station("d".to_owned()))];
    });
    network_error("biases.scope", "this one is outside of it", |config| {
        config.stations = file("id,x_m,y_m\na,5,5\nfar,5,-5\n", None);
        config.biases = vec![bias("h", BiasScope::Station("far".to_owned()))];
    });
    network_error("biases", "a bias is given to `a`, which is in the reference group `a`", |config| {
        config.reference_groups = vec!["a".to_owned()];
        config.biases = vec![bias("h", BiasScope::Group("a".to_owned()))];
    });
    network_error("biases", "a bias is given to `random 1`, which is in the reference group `a`", |config| {
        config.reference_groups = vec!["a".to_owned()];
        config.biases = vec![bias("h", BiasScope::Station("random 1".to_owned()))];
    });
    for scope in [BiasScope::EachGroup, BiasScope::EachStation] {
        network_error("biases", "applies to nothing, since every station is in a reference group", |config| {
            config.reference_groups = ["a", "b", "c"].map(str::to_owned).to_vec();
            config.biases = vec![bias("h", scope)];
        });
    }
    network_error("biases", "biases has `net/h/a` twice", |config| {
        config.biases = vec![bias("h", BiasScope::EachGroup), bias("h", BiasScope::Group("a".to_owned()))];
    });
    network_error("biases.initial.sigma", "is -2, but must be at least 0", |config| {
        config.biases = vec![bias("h", BiasScope::EachGroup)];
        config.biases[0].process = BiasProcess::constant(-2.0);
    });
}

#[test]
fn what_a_satellite_scans() {
    satellite_error("variable", "names `q`", |config| config.variable.name = "q".to_owned());
    satellite_error("variable.sigma", "is 0, but must be above 0", |config| config.variable.sigma = 0.0);
    satellite_error("scan_positions", "is 0, but must be from 1", |config| config.scan_positions = 0);
    satellite_error("scan_positions", "from 1 to 1000000", |config| config.scan_positions = usize::MAX);
    satellite_error("scan_positions", "at least 3 for the bias `scan_quadratic`", |config| config.scan_positions = 2);
    for width in [-1.0, 2_400e3, f64::NAN] {
        satellite_error("swath_width_m", "from 0 to below 2400000 m", |config| config.swath_width_m = width);
    }
    for spacing in [0.0, -1.0, f64::NAN] {
        satellite_error("along_track_spacing_m", "above 0", |config| config.along_track_spacing_m = spacing);
    }
    satellite_error("along_track_spacing_m", "at most a million footprints", |config| {
        config.along_track_spacing_m = 1e-300;
    });
    for sigma in [-1.0, 49e3, 400e3, f64::NAN] {
        let expected = "0 for a point, or 50 km (half of a cell) to below 400 km";
        satellite_error("footprint_sigma_m", expected, |config| config.footprint_sigma_m = sigma);
    }
    for x in [f64::NAN, f64::INFINITY, -1e10] {
        satellite_error("crossing_x_m", "from -1000000000 to 1000000000 m", |config| config.crossing_x_m = x);
        satellite_error("shift_per_cycle_m", "from -1000000000 to", |config| config.shift_per_cycle_m = x);
    }
    for angle in [90.0, f64::NAN] {
        satellite_error("track_angle_deg", "from -60 to 60", |config| config.track_angle_deg = angle);
    }
    let air_mass = |variable: &str, mean, scale| AirMassBias {
        variable: variable.to_owned(),
        mean,
        scale,
        process: BiasProcess::constant(1.0),
    };
    satellite_error("biases.variable", "names `q`", |config| config.air_mass_biases = vec![air_mass("q", 0.0, 1.0)]);
    for scale in [0.0, -1.0, f64::NAN] {
        satellite_error("biases.scale", "above 0", |config| config.air_mass_biases = vec![air_mass("h", 0.0, scale)]);
    }
    satellite_error("biases.mean", "must be finite", |config| {
        config.air_mass_biases = vec![air_mass("h", f64::INFINITY, 1.0)];
    });
    satellite_error("biases", "has `polar/air_mass_h` twice", |config| {
        config.air_mass_biases = vec![air_mass("h", 0.0, 1.0), air_mass("h", 5.0, 1.0)];
    });
    satellite_error("biases", "has `polar/offset` twice", |config| {
        config.biases.push(ScanBias { term: ScanTerm::Offset, process: BiasProcess::constant(1.0) });
    });
}

#[test]
fn how_the_instruments_go_together() {
    let twice = [Network::new("net", radiosondes(3)), Network::new("net", satellite())];
    assert_eq!(error(&twice).to_string(), "net: name has `net` twice; each may occur once");
    for name in ["", " ", "a/b"] {
        let error = error(&[Network::new(name, radiosondes(3))]);
        assert_eq!((error.network(), error.setting()), (Some(name), Some("name")));
    }
    let layout = layout(Boundary::Channel);
    let window = Duration::from_seconds(0);
    let error = ObservingSystem::new(&layout, None, &[], 1, window, Time::from_seconds(0)).err().unwrap();
    assert_eq!(error.to_string(), "the assimilation window is 0 s, but must be at least 1 s");
}

#[test]
fn an_observing_system_without_instruments_observes_nothing() {
    let layout = layout(Boundary::Channel);
    let mut system = system(&layout, &[]);
    assert_eq!((system.cycle(), system.time()), (0, Time::from_seconds(0)));
    assert!(system.observe(&random_state(&layout, 1)).is_empty());
    assert_eq!((system.cycle(), system.time()), (1, Time::from_seconds(6 * 3600)));
}

#[test]
#[should_panic(expected = "the observing system's layout")]
fn a_truth_of_another_layout_is_a_bug() {
    let mut system = system(&layout(Boundary::Channel), &[]);
    system.observe(&random_state(&layout(Boundary::Periodic), 1));
}
