//! Networks of stations: what they report, with which errors and biases, and which reports are missing.

use crate::common::*;
use isobar_model::{Boundary, State};
use isobar_obs::{
    BiasProcess, BiasScope, Evolution, InitialBias, Network, ObservedVariable, ObservingSystem, Placement,
    RadiosondeSettings, Schedule, Station, StationBias, StationFile, StationSource,
};

fn bias(variable: &str, scope: BiasScope, process: BiasProcess) -> StationBias {
    StationBias { variable: variable.to_owned(), scope, process }
}

fn given(value: f64) -> BiasProcess {
    BiasProcess { initial: InitialBias::Given { value }, ..BiasProcess::constant(1.0) }
}

#[test]
fn stations_interpolate_each_variable_at_its_own_points() {
    let layout = layout(Boundary::Channel);
    let field = |variable: usize, x: f64, y: f64| (variable + 1) as f64 * (3.0 + 2e-6 * x - 5e-6 * y);
    let truth = state_of(&layout, field);
    let mut config = radiosondes(200);
    config.edge_margin_m = 1e5;
    config.variables.push(ObservedVariable::new("tracer", 0.1));
    let mut system = system(&layout, &[Network::new("net", config)]);
    let observed = system.observe(&truth);
    assert_eq!(observed.len(), 800);
    for (value, report) in observed.operator.simulate(&truth, &[]).iter().zip(&observed.reports) {
        let expected = field(report.variable, report.x_m, report.y_m);
        assert!((value - expected).abs() < 1e-11, "{report:?}: {value}, not {expected}");
    }
}

#[test]
fn a_network_serves_a_layout_with_one_variable() {
    let mut layout = (*layout(Boundary::Periodic)).clone();
    layout.variables.drain(..3);
    let layout = std::sync::Arc::new(layout);
    let mut config = radiosondes(10);
    config.variables = vec![ObservedVariable::new("tracer", 0.1)];
    let observed = system(&layout, &[Network::new("net", config)]).observe(&random_state(&layout, 1));
    assert_eq!(
        (observed.len(), &*observed.reports[0].network, &*observed.reports[3].platform),
        (10, "net", "random 4")
    );
}

#[test]
fn errors_are_independent_draws_of_the_given_size() {
    let layout = layout(Boundary::Channel);
    let truth = random_state(&layout, 2);
    let mut system = system(&layout, &[Network::new("net", radiosondes(300))]);
    let mut errors: Vec<Vec<f64>> = vec![Vec::new(); 3];
    for _ in 0..20 {
        let observed = system.observe(&truth);
        assert_eq!(observed.values, system.values_bias_removed());
        for (number, exact) in observed.operator.simulate(&truth, &[]).iter().enumerate() {
            let variable = observed.reports[number].variable;
            assert_eq!(observed.sigma[number], [12.0, 2.2, 2.2][variable]);
            errors[variable].push((observed.values[number] - exact) / observed.sigma[number]);
        }
    }
    for (variable, errors) in errors.iter().enumerate() {
        assert_eq!(errors.len(), 6000);
        assert_standard_normal(errors, &format!("variable {variable}"));
    }
    let product = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let correlations = [
        ("h with u", product(&errors[0], &errors[1])),
        ("u with v", product(&errors[1], &errors[2])),
        ("one station with the next", product(&errors[0], &errors[0][1..])),
        ("one cycle with the next", product(&errors[0], &errors[0][300..])),
    ];
    for (what, products) in correlations {
        // The product of two independent N(0, 1) has mean 0 and variance 1.
        let (mean, _) = moments(&products);
        assert!(mean.abs() < 5.0 / (products.len() as f64).sqrt(), "{what}: {mean}");
    }
}

