//! Biases of recorded observations: whose they are, what they are proportional to, and that their truth is not known.

use crate::common::*;
use isobar_model::{Boundary, Duration, State, Time};
use isobar_obs::{
    BiasProcess, ColumnPredictor, Drift, Evolution, FurtherColumns, InitialBias, Network, ObservationError,
    ObservationFile, ObservingSystem, Parameter, Placement, Projection, RecordedBias, RecordedScope, RecordedSettings,
    Rejection, Unused,
};

/// A station that stays, one that moves, one outside, one that is late, and one of the wind alone.
const TEXT: &str = "cycle,x_m,y_m,variable,value,sigma,platform,country,angle,surface
1,1e5,3e5,h,7,2,fixed,B,10,4
2,1e5,3e5,h,8,2,fixed,B,,5
1,3e5,3e5,h,7,2,ship,A,-20,4
2,4e5,3e5,h,9,2,ship,A,30,4
1,3e5,-3e5,h,7,2,outside,C,0,4
1,5e5,5e5,u,7,2,wind,C,,4
1,6e5,5e5,h,7,2,reference,R,NaN,4
";

fn bias(scope: RecordedScope) -> RecordedBias {
    RecordedBias { variable: "h".into(), scope, predictor: None, process: BiasProcess::constant(3.0) }
}

fn by_angle(scope: RecordedScope) -> RecordedBias {
    let predictor = ColumnPredictor { column: "angle".into(), mean: 5.0, scale: 10.0 };
    RecordedBias { predictor: Some(predictor), ..bias(scope) }
}

fn settings(text: &str, biases: Vec<RecordedBias>) -> RecordedSettings {
    let further =
        FurtherColumns { group_by: Some("country".into()), predictors: vec!["angle".into()], ..Default::default() };
    let observations = ObservationFile::parse_with(text, "file.csv", None, further).unwrap();
    RecordedSettings { biases, ..RecordedSettings::new(observations) }
}

fn built(settings: RecordedSettings) -> ObservingSystem {
    system(&layout(Boundary::Channel), &[Network::new("net", settings)])
}

fn names(system: &ObservingSystem) -> Vec<&str> {
    system.calibration().parameters.iter().map(|it| &*it.name).collect()
}

/// The row of G of each observation that is used.
fn rows(system: &mut ObservingSystem) -> Vec<Vec<(usize, f64)>> {
    let layout = layout(Boundary::Channel);
    let window = system.observe_checked(None, None);
    let none = vec![0.0; system.calibration().len()];
    let jacobian = window.operator.linearize(&State::zeros(&layout), &none);
    (0..window.len()).map(|row| jacobian.calibration.row(row).to_vec()).collect()
}

#[test]
fn there_is_one_for_each_station_each_group_or_all() {
    let references = RecordedSettings {
        reference_groups: vec!["R".into()],
        ..settings(TEXT, vec![bias(RecordedScope::EachStation)])
    };
    let mut of_stations = built(references.clone());
    assert_eq!(names(&of_stations), ["net/h/fixed", "net/h/ship"]);
    assert_eq!(rows(&mut of_stations), [vec![(0, 1.0)], vec![(1, 1.0)], vec![], vec![]]);
    let placements: Vec<Placement> = of_stations.calibration().parameters.iter().map(|it| it.placement).collect();
    assert_eq!(placements, [Placement::Local { x_m: 1e5, y_m: 3e5 }, Placement::Shared], "a ship moves");
    assert_eq!(of_stations.true_calibration(), [None, None]);
    let (_, usage) = of_stations.recorded_use(1..=2).next().unwrap();
    let [of_h] = &usage.biases[..] else { panic!("one bias") };
    assert_eq!((of_h.parameters, &*of_h.without), (2, &["outside".to_string(), "wind".to_string()][..]));
    let expected =
        "bias of h per station: 2 to estimate; none for 2 without an observation of it that can be used: outside, wind";
    assert_eq!(of_h.to_string(), expected);

    let mut of_groups = built(RecordedSettings { biases: vec![bias(RecordedScope::EachGroup)], ..references.clone() });
    assert_eq!(names(&of_groups), ["net/h/A", "net/h/B"]);
    assert_eq!(rows(&mut of_groups), [vec![(1, 1.0)], vec![(0, 1.0)], vec![], vec![]]);

    let both = vec![bias(RecordedScope::All), by_angle(RecordedScope::EachStation)];
    let mut of_all = built(RecordedSettings {
        reference_groups: Vec::new(),
        reference_stations: vec!["reference".into()],
        ..settings(TEXT, both)
    });
    assert_eq!(names(&of_all), ["net/h/all", "net/h/angle/fixed", "net/h/angle/ship"]);
    assert_eq!(rows(&mut of_all), [vec![(0, 1.0), (1, 0.5)], vec![(0, 1.0), (2, -2.5)], vec![], vec![]]);
}

