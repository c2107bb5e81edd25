//! Observations before the end of a window: when they are made, what they see, and when they are refused.

use crate::common::*;
use isobar_model::{Boundary, Duration, State, Time};
use isobar_obs::instrument::recorded::RecordedTimes;
use isobar_obs::quality::Reference;
use isobar_obs::{
    AirMassBias, BiasProcess, ErrorCorrelation, ErrorCorrelationKind, Faults, Network, ObservationFile,
    ObservationWindow, ObservedVariable, QualityControl, RecordedSettings, Rejection, SatelliteSettings,
    SensorComparison, TimedObservations, WindowStates,
};

/// True states at the hours of the window, each with another sign and size.
fn hourly() -> Vec<State> {
    (0..=6).map(|hour| random_state(&layout(Boundary::Channel), 10 + hour)).collect()
}

fn observed(network: Network) -> ObservationWindow {
    let states = hourly();
    system(&layout(Boundary::Channel), &[network]).observe_checked(Some(WindowStates::new(&states, WINDOW)), None)
}

/// How many hours before the end of the window each was made.
fn hours_before(window: &ObservationWindow) -> Vec<i64> {
    window.times.iter().map(|&time| (window.time - time).seconds() / 3600).collect()
}

/// The same errors and places at one time and at several: the values differ by what the state did since.
#[track_caller]
fn differ_by_the_states(network: Network, times: usize) -> Vec<i64> {
    let (early, late) = (observed(Network { times_per_window: times, ..network.clone() }), observed(network));
    assert_eq!(early.reports, late.reports);
    let (states, before) = (hourly(), hours_before(&early));
    let rows = late.operator.linearize(&states[6], &[]).state;
    for (row, &hours) in before.iter().enumerate() {
        let seen = |hour: i64| rows.row_dot(row, states[hour as usize].values());
        let difference = early.values[row] - late.values[row] - (seen(6 - hours) - seen(6));
        assert!(difference.abs() < 1e-12, "{row}: {difference:e}");
    }
    let lags: Vec<i64> = early.operator.within_window().unwrap().lags.iter().map(|it| it.seconds() / 3600).collect();
    assert_eq!(lags, before);
    assert!(late.operator.within_window().is_none() && late.times.iter().all(|&time| time == late.time));
    before
}

fn still_satellite() -> SatelliteSettings {
    SatelliteSettings { biases: Vec::new(), ..satellite() }
}

#[test]
fn a_satellite_scans_in_the_course_of_the_window() {
    let before = differ_by_the_states(Network::new("polar", still_satellite()), 3);
    // 18 lines of 11 positions, in thirds.
    let expected: Vec<i64> = (0..18 * 11).map(|number| [4, 2, 0][number / (6 * 11)]).collect();
    assert_eq!(before, expected);
}

#[test]
fn stations_take_turns_with_all_that_they_observe() {
    let mut sondes = radiosondes(7);
    sondes.biases.clear();
    let variables = sondes.variables.len();
    let before = differ_by_the_states(Network::new("net", sondes), 6);
    let expected: Vec<i64> = (0..7).flat_map(|station| vec![[5, 4, 3, 2, 1, 0][station % 6]; variables]).collect();
    assert_eq!(before, expected);
}

#[test]
fn missing_reports_change_no_other_time() {
    let network = Network { times_per_window: 6, ..Network::new("net", radiosondes(20)) };
    let all = observed(network.clone());
    let some = observed(Network { missing_rate: 0.4, ..network });
    assert!(some.len() < all.len());
    for (report, time) in some.reports.iter().zip(&some.times) {
        let same = all.reports.iter().position(|other| other == report).unwrap();
        assert_eq!(*time, all.times[same]);
    }
}

#[test]
fn a_late_report_of_any_time_is_late() {
    let faults = Faults { late_rate: 0.3, duplicate_rate: 0.2, ..Faults::NONE };
    let network = Network { times_per_window: 6, faults, ..Network::new("net", radiosondes(40)) };
    let window = observed(network);
    let count = |of: Rejection| window.aside.rejected().filter(|(_, why)| *why == of).count();
    assert!(count(Rejection::Late) > 20 && count(Rejection::Duplicate) > 10);
    assert!(hours_before(&window).iter().all(|hours| (0..6).contains(hours)));
}

#[test]
fn errors_of_different_times_are_independent() {
    let correlation = ErrorCorrelation { kind: ErrorCorrelationKind::ByDistance, length_m: 1e6, assumed_length_m: 1e6 };
    let network = Network { error_correlation: Some(correlation), ..Network::new("net", radiosondes(8)) };
    for times in [1, 2] {
        let window = observed(Network { times_per_window: times, ..network.clone() });
        let r = window.error_regression.covariance(&window.sigma);
        for i in 0..window.len() {
            for j in 0..i {
                let together = window.times[i] == window.times[j];
                let same = window.reports[i].variable == window.reports[j].variable;
                assert_eq!(r[i][j] != 0.0, together && same, "{times}: {i} {j}");
            }
        }
    }
}