#[test]
fn a_group_has_one_bias_in_one_variable_and_the_reference_none() {
    let layout = layout(Boundary::Channel);
    let mut config = radiosondes(30);
    config.reference_groups = vec!["b".to_owned()];
    config.biases = vec![
        bias("h", BiasScope::EachGroup, BiasProcess::constant(20.0)),
        bias("u", BiasScope::Group("c".to_owned()), given(4.0)),
    ];
    let mut system = system(&layout, &[Network::new("net", config)]);
    let names: Vec<_> = system.calibration().parameters.iter().map(|parameter| parameter.name.as_str()).collect();
    assert_eq!(names, ["net/h/a", "net/h/c", "net/u/c"]);
    for (parameter, (sigma, unit)) in
        system.calibration().parameters.iter().zip([(20.0, "m"), (20.0, "m"), (4.0, "m s-1")])
    {
        assert_eq!((parameter.sigma_prior, parameter.drift), (sigma, isobar_obs::Drift::CONSTANT));
        assert_eq!((parameter.unit.as_str(), parameter.placement), (unit, Placement::Shared));
    }
    let truth = random_state(&layout, 3);
    let observed = system.observe(&truth);
    let c = true_biases(&system);
    let [on_a, on_c, wind] = c[..] else { panic!("three parameters") };
    assert!(wind == 4.0 && on_a != on_c);
    for (number, report) in observed.reports.iter().enumerate() {
        let station = system.stations().iter().find(|station| station.name == report.platform).unwrap();
        assert_eq!(station.is_reference, &*station.group == "b");
        let expected = match (&*station.group, report.variable) {
            ("a", 0) => on_a,
            ("c", 0) => on_c,
            ("c", 1) => wind,
            _ => 0.0,
        };
        let found = observed.values[number] - system.values_bias_removed()[number];
        assert!((found - expected).abs() < 1e-12, "{report:?}: {found}, not {expected}");
    }
    let jacobian = observed.operator.linearize(&truth, &[]);
    let effect = observed.operator.simulate(&State::zeros(&layout), &c);
    assert_eq!(jacobian.calibration.rows(), effect.len());
    for (number, effect) in effect.iter().enumerate() {
        let found = observed.values[number] - system.values_bias_removed()[number];
        assert!((effect - found).abs() < 1e-12, "the operator has the same biases as the data");
    }
}

#[test]
fn a_stations_own_bias_belongs_to_its_place() {
    let layout = layout(Boundary::Channel);
    let mut config = radiosondes(9);
    config.reference_groups = vec!["a".to_owned()];
    config.biases = vec![bias("h", BiasScope::EachStation, BiasProcess::constant(5.0))];
    config.biases.push(bias("v", BiasScope::Station("random 2".to_owned()), given(-1.0)));
    let system = system(&layout, &[Network::new("net", config)]);
    let parameters = &system.calibration().parameters;
    assert_eq!(parameters.len(), 6 + 1);
    assert_eq!((parameters[0].name.as_str(), parameters[6].name.as_str()), ("net/h/random 2", "net/v/random 2"));
    let station = &system.stations()[1];
    for parameter in [&parameters[0], &parameters[6]] {
        assert_eq!(parameter.placement, Placement::Local { x_m: station.x_m, y_m: station.y_m });
    }
}

#[test]
fn known_biases_are_not_in_the_data_nor_in_the_calibration() {
    let layout = layout(Boundary::Channel);
    let truth = random_state(&layout, 4);
    let mut config = radiosondes(12);
    let plain = system(&layout, &[Network::new("net", config.clone())]).observe(&truth);
    config.biases = vec![bias("h", BiasScope::EachGroup, BiasProcess { known: true, ..given(50.0) })];
    let mut system = system(&layout, &[Network::new("net", config)]);
    let observed = system.observe(&truth);
    assert!(system.calibration().is_empty());
    assert_eq!((&*observed.values, system.values_bias_removed()), (&*plain.values, &*plain.values));
    let known: Vec<_> = system.known_biases().map(|(parameter, value)| (parameter.name.clone(), value)).collect();
    assert_eq!(known, ["a", "b", "c"].map(|group| (format!("net/h/{group}"), 50.0)));
}