#[test]
fn what_methods_assume_is_what_is_given() {
    let correlation_time = Duration::from_seconds(36 * 3600);
    for (evolution, expected) in [
        (Evolution::Constant, Drift::CONSTANT),
        (Evolution::RandomWalk { sigma_per_sqrt_day: 0.5 }, Drift::RandomWalk { sigma_per_sqrt_day: 0.5 }),
        (Evolution::FirstOrder { correlation_hours: 36.0 }, Drift::FirstOrder { sigma: 3.0, correlation_time }),
    ] {
        let process = BiasProcess { evolution, ..BiasProcess::constant(3.0) };
        let system = built(settings(TEXT, vec![RecordedBias { process, ..bias(RecordedScope::All) }]));
        let [Parameter { unit, sigma_prior, drift, .. }] = &system.calibration().parameters[..] else {
            panic!("one parameter")
        };
        assert_eq!((&**unit, *sigma_prior, *drift), ("m", 3.0, expected));
    }
}

#[test]
fn an_observation_without_its_predictor_is_rejected_and_counted() {
    let mut system = built(RecordedSettings {
        reference_stations: vec!["reference".into()],
        ..settings(TEXT, vec![by_angle(RecordedScope::All)])
    });
    assert_eq!(names(&system), ["net/h/angle"]);
    // A reference has no bias, and another variable neither: neither needs the predictor.
    assert_eq!(rows(&mut system), [vec![(0, 0.5)], vec![(0, -2.5)], vec![], vec![]]);
    let second = system.observe_checked(None, None);
    assert_eq!((second.len(), second.values[0]), (1, 9.0));
    let [missing] = &second.aside.unused[..] else { panic!("one is not used") };
    assert_eq!((missing.value, missing.why), (8.0, Unused::Rejected(Rejection::NoPredictor)));
    let layout = layout(Boundary::Channel);
    assert_eq!(second.aside.departures(&State::zeros(&layout), &[0.0]), [None], "its bias is not known");
    let (_, usage) = system.recorded_use(1..=2).next().unwrap();
    assert_eq!((usage.usable, usage.no_predictor, usage.outside), (5, 1, 1));
    assert!(usage.to_string().contains("1 without a predictor of their bias"), "{usage}");
    // A row that is there twice is used with its predictor, whichever comes first.
    let twice =
        TEXT.replace("2,1e5,3e5,h,8,2,fixed,B,,5\n", "2,1e5,3e5,h,8,2,fixed,B,,5\n2,1e5,3e5,h,8,2,fixed,B,10,5\n");
    let mut system = built(settings(&twice.replace("NaN", "1"), vec![by_angle(RecordedScope::All)]));
    rows(&mut system);
    assert_eq!(rows(&mut system), [vec![(0, 0.5)], vec![(0, 2.5)]]);
}

