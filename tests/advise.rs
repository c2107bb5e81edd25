//! `isobar advise`: an analysis reduces the variance as much as was predicted, and impossible requests are refused.

use crate::ahead::{Listener, TRACER, parse};
use crate::common::{isobar, text};
use crate::runs::run_options;
use indexmap::IndexMap;
use isobar::advice::{AdviceError, Advised, Functional, Kind, Request, advise};
use isobar::options::RunOptions;
use isobar::output::Outputs;
use isobar::run::{reopen, run};
use isobar::scenario::Scenario;
use isobar::threshold_warning::Area;
use isobar_assim::{Advice, Unknown};
use isobar_model::{State, forecast::forecast};
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, SparseRows};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const METHODS: &str = "[methods.kf]\nkind = \"kf\"\n[methods.fkf]\nkind = \"fkf\"\nfactors = 6\n\
                       [methods.var]\nkind = \"3dvar\"\n[methods.plain]\nkind = \"kf\"\nbias = \"ignore\"\n";

/// Runs a scenario to its final state; the directory.
fn finished(folder: &Path, scenario: &Scenario) -> PathBuf {
    let options =
        RunOptions { outputs: Outputs::of(["state"]), threads: Some(1), ..run_options(folder, scenario.cycle.count) };
    run(scenario, &options, &mut Listener::default()).unwrap();
    folder.join("run")
}

fn request(method: &str, functional: Functional) -> Request {
    Request {
        method: method.into(),
        functional,
        lead_hours: 0.0,
        grid: [3, 2],
        sigmas: IndexMap::new(),
        comparison_sigma: 0.1,
    }
}

fn mean(at: Area) -> Functional {
    Functional::Mean { variable: "tracer".into(), at }
}

/// The observations of one platform of a window.
fn of_platform(window: &ObservationWindow, platform: &str, state: &State, bias: &[f64]) -> ObservationWindow {
    let all = window.operator.linearize(state, bias);
    let numbers: Vec<usize> = (0..window.len()).filter(|&it| *window.reports[it].platform == *platform).collect();
    let (mut of_state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for &number in &numbers {
        of_state.push_row(all.state.row(number).iter().copied());
        calibration.push_row(all.calibration.row(number).iter().copied());
    }
    let pick = |values: &[f64]| numbers.iter().map(|&number| values[number]).collect::<Vec<f64>>();
    let (values, sigma) = (pick(&window.values), pick(&window.sigma));
    ObservationWindow {
        reports: numbers.iter().map(|&number| window.reports[number].clone()).collect(),
        times: numbers.iter().map(|&number| window.times[number]).collect(),
        values,
        sigma,
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state: of_state, calibration } }),
        ..window.clone()
    }
}

/// The predicted reduction of the variance by the next report of each station is that of its analysis, in the Kalman filter that
/// goes on from the end of the run.
#[test]
fn a_report_reduces_the_variance_as_predicted() {
    let scenario = parse(&[TRACER, METHODS]);
    let folder = tempfile::tempdir().unwrap();
    let from = finished(folder.path(), &scenario);
    let functionals = [mean(Area::Box { x_m: [0.0, 4e5], y_m: [0.0, 3e5] }), Functional::Bias("fixed/tracer/B".into())];
    for functional in functionals {
        let advised = advise(&scenario, &from, &request("kf", functional.clone())).unwrap();
        let mut experiment = reopen(&scenario, &from, "kf").unwrap();
        let mut method = experiment.methods[0].runner.method().boxed_clone();
        let background = method.forecast(experiment.info.window).unwrap();
        let estimate = &background.estimate;
        let window = experiment.observing.observe_checked(Some((&estimate.state).into()), None);
        let combination: Vec<(Unknown, f64)> = match functional {
            Functional::Bias(_) => vec![(Unknown::Parameter(0), 1.0)],
            Functional::Mean { .. } => {
                let cells = (0..3).flat_map(|row| (0..4).map(move |column| 9 * row + column));
                cells.map(|cell| (Unknown::Value(cell), 1.0 / 12.0)).collect()
            }
        };
        let variance = |method: &dyn isobar_assim::Assimilator| {
            Advice::new(method.can().joint_errors.unwrap(), &combination).unwrap().variance()
        };
        let before = variance(&*method);
        assert!((advised.sigma - before.sqrt()).abs() < 1e-12, "{}", advised.functional);
        let reports: Vec<_> = advised.candidates.iter().filter(|it| it.kind == Kind::Report).collect();
        assert_eq!(reports.len(), 9);
        for candidate in reports {
            let platform = candidate.name.strip_prefix("fixed/").unwrap();
            let mut with_it = method.boxed_clone();
            let own = of_platform(&window, platform, &estimate.state, &estimate.calibration);
            assert_eq!(own.len(), 1);
            with_it.analyse(&background, &own).unwrap();
            let after = variance(&*with_it);
            assert!((candidate.reduction - (before - after)).abs() < 1e-12 * before, "{candidate:?}");
            assert!((candidate.sigma - after.sqrt()).abs() < 1e-9);
        }
        assert!(advised.candidates.is_sorted_by(|a, b| a.reduction >= b.reduction));
    }
}