#[test]
fn biases_evolve_in_the_data() {
    let layout = layout(Boundary::Channel);
    let mut config = radiosondes(3);
    let jump = BiasProcess { evolution: Evolution::Jump { at_hours: 12.0, size: 30.0 }, ..given(1.0) };
    let walk = BiasProcess { evolution: Evolution::RandomWalk { sigma_per_sqrt_day: 2.0 }, ..given(1.0) };
    config.biases =
        vec![bias("h", BiasScope::Group("a".to_owned()), jump), bias("h", BiasScope::Group("b".to_owned()), walk)];
    let mut system = system(&layout, &[Network::new("net", config)]);
    let truth = State::zeros(&layout);
    let mut jumps = Vec::new();
    let mut walks = vec![1.0];
    for _ in 0..4 {
        let observed = system.observe(&truth);
        let bias = |number: usize| observed.values[number] - system.values_bias_removed()[number];
        jumps.push((bias(0) * 1e6).round() / 1e6);
        walks.push(bias(3));
        assert!((bias(3) - true_biases(&system)[1]).abs() < 1e-12);
    }
    assert_eq!(jumps, [1.0, 31.0, 31.0, 31.0], "the jump at 12 h comes with the second cycle of six hours");
    assert!(walks.windows(2).all(|pair| pair[0] != pair[1]), "{walks:?}");
}

#[test]
fn whole_reports_are_missing_at_the_given_rate_and_the_others_unchanged() {
    let layout = layout(Boundary::Channel);
    let truth = random_state(&layout, 5);
    let with_rate =
        |missing_rate| system(&layout, &[Network { missing_rate, ..Network::new("net", radiosondes(250)) }]);
    let (mut complete, mut holes, mut nothing) = (with_rate(0.0), with_rate(0.2), with_rate(1.0));
    let mut present = 0;
    for _ in 0..20 {
        let all = complete.observe(&truth);
        let some = holes.observe(&truth);
        assert_eq!(all.len(), 750);
        assert!(nothing.observe(&truth).is_empty());
        assert_eq!(some.len() % 3, 0, "a report is missing as a whole");
        present += some.len() / 3;
        for (number, report) in some.reports.iter().enumerate() {
            let other = all.reports.iter().position(|other| other == report).unwrap();
            assert_eq!(some.values[number].to_bits(), all.values[other].to_bits());
        }
    }
    // 5000 reports: the standard error of the rate is √(0.2 · 0.8 / 5000).
    let rate = 1.0 - present as f64 / 5000.0;
    assert!((rate - 0.2).abs() < 5.0 * (0.16f64 / 5000.0).sqrt(), "{rate}");
}

#[test]
fn stations_report_only_in_the_cycles_of_their_schedule() {
    let layout = layout(Boundary::Channel);
    let schedule = Schedule { every_cycles: 2, first_cycle: 2 };
    let mut system = system(&layout, &[Network { schedule, ..Network::new("net", radiosondes(5)) }]);
    let truth = random_state(&layout, 6);
    let windows: Vec<_> = (0..4).map(|_| system.observe(&truth)).collect();
    assert_eq!(windows.iter().map(|window| window.len()).collect::<Vec<_>>(), [0, 15, 0, 15]);
    assert_eq!(windows.iter().map(|window| window.cycle).collect::<Vec<_>>(), [1, 2, 3, 4]);
    assert_eq!(windows[3].time.seconds(), 4 * WINDOW.seconds());
    assert_ne!(windows[1].values, windows[3].values);
}

/// A network that begins later makes its first reports then, and takes no room before.
#[test]
fn stations_may_begin_to_report_later() {
    let layout = layout(Boundary::Channel);
    let of = |first_cycle: usize| {
        let schedule = Schedule { every_cycles: 2, first_cycle };
        system(&layout, &[Network { schedule, ..Network::new("net", radiosondes(5)) }])
    };
    let truth = random_state(&layout, 6);
    let windows = |mut system: ObservingSystem| -> Vec<_> { (0..8).map(|_| system.observe(&truth)).collect() };
    let (at_once, later) = (windows(of(1)), windows(of(6)));
    assert_eq!(later.iter().map(|window| window.len()).collect::<Vec<_>>(), [0, 0, 0, 0, 0, 15, 0, 15]);
    assert_eq!((&later[5].values, &later[7].values), (&at_once[0].values, &at_once[2].values));
    let most = |cycles| of(6).most_observations(cycles);
    assert_eq!([most(1..=5), most(1..=6), most(7..=7), most(7..=8)], [0, 15, 0, 15]);
}

