//! Passive networks: compared with every estimate, and part of nothing else.

use crate::common::{layout, random_state};
use isobar_model::{Boundary, Duration, Time};
use isobar_obs::quality::Reference;
use isobar_obs::{
    Faults, Network, ObservationFile, ObservingSystem, QualityControl, RadiosondeSettings, RecordedSettings, Rejection,
    StationBias, StationSource, Unused,
};

const CONTROL: QualityControl = QualityControl { length_m: 500e3, limit: isobar_obs::quality::LIMIT };

fn system(networks: &[Network]) -> ObservingSystem {
    let layout = layout(Boundary::Channel);
    ObservingSystem::new(&layout, None, networks, 7, Duration::from_seconds(3600), Time::from_seconds(0)).unwrap()
}

fn sondes() -> RadiosondeSettings {
    RadiosondeSettings::new(StationSource::Random { count: 60, groups: Vec::new() })
}

#[test]
fn others_are_observed_and_judged_as_if_it_were_not_there() {
    let faults = Faults { gross_error_rate: 0.1, ..Faults::NONE };
    let used = Network { faults, ..Network::new("used", sondes()) };
    // Half of them are wrong, so that they would be a scale of their own if they were asked.
    let faults = Faults { gross_error_rate: 0.5, duplicate_rate: 0.1, ..Faults::NONE };
    let passive = Network { faults, assimilate: false, ..Network::new("passive", sondes()) };
    let layout = layout(Boundary::Channel);
    let (truth, reference) = (random_state(&layout, 1), random_state(&layout, 2));
    let [mut alone, mut together] = [vec![used.clone()], vec![passive, used]].map(|networks| system(&networks));
    for _ in 0..3 {
        let reference = Reference { states: (&reference).into(), sigma: &[1.0, 1.0, 1.0] };
        let [alone, together] = [&mut alone, &mut together]
            .map(|it| it.observe_checked(Some((&truth).into()), Some((&CONTROL, reference))));
        assert_eq!(
            (&alone.reports, &alone.values, &alone.sigma),
            (&together.reports, &together.values, &together.sigma)
        );
        assert_eq!(alone.aside.checks, together.aside.checks);
        let (c, none) = (vec![0.0; 0], vec![0.0; 0]);
        assert_eq!(alone.operator.simulate(&truth, &c), together.operator.simulate(&truth, &none));
        let of_used: Vec<_> = together.aside.unused.iter().filter(|it| &*it.report.network == "used").collect();
        assert_eq!(alone.aside.unused.iter().collect::<Vec<_>>(), of_used);
        // It is judged itself, by the others.
        let rejected = |wanted| {
            together.aside.rejected().filter(|it| &*it.0.report.network == "passive" && it.1 == wanted).count()
        };
        assert!(rejected(Rejection::Duplicate) > 5 && together.aside.passive().count() > 60);
        assert!(together.aside.passive().all(|(_, it)| it.check.is_some()));
    }
}

#[test]
fn its_departures_are_those_of_any_estimate() {
    let layout = layout(Boundary::Channel);
    let mut system = system(&[Network { assimilate: false, ..Network::new("passive", sondes()) }]);
    let (truth, other) = (random_state(&layout, 1), random_state(&layout, 2));
    let window = system.observe(&truth);
    assert!(window.is_empty() && window.aside.unused.iter().all(|it| it.why == Unused::Passive));
    assert_eq!(window.aside.unused.len(), system.values_bias_removed().len());
    let of_truth = window.aside.departures(&truth, &[]);
    for (it, departure) in window.aside.unused.iter().zip(&of_truth) {
        assert!(departure.unwrap().abs() < 6.0 * it.sigma, "random errors alone are left");
    }
    assert_ne!(of_truth, window.aside.departures(&other, &[]));
    let values: Vec<f64> = window.aside.unused.iter().map(|it| it.value + 1.0).collect();
    let shifted = window.with_values(&values).aside.departures(&truth, &[]);
    assert!(of_truth.iter().zip(shifted).all(|(a, b)| (b.unwrap() - a.unwrap() - 1.0).abs() < 1e-9));
}

#[test]
fn what_cannot_be_compared_has_no_departure() {
    let text = "cycle,x_m,y_m,variable,value,sigma,id\n1,1e5,1e5,h,10,1,inside\n1,-1e9,1e5,h,10,1,outside\n1,1e5,-1e9,h,10,1,south\n";
    let recorded = RecordedSettings::new(ObservationFile::parse(text, "file.csv", None).unwrap());
    let mut system = system(&[Network::new("file", recorded)]);
    let window = system.observe_checked(None, None);
    let departures = window.aside.departures(&random_state(&layout(Boundary::Channel), 1), &[]);
    assert_eq!(window.values, [10.0, 10.0], "x goes round in a channel");
    assert_eq!((window.aside.unused.len(), departures), (1, vec![None]));
}