/// What has moved since is no gross error.
#[test]
fn values_are_checked_against_the_reference_of_their_times() {
    let layout = layout(Boundary::Channel);
    let at = |level: f64| state_of(&layout, |_, x, _| level + (x / 4e5).sin());
    let states: Vec<State> = (0..=6).map(|hour| at(300.0 * f64::from(hour))).collect();
    let through = WindowStates::new(&states, WINDOW);
    let control = QualityControl { length_m: 4e5, limit: 4.0 };
    let checked = |states: WindowStates<'_>| {
        let mut polar = still_satellite();
        polar.variable = ObservedVariable::new("h", 0.1);
        let network = Network { times_per_window: 6, ..Network::new("polar", polar) };
        let reference = Reference { states, sigma: &[0.5, 0.5, 0.5, 0.5] };
        let mut system = system(&layout, &[network]);
        system.observe_checked(Some(through), Some((&control, reference))).aside.unused.len()
    };
    assert_eq!(checked(through), 0);
    assert!(checked((&states[6]).into()) > 50);
}

fn recorded(times: RecordedTimes, text: &str) -> ObservationWindow {
    let observations = ObservationFile::parse(text, "file.csv", None).unwrap();
    let settings = RecordedSettings { times, ..RecordedSettings::new(observations) };
    system(&layout(Boundary::Channel), &[Network::new("net", settings)]).observe_checked(None, None)
}

#[test]
fn recorded_observations_of_a_window_are_used_at_their_times() {
    let line = |time: &str, id: &str, value: f64| format!("1970-01-01T{time}Z,1e5,3e5,h,{value},1,{id}\n");
    let text = [
        "time,x_m,y_m,variable,value,sigma,id\n".to_string(),
        line("00:00:00", "start", 1.0),
        line("00:00:01", "first", 2.0),
        line("03:20:00", "buoy", 3.0),
        line("05:00:00", "buoy", 4.0),
        line("05:00:00", "buoy", 4.0),
        line("06:00:00", "buoy", 5.0),
        line("06:00:01", "next", 6.0),
    ]
    .concat();
    let window = recorded(RecordedTimes::Window, &text);
    assert_eq!(window.values, [2.0, 3.0, 4.0, 5.0]);
    let lags: Vec<i64> = window.operator.within_window().unwrap().lags.iter().map(|it| it.seconds()).collect();
    assert_eq!(lags, [6 * 3600 - 1, 9600, 3600, 0]);
    assert_eq!(window.times[1], Time::from_seconds(12_000));
    let rejected: Vec<Rejection> = window.aside.rejected().map(|(_, why)| why).collect();
    assert_eq!(rejected, [Rejection::Duplicate]);
    // Within a tolerance they count as if they were of the end.
    let window = recorded(RecordedTimes::End(Duration::from_seconds(3600)), &text);
    assert_eq!(window.values, [4.0, 6.0]);
    assert!(!window.is_within_window());
}

#[test]
fn times_that_cannot_be_are_errors() {
    let error = |network: Network| {
        try_system(&layout(Boundary::Channel), None, &[network]).err().expect("must be refused").to_string()
    };
    let sondes = || Network::new("net", radiosondes(3));
    for (times, expected) in [(7, "7"), (0, "0")] {
        let message = error(Network { times_per_window: times, ..sondes() });
        let expected = format!("net: times_per_window is {expected}, but must be a divisor of the window's 21600 s");
        assert_eq!(message, expected);
    }
    let text = "cycle,x_m,y_m,variable,value,sigma\n1,1e5,3e5,h,7,2\n";
    let file = RecordedSettings::new(ObservationFile::parse(text, "file.csv", None).unwrap());
    let message = error(Network { times_per_window: 2, ..Network::new("net", file) });
    assert!(message.contains("recorded observations have times of their own"), "{message}");
    let bias = AirMassBias { variable: "h".into(), mean: 0.0, scale: 1.0, process: BiasProcess::constant(1.0) };
    let polar = SatelliteSettings { air_mass_biases: vec![bias], ..satellite() };
    let message = error(Network { times_per_window: 2, ..Network::new("polar", polar) });
    assert!(message.contains("a bias depends on the state"), "{message}");
}

/// Comparisons of sensors are of the end of the window; the observations keep their times and what is seen of the background then.
#[test]
fn observations_keep_their_times_above_comparisons() {
    let network = Network { times_per_window: 3, ..Network::new("net", radiosondes(7)) };
    let state = &hourly()[6];
    let window = observed(network);
    let shift = |within: TimedObservations<'_>| Ok::<_, ()>((0..within.lags.len()).map(|row| row as f64).collect());
    let window = window.at_appropriate_time(shift).unwrap().into_owned();
    let calibration: Vec<f64> = (0..50).map(f64::from).collect();
    let comparison = SensorComparison { parameter: 1, other: Some(0), value: 2.0, sigma: 0.5 };
    let window = ObservationWindow { comparisons: vec![comparison], ..window };
    let below = window.with_comparisons_below(&layout(Boundary::Channel).grid);
    let (own, all) = (window.operator.within_window().unwrap(), below.operator.within_window().unwrap());
    assert_eq!((&all.lags[..window.len()], &all.shift[..window.len()]), (own.lags, own.shift));
    assert_eq!((all.lags[window.len()].seconds(), all.shift[window.len()]), (0, 0.0));
    let mut expected = window.operator.simulate(state, &calibration);
    expected.push(1.0);
    assert_eq!(below.operator.simulate(state, &calibration), expected);
}