#[test]
fn stations_outside_are_left_out_and_told() {
    let layout = layout(Boundary::Channel);
    let text = "id,x_m,y_m,name,type\nin,1e6,7e5,Inside,A\nsouth,1e6,-1,South,A\nnorth,1e6,1.44e6,North,B\n\
                edge,5e4,7e5,Edge,B\ntwin,1e6,7e5,,A\n";
    let stations = StationFile::parse(text, "five.csv").unwrap();
    let source = StationSource::File { stations, group_by: Some("type".to_owned()), groups: Vec::new() };
    let mut config = RadiosondeSettings::new(source);
    let counts = |config: &RadiosondeSettings| {
        let system = system(&layout, &[Network::new("net", config.clone())]);
        (system.stations().len(), system.left_out().len())
    };
    assert_eq!(counts(&config), (3, 2));
    config.edge_margin_m = 1e5;
    assert_eq!(counts(&config), (2, 3));
    let mut system = system(&layout, &[Network::new("net", config)]);
    let left_out: Vec<_> = system.left_out().iter().map(|station| (&*station.long_name, station.line)).collect();
    assert_eq!(left_out, [("South", Some(3)), ("North", Some(4)), ("Edge", Some(5))]);
    assert_eq!(system.left_out()[1].place_m, Some((1e6, 1.44e6)));
    assert_eq!((&*system.stations()[0].long_name, &*system.stations()[1].long_name), ("Inside", "twin"));
    // Two stations at exactly the same place are two stations.
    let observed = system.observe(&random_state(&layout, 7));
    let jacobian = observed.operator.linearize(&random_state(&layout, 7), &[]);
    assert_eq!(jacobian.state.row(0), jacobian.state.row(3));
    assert_ne!(observed.values[0], observed.values[3]);
}

#[test]
fn regular_and_random_stations_fill_the_domain_and_belong_to_groups_in_turn() {
    let layout = layout(Boundary::Channel);
    let groups = vec!["a".to_owned(), "b".to_owned()];
    let regular = StationSource::Regular { columns: 3, rows: 2, groups };
    let configs = [
        Network::new("regular", RadiosondeSettings::new(regular)),
        Network::new("random", RadiosondeSettings::new(random_stations(2000, &[]))),
    ];
    let system = system(&layout, &configs);
    let (regular, random) = system.stations().split_at(6);
    let places: Vec<_> = regular.iter().map(|station| (station.x_m, station.y_m)).collect();
    let (x, y) = ([400e3, 1200e3, 2000e3], [360e3, 1080e3]);
    assert_eq!(places, [(x[0], y[0]), (x[1], y[0]), (x[2], y[0]), (x[0], y[1]), (x[1], y[1]), (x[2], y[1])]);
    assert_eq!(regular.iter().map(|station| &*station.group).collect::<Vec<_>>(), ["a", "b", "a", "b", "a", "b"]);
    assert!(random.iter().all(|station| &*station.group == "all"));
    // A uniform variable on [-1, 1] has variance 1/3; its mean has the standard error √(1/3n).
    for along in [|station: &Station| station.x_m / 1.2e6 - 1.0, |station: &Station| station.y_m / 0.72e6 - 1.0] {
        let (mean, square) = moments(&random.iter().map(along).collect::<Vec<_>>());
        assert!(mean.abs() < 5.0 / 6000f64.sqrt(), "{mean}");
        // The square's own variance is 1/5 − 1/9.
        assert!((square - 1.0 / 3.0).abs() < 5.0 * ((0.2 - 1.0 / 9.0) / 2000f64).sqrt(), "{square}");
    }
}