/// With biases b of the components to the east and to the north, the turned wind is that without them and h(0, b).
#[test]
fn biases_of_winds_are_those_of_the_components_that_were_reported() {
    let (projection, layout) =
        (Projection::centered(&layout(Boundary::Channel).grid, 40.0, -100.0), layout(Boundary::Channel));
    let observed = |shift: [f64; 2], with_bias: bool| {
        let text = format!(
            "cycle,latitude_deg,longitude_deg,variable,value,sigma,id\n1,42,-88,u,{},2,A\n1,42,-88,v,{},2,A\n1,38,-110,u,{},2,B\n",
            20.0 + shift[0],
            -7.0 + shift[1],
            11.0 + shift[0],
        );
        let of = |variable: &str| RecordedBias { variable: variable.into(), ..bias(RecordedScope::All) };
        let biases = if with_bias { vec![of("u"), of("v")] } else { Vec::new() };
        let observations = ObservationFile::parse(&text, "winds.csv", None).unwrap();
        let network = Network::new("net", RecordedSettings { biases, ..RecordedSettings::new(observations) });
        let mut system = try_system(&layout, Some(&projection), &[network]).unwrap();
        system.observe_checked(None, None)
    };
    let (plain, biased) = (observed([0.0, 0.0], false), observed([3.0, -2.0], true));
    assert_eq!(plain.len(), 3);
    let of_biases = biased.operator.simulate(&State::zeros(&layout), &[3.0, -2.0]);
    for ((plain, biased), effect) in plain.values.iter().zip(&biased.values).zip(&of_biases) {
        assert!((biased - plain - effect).abs() < 1e-13, "{biased} - {plain} is not {effect}");
    }
    let rows = biased.operator.linearize(&State::zeros(&layout), &[0.0, 0.0]).calibration;
    let (sin, cos) = projection.north(42.0, -88.0).sin_cos();
    assert!(sin.abs() > 0.1);
    assert_eq!(
        [rows.row(0), rows.row(1), rows.row(2)],
        [&[(0, cos), (1, sin)][..], &[(0, -sin), (1, cos)], &[(0, 1.0)]]
    );
}

#[track_caller]
fn refused(setting: &str, expected: &str, settings: RecordedSettings) {
    let network = Network::new("net", settings);
    let error: ObservationError = match try_system(&layout(Boundary::Channel), None, &[network]) {
        Err(error) => error,
        Ok(_) => panic!("this must not be accepted"),
    };
    let message = error.to_string();
    assert!(message.contains(expected), "{message}");
    assert_eq!((error.network(), error.setting()), (Some("net"), Some(setting)), "{message}");
}

