//! Warnings of forecasts ahead: what is probable, what comes of it, and where it is said.

use crate::ahead::{Listener, TRACER, listen, parse};
use crate::common::{isobar, one_line, place, text};
use crate::runs::run_options;
use isobar::options::RunOptions;
use isobar::output::Outputs;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::diagnostics::probability_below;
use netcdf_reader::NcFile;
use std::fs;

const FORECAST: &str = "[forecast]\nlead_hours = 36\nevery_hours = 12\n";

const METHODS: &str = "[methods.kf]\nkind = \"kf\"\n[methods.letkf]\nkind = \"letkf\"\nmembers = 8\n\
                       localization_radius_km = 400\n[methods.free]\nkind = \"free\"\n";

fn warning(name: &str, rest: &str) -> String {
    format!("[[warnings]]\nname = \"{name}\"\nvariable = \"tracer\"\nprobability = 0.4\n{rest}\n")
}

/// Every probability is that of the claimed normal distribution, when the forecast is made and when its time comes; what
/// came is what the truth says.
#[test]
fn probabilities_and_outcomes_are_those_of_forecast_and_truth() {
    let threshold = 0.8;
    let point = warning("point", "above = 0.8\nat = { x_km = 420, y_km = 130 }");
    let area = warning("area", "below = -0.8\nat = { x_km = [200, 500], y_km = [0, 300] }");
    let scenario = parse(&[TRACER, FORECAST, &point, &area, METHODS]);
    let (listener, summary) = listen(&scenario);
    // The tracer is at the centres of cells of 100 km, 9 in a row: cell (1, 4); and cells 2 to 4 of rows 0 to 2.
    let in_box: Vec<usize> = (0..3).flat_map(|row| (2..5).map(move |column| 9 * row + column)).collect();
    let mut compared = 0;
    for (&(method, from, lead), (forecast, _)) in &listener.forecasts {
        let sigma = |cell: usize| forecast.state_spread.as_ref().map(|spread| spread[cell]);
        let probability = |beyond: f64, sigma: Option<f64>| match sigma {
            Some(sigma) => probability_below(beyond / sigma),
            None => f64::from(u8::from(beyond > 0.0)),
        };
        let value = forecast.state.values();
        let at_point = probability(value[13] - threshold, sigma(13));
        let in_area = in_box.iter().map(|&cell| probability(-threshold - value[cell], sigma(cell)));
        let in_area = in_area.fold(0.0, f64::max);
        let [first, second] = &listener.warned[&(method, from, lead)][..] else { panic!("there are two warnings") };
        assert_eq!((first.probability, second.probability), (at_point, in_area));
        assert_eq!((first.issued, second.issued), (at_point >= 0.4, in_area >= 0.4));
        let truth = listener.truth[&(from + lead)].values();
        assert_eq!(first.occurred, Some(truth[13] > threshold));
        assert_eq!(second.occurred, Some(in_box.iter().any(|&cell| truth[cell] < -threshold)));
        if lead > 0 {
            let outlook = &listener.outlooks[&(method, from)].leads;
            let (_, own) = outlook.iter().find(|(cycles, _)| *cycles == lead).unwrap();
            assert_eq!(own, &[at_point, in_area]);
        }
        compared += 1;
    }
    assert_eq!(compared, 3 * (12 + 10 + 8 + 6));
    for (name, deterministic) in [("kf", false), ("letkf", false), ("free", true)] {
        let scores = &summary.methods[name];
        let briers: Vec<f64> = scores.warnings.iter().map(|it| it.ahead.brier.unwrap().score.value).collect();
        assert_eq!(scores.values["brier_score"], (briers[0] + briers[1]) / 2.0, "{name}");
        for (number, own) in scores.warnings.iter().enumerate() {
            assert_eq!((own.deterministic, own.ahead.cases), (deterministic, 10 + 8 + 6), "{name}");
            let method = scenario.methods.get_index_of(name).unwrap();
            let cases = listener.warned.iter().filter(|((it, _, lead), _)| *it == method && *lead > 0);
            let hits = cases.filter(|(_, all)| all[number].issued && all[number].occurred == Some(true)).count();
            assert_eq!(own.ahead.hits, hits, "{name}");
        }
    }
}

