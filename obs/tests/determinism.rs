//! The same seed gives the same bits; adding an instrument or a bias changes nothing else.

use crate::common::*;
use isobar_model::{Boundary, Time};
use isobar_obs::{
    BiasProcess, BiasScope, Evolution, Network, ObservationWindow, ObservingSystem, RadiosondeSettings, StationBias,
};

fn biased_radiosondes() -> RadiosondeSettings {
    let process =
        BiasProcess { evolution: Evolution::RandomWalk { sigma_per_sqrt_day: 3.0 }, ..BiasProcess::constant(20.0) };
    let biases = vec![StationBias { variable: "h".to_owned(), scope: BiasScope::EachGroup, process }];
    RadiosondeSettings { biases, ..radiosondes(40) }
}

fn with_gaps(name: &str, settings: RadiosondeSettings) -> Network {
    Network { missing_rate: 0.1, ..Network::new(name, settings) }
}

fn biased_network(name: &str) -> Network {
    with_gaps(name, biased_radiosondes())
}

/// Three windows, each with its values without their biases.
fn windows(configs: &[Network], seed: u64) -> Vec<(ObservationWindow, Vec<f64>)> {
    let layout = layout(Boundary::Channel);
    let truth = random_state(&layout, 1);
    let mut system = ObservingSystem::new(&layout, None, configs, seed, WINDOW, Time::from_seconds(0)).unwrap();
    (0..3).map(|_| (system.observe(&truth), system.values_bias_removed().to_vec())).collect()
}

/// (network, platform, variable, value and unbiased value in bits) of every observation of one instrument.
fn bits(windows: &[(ObservationWindow, Vec<f64>)], name: &str) -> Vec<(String, usize, u64, u64)> {
    let mut bits = Vec::new();
    for (window, values_bias_removed) in windows {
        for (number, report) in window.reports.iter().enumerate().filter(|(_, report)| &*report.network == name) {
            let (value, unbiased) = (window.values[number], values_bias_removed[number]);
            bits.push((report.platform.to_string(), report.variable, value.to_bits(), unbiased.to_bits()));
        }
    }
    bits
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_others() {
    let configs = [biased_network("net"), Network::new("polar", satellite())];
    let (once, again, other) = (windows(&configs, 1), windows(&configs, 1), windows(&configs, 2));
    for name in ["net", "polar"] {
        assert_eq!(bits(&once, name), bits(&again, name));
        assert_ne!(bits(&once, name), bits(&other, name));
    }
}

#[test]
fn adding_an_instrument_changes_no_other_whatever_the_order() {
    let alone = windows(&[biased_network("net")], 1);
    let together = windows(&[Network::new("polar", satellite()), biased_network("other"), biased_network("net")], 1);
    assert!(!bits(&alone, "net").is_empty());
    assert_eq!(bits(&alone, "net"), bits(&together, "net"));
    assert_ne!(bits(&together, "net"), bits(&together, "other"), "two networks do not share their random numbers");
    let columns = |name: &str| -> Vec<f64> {
        let reports = together[0].0.reports.iter().filter(|report| &*report.network == name);
        reports.map(|report| report.x_m).collect()
    };
    let (net, other) = (columns("net"), columns("other"));
    assert!(!other.is_empty() && net.iter().all(|x| !other.contains(x)), "nor the places of their stations");
}

#[test]
fn adding_a_bias_changes_no_other() {
    let with_groups = biased_radiosondes();
    let mut with_station = with_groups.clone();
    with_station.biases.insert(
        0,
        StationBias {
            variable: "u".to_owned(),
            scope: BiasScope::Station("random 5".to_owned()),
            process: BiasProcess::constant(1.0),
        },
    );
    let of = |settings| windows(&[with_gaps("net", settings)], 1);
    let (before, after) = (of(with_groups), of(with_station));
    let unchanged = |bits: Vec<(String, usize, u64, u64)>| -> Vec<_> {
        bits.into_iter().filter(|(station, variable, ..)| station != "random 5" || *variable != 1).collect()
    };
    assert_eq!(unchanged(bits(&before, "net")), unchanged(bits(&after, "net")));
    assert_ne!(bits(&before, "net"), bits(&after, "net"));
}