/// Kinds of candidates, and what must be true of them: an exact test point leaves no uncertainty of the sensor's bias; a
/// radiosonde without bias reduces the variance more than the biased one at its place; another method with as good a covariance
/// has about the same standard deviation.
#[test]
fn candidates_are_ranked_as_they_should_be() {
    let scenario = parse(&[TRACER, METHODS]);
    let folder = tempfile::tempdir().unwrap();
    let from = finished(folder.path(), &scenario);
    let bias = Functional::Bias("fixed/tracer/B".into());
    let exact = Request { comparison_sigma: 0.0, ..request("kf", bias.clone()) };
    let advised = advise(&scenario, &from, &exact).unwrap();
    let [first, ..] = &advised.candidates[..] else { panic!("there are candidates") };
    assert_eq!((first.kind, first.name.as_str()), (Kind::TestPoint, "fixed/tracer/B"));
    assert!((first.share - 1.0).abs() < 1e-12 && first.sigma < 1e-6 * advised.sigma);
    let count = |advised: &Advised, kind: Kind| advised.candidates.iter().filter(|it| it.kind == kind).count();
    assert_eq!(Kind::ALL.map(|kind| count(&advised, kind)), [9, 9, 6, 1, 0]);
    let state = mean(Area::Anywhere);
    let advised = advise(&scenario, &from, &request("kf", state.clone())).unwrap();
    for report in advised.candidates.iter().filter(|it| it.kind == Kind::Report) {
        let new = advised.candidates.iter().find(|it| it.kind == Kind::RadiosondeAtStation && it.name == report.name);
        assert!(new.unwrap().reduction >= report.reduction * (1.0 - 1e-12), "{report:?}");
    }
    let fast = advise(&scenario, &from, &request("fkf", state.clone())).unwrap();
    assert!((0.5..2.0).contains(&(fast.sigma / advised.sigma)), "{} and {}", fast.sigma, advised.sigma);
    // A method that does not estimate biases has no sensors to compare.
    let plain = advise(&scenario, &from, &request("plain", state.clone())).unwrap();
    assert_eq!(Kind::ALL.map(|kind| count(&plain, kind)), [9, 9, 6, 0, 0]);
    let worse = Request { sigmas: [("tracer".to_string(), 2.0)].into(), ..request("kf", state) };
    let worse = advise(&scenario, &from, &worse).unwrap();
    let of = |advised: &Advised, name: &str| {
        let own = advised.candidates.iter().find(|it| it.kind == Kind::RadiosondeAtPlace && it.name == name);
        own.unwrap().reduction
    };
    assert!(of(&worse, "place 2,1") < of(&advised, "place 2,1"));
}

/// The mean of a variable in a forecast is the functional Aᵀ v of the analysis.
#[test]
fn a_functional_of_a_forecast_goes_back_by_the_adjoint() {
    let scenario = parse(&[TRACER, METHODS]);
    let folder = tempfile::tempdir().unwrap();
    let from = finished(folder.path(), &scenario);
    let at = Area::Place { x_m: 420e3, y_m: 130e3 };
    let asked = Request { lead_hours: 12.0, ..request("kf", mean(at)) };
    let advised = advise(&scenario, &from, &asked).unwrap();
    assert_eq!(advised.functional, "tracer at x = 420 km, y = 130 km, 12 h later");
    let mut experiment = reopen(&scenario, &from, "kf").unwrap();
    let mut method = experiment.methods[0].runner.method().boxed_clone();
    let estimate = method.forecast(experiment.info.window).unwrap().estimate;
    let model = scenario.model.build(&scenario.grid.grid, scenario.cycle.window).unwrap();
    let steps = 2 * scenario.cycle.window.steps_of(model.time_step()).unwrap();
    // The model is linear: row 13 of A, by unit vectors.
    let layout = &experiment.info.layout;
    let weight = |j: usize| {
        let mut unit = State::from_values(layout, (0..layout.len()).map(|i| f64::from(u8::from(i == j))).collect());
        forecast(&*model, &mut unit, steps).unwrap();
        (Unknown::Value(j), unit.values()[13])
    };
    let combination: Vec<(Unknown, f64)> = (0..layout.len()).map(weight).collect();
    let advice = Advice::new(method.can().joint_errors.unwrap(), &combination).unwrap();
    assert!((advised.sigma / advice.variance().sqrt() - 1.0).abs() < 1e-12);
    let window = experiment.observing.observe_checked(Some((&estimate.state).into()), None);
    let rows = window.operator.linearize(&estimate.state, &estimate.calibration);
    let of_state = rows.state.row(0).iter().map(|&(number, weight)| (Unknown::Value(number), weight));
    let of_bias = rows.calibration.row(0).iter().map(|&(number, weight)| (Unknown::Parameter(number), weight));
    let row = (of_state.chain(of_bias).collect(), window.sigma[0].powi(2));
    let expected = advice.reduction(&[row]).unwrap().unwrap();
    let name = format!("fixed/{}", window.reports[0].platform);
    let own = advised.candidates.iter().find(|it| it.kind == Kind::Report && it.name == name).unwrap();
    assert!((own.reduction / expected - 1.0).abs() < 1e-10, "{} and {expected}", own.reduction);
}