/// Over many seeds an event comes about as often as a Kalman filter says, where all is linear and the covariances are right.
#[test]
fn over_many_seeds_events_are_as_frequent_as_was_said() {
    let places = [(50, 50), (350, 250), (650, 450), (850, 150)];
    let at = |(number, (x, y)): (usize, &(i32, i32))| {
        let side = if number % 2 == 0 { "above = 0.5" } else { "below = -0.3" };
        warning(&format!("w{number}"), &format!("{side}\nat = {{ x_km = {x}, y_km = {y} }}"))
    };
    let warnings: String = places.iter().enumerate().map(at).collect();
    let kf = "[methods.kf]\nkind = \"kf\"\n";
    let text = [TRACER, FORECAST, &warnings, kf].concat();
    let (mut sums, mut cases, mut brier, mut expected) = (Vec::new(), 0_u32, 0.0, 0.0);
    for seed in 1..=120 {
        let (listener, _) = listen(&parse(&[&text.replace("seed = 3", &format!("seed = {seed}"))]));
        let mut sum = 0.0;
        for it in listener.warned.iter().filter(|((_, _, lead), _)| *lead > 0).flat_map(|(_, all)| all) {
            let (p, o) = (it.probability, f64::from(u8::from(it.occurred.unwrap())));
            (sum, cases) = (sum + o - p, cases + 1);
            (brier, expected) = (brier + (p - o).powi(2), expected + p * (1.0 - p));
        }
        sums.push(sum);
    }
    // Cases of one seed depend on each other, seeds do not.
    let count = sums.len() as f64;
    let mean = sums.iter().sum::<f64>() / count;
    let variance = sums.iter().map(|sum| (sum - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let t = mean / (variance / count).sqrt();
    assert!(t.abs() < 3.0, "{t} standard deviations: {mean} of {} cases a seed", f64::from(cases) / count);
    // The mean of (p − o)² is that of p (1 − p) if the probabilities are right, and these are neither all 0 nor all ½.
    let (brier, expected) = (brier / f64::from(cases), expected / f64::from(cases));
    assert!((brier / expected - 1.0).abs() < 0.05 && (0.02..0.2).contains(&expected), "{brier} and {expected}");
}

/// Without a truth the observations of the valid time say what came, passive ones if there are any.
#[test]
fn without_a_truth_observations_say_what_came() {
    let folder = tempfile::tempdir().unwrap();
    let mut rows = "cycle,x_m,y_m,variable,value,sigma,id\n".to_string();
    for cycle in 1..=14 {
        rows += &format!("{cycle},450e3,150e3,tracer,{},0.2,A\n", if cycle % 2 == 0 { 1.5 } else { 0.2 });
    }
    fs::write(folder.path().join("observations.csv"), rows).unwrap();
    let there = warning("there", "above = 1\nat = { x_km = 450, y_km = 150 }");
    let elsewhere = warning("elsewhere", "above = 1\nat = { x_km = 50, y_km = 50 }");
    let (world, _) = TRACER.split_once("[networks.fixed]").unwrap();
    let network = "[networks.recorded]\nkind = \"file\"\nfile = \"observations.csv\"\n";
    let all = [world, network, FORECAST, &there, &elsewhere, METHODS].concat();
    let path = folder.path().join("s.toml");
    for passive in ["", "assimilate = false\n"] {
        let text = all.replace(network, &format!("{network}{passive}"));
        let (listener, summary) = listen(&Scenario::parse(&path, &text).unwrap());
        for (&(_, from, lead), cases) in &listener.warned {
            assert_eq!(cases[0].occurred, Some((from + lead) % 2 == 0));
            assert_eq!(cases[1].occurred, None);
        }
        let [first, second] = &summary.methods["kf"].warnings[..] else { panic!("there are two") };
        assert_eq!((first.ahead.cases, first.ahead.occurred), (24, 12));
        assert_eq!((second.ahead.cases, second.ahead.brier), (0, None));
        assert!(!summary.methods["kf"].values.contains_key("brier_score"));
    }
}

#[test]
fn files_page_and_terminal_hold_the_warnings() {
    let area = warning("much", "above = 0.1");
    let never = warning("never", "above = 30");
    let scenario = parse(&[TRACER, FORECAST, &area, &never, METHODS]);
    let folder = tempfile::tempdir().unwrap();
    let outputs = Outputs::of(["netcdf", "report", "state"]);
    let options = RunOptions { outputs, ..run_options(folder.path(), scenario.cycle.count) };
    let mut listener = Listener::default();
    let summary = run(&scenario, &options, &mut listener).unwrap();
    let said: Vec<&str> = listener.warnings.iter().map(String::as_str).collect();
    assert_eq!(said.len(), 2, "{said:?}");
    assert!(said[0].starts_with("warnings.never: tracer above 30 anywhere almost never occurs: the first"), "{said:?}");
    assert!(said[1].starts_with("warnings.never: the event never occurred in 24 cases, so that"), "{said:?}");
    let out = folder.path().join("run");
    let csv = fs::read_to_string(out.join("warnings.csv")).unwrap();
    // With a final state forecasts go on beyond the end: 12 starts, each with 4 lead times.
    assert_eq!(csv.lines().count(), 1 + 2 * 3 * 12 * 4);
    let beyond: Vec<&str> = csv.lines().filter(|line| line.starts_with("much,kf,14,") && line.ends_with(',')).collect();
    assert_eq!(beyond.len(), 3, "{beyond:?}");
    let outlook = &listener.outlooks[&(0, 14)].leads;
    assert!(beyond[2].contains(&format!(",36,2026-01-20T00:00:00Z,{},", outlook[2].1[0])), "{beyond:?}");
    let scores = fs::read_to_string(out.join("warning_scores.csv")).unwrap();
    let brier = summary.methods["kf"].warnings[0].ahead.brier.unwrap();
    let all = scores.lines().find(|line| line.starts_with("much,kf,,24,")).unwrap();
    assert!(all.contains(&format!(",{},", brier.score.value)), "{all}");
    let file = NcFile::open(out.join("kf_forecast.nc")).unwrap();
    let numbers = |name: &str| -> Vec<f64> { file.read_variable::<f64>(name).unwrap().iter().copied().collect() };
    let (probability, field) = (numbers("warning_much"), numbers("warning_much_field"));
    for (number, lead) in [0, 2, 4, 6].into_iter().enumerate() {
        assert_eq!(probability[number], listener.warned[&(0, 8, lead)][0].probability);
        let own = &field[54 * number..][..54];
        assert_eq!(own.iter().copied().fold(0.0, f64::max), probability[number]);
    }
    let leads = &summary.methods["kf"].warnings[0].leads;
    let expected: Vec<f64> = leads.iter().map(|lead| lead.scores.brier.unwrap().score.value).collect();
    assert_eq!(numbers("warning_much_brier_score"), expected);
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("tracer above 0.1") && page.contains("Scores of much by lead time"));
    let reliability = std::fs::read_to_string(out.join("figures/warning_much_reliability.svg")).unwrap();
    assert!(reliability.contains("no skill"), "{reliability}");
    assert!(out.join("figures/warning_much_sharpness.svg").is_file());
    assert!(out.join("figures/warning_much_map_01_kf.svg").is_file());
    let table = isobar::tables::scores::on_terminal(&summary, &[("tracer", "1")], 100);
    assert!(table.contains("Warning much, over all lead times after the analysis: the event occurred in"), "{table}");
    assert!(table.contains("Probability of never ahead of the analysis of cycle 14"), "{table}");
    assert!(table.contains("Without a claimed spread, the probability of an event is 0 or 1: free"), "{table}");
    let json: serde_json::Value = serde_json::from_str(&fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    assert_eq!(json["methods"]["kf"]["warnings"][0]["ahead"]["cases"], 24);
}

/// What cannot be a warning is refused with its place.
#[test]
fn faults_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let good = warning("much", "above = 1\nat = \"anywhere\"");
    let case = |from: &str, to: &str, at: &str, wanted: &str| {
        let text = [TRACER, FORECAST, &good, METHODS].concat().replace(from, to);
        fs::write(folder.path().join("s.toml"), &text).unwrap();
        let output = isobar(folder.path(), &["check", "s.toml"]);
        let said = self::text(&output.stderr);
        assert!(!output.status.success(), "{to}");
        assert!(one_line(&said).contains(wanted), "{to}:\n{said}");
        let place = place(&text, at);
        let line = place.split(':').next().unwrap();
        assert!(said.contains(&format!("s.toml:{line}:")), "{to}, line {line}:\n{said}");
    };
    case(FORECAST, "", "[[warnings]]", "there is no [forecast] that could warn of `much`");
    case("above = 1\n", "", "[[warnings]]", "a warning needs `above` or `below`");
    case("above = 1\n", "above = 1\nbelow = 2\n", "below", "stands beside `above`");
    case("variable = \"tracer\"\nprobability", "variable = \"h\"\nprobability", "\"h\"", "cannot be \"h\"");
    case("probability = 0.4", "probability = 40", "40", "but must be a number from 0.001 to 0.999");
    case("name = \"much\"", "name = \"a b\"", "\"a b\"", "cannot be the name of a warning");
    case("\"anywhere\"", "\"here\"", "\"here\"", "cannot be \"here\"");
    case(
        "\"anywhere\"",
        "\"fixed/nowhere\"",
        "\"fixed/nowhere\"",
        "there is no station \"fixed/nowhere\" in the domain;",
    );
    case(
        "\"anywhere\"",
        "{ x_km = 900, y_km = 5 }",
        "900, y",
        "is 900, outside of the domain, which is 900 km long there",
    );
    case("\"anywhere\"", "{ x_km = [0, 1000], y_km = [0, 5] }", "1000]", "is 1000, outside of the domain");
    case("\"anywhere\"", "{ x_km = [50, 20], y_km = [0, 5] }", "[50, 20]", "goes from 50 to 20");
    case("\"anywhere\"", "{ x_km = [51, 99], y_km = [0, 5] }", "{ x_km = [51", "the box holds no grid point of tracer");
    case("\"anywhere\"", "{ x_km = [50, 99] }", "{ x_km = [50", "`y_km` is missing");
    case(
        &good,
        &good.repeat(2),
        "\"much\"\nvariable = \"tracer\"\nprobability = 0.4\nabove = 1\nat = \"anywhere\"\n[methods",
        "there are two warnings `much`",
    );
}