#[test]
fn mistakes_are_named() {
    let with = |bias: RecordedBias| settings(TEXT, vec![bias]);
    let per_station = || bias(RecordedScope::EachStation);
    let without_id = TEXT.replace("platform", "remark");
    refused(
        "biases",
        "file.csv has no column `id`, without which there is no bias per station",
        settings(&without_id, vec![per_station()]),
    );
    let plain = RecordedSettings::new(ObservationFile::parse(TEXT, "file.csv", None).unwrap());
    let biases = vec![bias(RecordedScope::EachGroup)];
    refused("biases", "no column of groups that is read", RecordedSettings { biases, ..plain.clone() });
    let biases = vec![by_angle(RecordedScope::All)];
    refused("biases.column", "names `angle`, which is not known", RecordedSettings { biases, ..plain });
    refused("biases.variable", "names `q`", with(RecordedBias { variable: "q".into(), ..per_station() }));
    refused(
        "biases",
        "has `net/h/all` twice",
        settings(TEXT, vec![bias(RecordedScope::All), bias(RecordedScope::All)]),
    );
    let reference_stations = vec!["nobody".to_string()];
    let expected = "reference_stations names `nobody`, which is not in file.csv; valid: `fixed`, `outside`";
    refused("reference_stations", expected, RecordedSettings { reference_stations, ..with(per_station()) });
    let reference_groups = vec!["A".to_string(), "A".into()];
    refused("reference_groups", "has `A` twice", RecordedSettings { reference_groups, ..with(per_station()) });
    let reference_groups = ["A", "B", "C", "R"].map(String::from).to_vec();
    let expected = "the bias of `h` applies to nothing, since every station is a reference";
    refused("biases", expected, RecordedSettings { reference_groups, ..with(per_station()) });
    for process in [
        BiasProcess { initial: InitialBias::Given { value: 1.0 }, ..BiasProcess::constant(1.0) },
        BiasProcess { evolution: Evolution::Jump { at_hours: 1.0, size: 1.0 }, ..BiasProcess::constant(1.0) },
        BiasProcess { known: true, ..BiasProcess::constant(1.0) },
    ] {
        refused("biases", "nothing is known of the true bias of `h`", with(RecordedBias { process, ..per_station() }));
    }
    for (setting, predictor) in [
        ("biases.scale", ColumnPredictor { column: "angle".into(), mean: 0.0, scale: 0.0 }),
        ("biases.mean", ColumnPredictor { column: "angle".into(), mean: f64::NAN, scale: 1.0 }),
        ("biases.column", ColumnPredictor { column: "value".into(), mean: 0.0, scale: 1.0 }),
    ] {
        refused(setting, "", with(RecordedBias { predictor: Some(predictor), ..per_station() }));
    }
    let passive = Network { assimilate: false, ..Network::new("net", with(per_station())) };
    let (window, start) = (Duration::from_seconds(3600), Time::from_seconds(0));
    let refused = ObservingSystem::new(&layout(Boundary::Channel), None, &[passive], 1, window, start);
    assert!(refused.is_err_and(|error| error.setting() == Some("assimilate")));
}

#[test]
fn further_columns_are_read_as_the_values_are() {
    let further = || FurtherColumns { group_by: None, predictors: vec!["angle".into()], ..Default::default() };
    let parse = |text: &str, markers: Option<&[f64]>| ObservationFile::parse_with(text, "t.csv", markers, further());
    let head = "cycle,x_m,y_m,value,angle,remark";
    let text = format!("{head}\n1,2,3,4,5,x\n1,2,3,4,NA,x\n1,2,3,4,-999,x\n");
    let file = parse(&text, Some(&[-999.0])).unwrap();
    let predictors: Vec<_> = file.records().iter().map(|record| record.predictors[0]).collect();
    assert_eq!((predictors, file.missing()), (vec![Some(5.0), None, None], 0));
    let message = |text: &str| parse(text, None).unwrap_err().to_string();
    assert!(
        message(&text).contains("line 4: `angle` is -999, which usually marks a missing value"),
        "{}",
        message(&text)
    );
    let words = message(&format!("{head}\n1,2,3,4,steep,x\n"));
    assert!(words.contains("line 2: `angle` is `steep`, but must be a finite number"), "{words}");
    let without = message("cycle,x_m,y_m,value\n1,2,3,4\n");
    assert!(without.contains("the header has no column `angle`; it has `cycle`"), "{without}");
    let by = |text: &str| {
        let further = FurtherColumns { group_by: Some("group".into()), ..Default::default() };
        ObservationFile::parse_with(text, "t.csv", None, further)
    };
    let groups = by("cycle,x_m,y_m,value,GROUP\n1,2,3,4,a\n").unwrap();
    assert_eq!(groups.records()[0].group.as_deref(), Some("a"));
    let empty = by("cycle,x_m,y_m,value,group\n1,2,3,4,\n").unwrap_err().to_string();
    assert!(empty.contains("the column `group` is empty, but must be a name"), "{empty}");
    // What nobody asks for may say anything.
    assert!(ObservationFile::parse("cycle,x_m,y_m,value,group,angle\n1,2,3,4,,steep\n", "t.csv", None).is_ok());
}