#[test]
fn unknown_biases_of_a_passive_network_are_refused_and_known_ones_are_not() {
    let with_bias = |known: bool| {
        let process = isobar_obs::BiasProcess { known, ..isobar_obs::BiasProcess::constant(5.0) };
        let bias = StationBias { scope: isobar_obs::BiasScope::EachGroup, variable: "h".into(), process };
        let sondes = RadiosondeSettings { biases: vec![bias], ..sondes() };
        let network = Network { assimilate: false, ..Network::new("passive", sondes) };
        let layout = layout(Boundary::Channel);
        let (window, start) = (Duration::from_seconds(3600), Time::from_seconds(0));
        ObservingSystem::new(&layout, None, &[network], 7, window, start).map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(with_bias(true), Ok(()));
    let message = with_bias(false).unwrap_err();
    assert!(message.starts_with("passive: assimilate is false, but the network has unknown biases"), "{message}");
}

/// Stations that are withheld report what they would, and are compared as passive ones; the others are what is left.
#[test]
fn withheld_stations_are_passive_and_the_same_in_every_cycle() {
    let layout = layout(Boundary::Channel);
    let truth = random_state(&layout, 1);
    let process = isobar_obs::BiasProcess::constant(5.0);
    let bias = StationBias { scope: isobar_obs::BiasScope::EachGroup, variable: "h".into(), process };
    let groups = ["a", "b", "c"].map(String::from).to_vec();
    let stations = StationSource::Random { count: 60, groups };
    let sondes = RadiosondeSettings { biases: vec![bias], ..RadiosondeSettings::new(stations) };
    let network = Network::new("sondes", sondes);
    let withheld = Network { withhold: 0.2, ..network.clone() };
    let [mut all, mut some] = [network, withheld].map(|network| system(&[network]));
    let names: Vec<_> = some.withheld().flat_map(|(_, it)| it.names.iter().cloned()).collect();
    assert_eq!((names.len(), some.withheld().next().unwrap().1.of), (12, 60));
    assert_eq!(all.withheld().count(), 0);
    let is_withheld = |platform: &std::sync::Arc<str>| names.contains(platform);
    for _ in 0..3 {
        let (of_all, of_some) = (all.observe(&truth), some.observe(&truth));
        let both = of_all.reports.iter().zip(&of_all.values);
        let (out, left): (Vec<_>, Vec<_>) = both.partition(|(report, _)| is_withheld(&report.platform));
        assert_eq!((out.len(), left.len()), (36, 144));
        assert!(of_some.reports.iter().zip(&of_some.values).eq(left));
        assert!(of_some.aside.unused.iter().map(|it| (&it.report, &it.value)).eq(out));
        assert!(of_some.aside.unused.iter().all(|it| it.why == Unused::Passive));
    }
}

#[test]
fn a_share_that_cannot_be_withheld_is_refused() {
    let message = |network: Network| {
        let layout = layout(Boundary::Channel);
        let (window, start) = (Duration::from_seconds(3600), Time::from_seconds(0));
        ObservingSystem::new(&layout, None, &[network], 7, window, start).err().expect("it is refused").to_string()
    };
    let network = || Network { withhold: 0.2, ..Network::new("net", sondes()) };
    let process = isobar_obs::BiasProcess::constant(5.0);
    let bias = StationBias { scope: isobar_obs::BiasScope::EachStation, variable: "h".into(), process };
    let biased = Network::new("net", RadiosondeSettings { biases: vec![bias], ..sondes() });
    let kind = isobar_obs::ErrorCorrelationKind::ByDistance;
    let correlation = isobar_obs::ErrorCorrelation { kind, length_m: 1e5, assumed_length_m: 1e5 };
    for (network, wanted) in [
        (Network { assimilate: false, ..network() }, "withhold has no effect"),
        (Network { withhold: 1.0, ..network() }, "withhold is 1, but must be a share from 0 to below 1"),
        (
            Network { withhold: 0.2, ..biased },
            "withhold is 0.2, which is 12 of 60 stations, but only 0 can be withheld",
        ),
        (Network { withhold: 0.2, ..Network::new("net", crate::common::satellite()) }, "the network has no stations"),
        (Network { error_correlation: Some(correlation), ..network() }, "whose errors are correlated with those"),
    ] {
        let message = message(network);
        assert!(message.starts_with("net: ") && message.contains(wanted), "{message}");
    }
}

/// Of a file those are withheld that could be used, by their `id`.
#[test]
fn stations_of_a_file_are_withheld_too() {
    let rows: String = (1..=2)
        .flat_map(|cycle| (0..10).map(move |it| format!("{cycle},{}e5,3e5,h,{it},1,s{it}\n", it + 1)))
        .chain(["1,1e5,-9e9,h,1,1,outside\n".to_string()])
        .collect();
    let text = format!("cycle,x_m,y_m,variable,value,sigma,id\n{rows}");
    let recorded = RecordedSettings::new(ObservationFile::parse(&text, "file.csv", None).unwrap());
    let mut system = system(&[Network { withhold: 0.3, ..Network::new("file", recorded) }]);
    let withheld = system.withheld().next().unwrap().1.clone();
    assert_eq!((withheld.names.len(), withheld.of), (3, 10));
    for _ in 0..2 {
        let window = system.observe_checked(None, None);
        let passive: Vec<_> = window.aside.passive().map(|(_, it)| it.report.platform.clone()).collect();
        assert!(passive.iter().eq(&withheld.names) && window.len() == 7, "{passive:?}");
    }
}