#[test]
fn what_cannot_be_asked_is_refused_by_name() {
    let scenario = parse(&[TRACER, METHODS]);
    let folder = tempfile::tempdir().unwrap();
    let from = finished(folder.path(), &scenario);
    let refused = |scenario: &Scenario, request: &Request| advise(scenario, &from, request).unwrap_err().to_string();
    let everywhere = || mean(Area::Anywhere);
    let error = advise(&scenario, &from, &request("var", everywhere())).unwrap_err();
    assert!(matches!(&error, AdviceError::NoCovariance { name } if name == "var"), "{error}");
    let said = refused(&scenario, &request("kf", Functional::Bias("fixed/tracer/b".into())));
    assert_eq!(said, "there is no bias fixed/tracer/b; did you mean fixed/tracer/B?");
    let said = refused(&scenario, &request("plain", Functional::Bias("fixed/tracer/B".into())));
    assert_eq!(said, "method plain does not estimate the bias fixed/tracer/B");
    let of_h = Functional::Mean { variable: "h".into(), at: Area::Anywhere };
    assert_eq!(refused(&scenario, &request("kf", of_h)), "there is no variable h, but tracer");
    let said = refused(&scenario, &request("kf", mean(Area::Station("fixed/X".into()))));
    assert!(said.starts_with("there is no station \"fixed/X\" in the domain"), "{said}");
    let said = refused(&scenario, &Request { lead_hours: 7.0, ..request("kf", everywhere()) });
    assert_eq!(said, "a lead time of 7 h is not a whole number of cycles of 6 h");
    let other = parse(&[&TRACER.replace("sigma = 0.15", "sigma = 0.16"), METHODS]);
    let said = refused(&other, &request("kf", everywhere()));
    assert!(said.contains("model_error.components"), "{said}");
    // Without a final state there is nothing to ask.
    fs::remove_file(from.join("final_state.bin")).unwrap();
    let said = refused(&scenario, &request("kf", everywhere()));
    assert!(said.contains("it has no final_state.bin"), "{said}");
}

#[test]
fn the_program_prints_tables_and_json() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("s.toml"), [TRACER, METHODS].concat()).unwrap();
    let run = isobar(folder.path(), &["run", "s.toml", "--quiet", "--no-netcdf", "--no-report", "--no-rerun"]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let asked = ["advise", "s.toml", "--from", "out/s", "--method", "kf", "--mean", "tracer", "--at", "0:400,0:300"];
    let output = isobar(folder.path(), &[&asked[..], &["--top", "3"]].concat());
    let said = text(&output.stdout);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(
        said.starts_with("the mean of tracer in x = 0 to 400 km, y = 0 to 300 km, as kf knows it before"),
        "{said}"
    );
    assert!(said.contains("The next reports of existing platforms, the best 3 of 9"), "{said}");
    assert!(said.contains("A new radiosonde without bias at a place, the best 3 of 300"), "{said}");
    let output = isobar(folder.path(), &[&asked[..], &["--json", "--grid", "2x2"]].concat());
    let json: serde_json::Value = serde_json::from_str(&text(&output.stdout)).unwrap();
    assert_eq!(json["candidates"].as_array().unwrap().len(), 9 + 9 + 4 + 1);
    assert!(json["sigma"].as_f64().unwrap() > 0.0 && json["method"] == "kf");
    let refused = |more: &[&str]| {
        let output = isobar(folder.path(), &[&asked[..7], more].concat());
        assert!(!output.status.success());
        text(&output.stderr)
    };
    assert!(refused(&["tracer", "--at", "1000,0"]).contains("outside of the domain, which is 900 × 600 km"));
    assert!(refused(&["tracer", "--at", "somewhere"]).contains("is not a place"));
    assert!(refused(&["tracer", "--grid", "0x3"]).contains("two whole numbers"));
    assert!(refused(&["tracer", "--sigma", "tracer"]).contains("as in h=12"));
}
