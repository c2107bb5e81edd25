//! The examples: a method, an instrument and a model that are made outside of isobar.

#[path = "../src/examples/own_instrument.rs"]
mod own_instrument;
#[path = "../src/examples/own_method.rs"]
mod own_method;
#[path = "../src/examples/own_model.rs"]
mod own_model;

use isobar::batch::seeds::SeedsSummary;
use isobar::event::Event;
use isobar::options::{CheckpointPolicy, RunOptions};
use isobar::output::{OUTPUTS, Outputs, Sink, SinkError};
use isobar::progress::{Progress, RunsProgress};
use isobar::run::experiment::Experiment;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar_model::forecast::forecast;
use isobar_model::testing::check_contract;
use isobar_model::{Duration, Layout, Leapfrog, State, Stepped, TimeScheme, shallow_water};
use isobar_obs::Network;
use isobar_obs::testing::check_instrument;
use std::path::Path;

fn quiet() -> Progress {
    Progress::new(true)
}

/// A listener that ends the run in cycle 10.
struct EndEarly;

impl Sink for EndEarly {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Observed { window, .. } if window.cycle == 10 => {
                Err(SinkError { path: "nothing".into(), reason: "this is the end".into() })
            }
            _ => Ok(()),
        }
    }
}

/// All scores of a method but those of cost.
fn scores<'a>(summary: &'a Summary, method: &str) -> Vec<(&'a str, f64)> {
    let values = summary.methods[method].values.iter().map(|(key, value)| (key.as_str(), *value));
    values.filter(|(key, _)| ["rmse", "spread", "innovation"].iter().any(|it| key.starts_with(it))).collect()
}

#[test]
fn a_method_from_outside_beats_the_free_run_and_goes_on_after_an_interruption() {
    let (directory, scenario) = (tempfile::tempdir().unwrap(), own_method::scenario());
    let experiment = own_method::experiment(&scenario);
    let at = |name: &str| RunOptions { threads: Some(2), ..RunOptions::new(directory.path().join(name)) };
    let summary = experiment.run(&at("whole"), &mut quiet()).unwrap();
    assert_eq!(summary.methods.keys().collect::<Vec<_>>(), ["free", "etkf", "denkf"]);
    let score = |method: &str, key: &str| summary.methods[method].values[key];
    for variable in ["h", "u", "v"] {
        let key = format!("rmse_analysis.{variable}");
        let (free, denkf) = (score("free", &key), score("denkf", &key));
        assert!(denkf.is_finite() && denkf < 0.5 * free, "{key}: {denkf} against {free}");
    }
    let chi2 = score("denkf", "innovation_chi2");
    assert!((0.7..1.3).contains(&chi2), "{chi2}");

    let checkpoints = Some(CheckpointPolicy { minutes: None, cycles: Some(4) });
    let options = RunOptions { checkpoints, ..at("interrupted") };
    experiment.run(&options, &mut EndEarly).unwrap_err();
    let options = RunOptions { resume: true, ..options };
    let without = isobar::run::run(&scenario, &options, &mut quiet()).unwrap_err().to_string();
    assert!(without.contains("other methods or networks were added"), "{without}");
    let resumed = experiment.run(&options, &mut quiet()).unwrap();
    assert!(scores(&summary, "denkf").len() > 6);
    assert_eq!(scores(&resumed, "denkf"), scores(&summary, "denkf"));

    let options = RunOptions { cycles: Some(6), threads: Some(1), ..at("batch") };
    let runs = experiment.run_seeds(&options, &[3, 4, 5], &RunsProgress::new(true, "", "seeds", 3, 1)).unwrap();
    let means = SeedsSummary::new(runs, "etkf").unwrap();
    assert_eq!(means.seeds, [3, 4, 5]);
    assert!(means.methods["denkf"]["rmse_analysis.h"].difference.unwrap().interval.is_some());
}

#[test]
fn names_that_are_taken_or_not_valid_are_refused() {
    let scenario = own_method::scenario();
    let refused = |name: &str| {
        let builder = Experiment::builder(&scenario)
            .method(name, "", |_| -> Result<isobar_assim::free::FreeRun, _> { panic!("the name is checked first") });
        builder.build(&RunOptions::new("nowhere")).err().unwrap().to_string()
    };
    for (name, reason) in [("etkf", "two methods"), ("ETKF", "in case only"), ("my method", "cannot be the name")] {
        let error = refused(name);
        assert!(error.contains(reason), "{error}");
    }
    for (name, reason) in [("sondes", "two networks"), ("a/b", "cannot be the name of a network")] {
        let builder = Experiment::builder(&scenario).network(Network::new(name, own_instrument::Anemometers(2)));
        let error = builder.build(&RunOptions::new("nowhere")).err().unwrap().to_string();
        assert!(error.contains(reason), "{error}");
    }
}

#[test]
fn an_instrument_that_is_not_linear_keeps_the_contract_and_its_bias_is_found() {
    let layout = shallow_water::layout(isobar_model::Grid {
        nx: 8,
        ny: 6,
        dx_m: 1e5,
        dy_m: 1e5,
        boundary: isobar_model::Boundary::Channel,
    });
    check_instrument(&Network::new("masts", own_instrument::Anemometers(4)), &layout, 3).unwrap();

    let directory = tempfile::tempdir().unwrap();
    let options = RunOptions { threads: Some(2), ..RunOptions::new(directory.path().join("run")) };
    let summary = own_instrument::run(&options, &mut quiet()).unwrap();
    let score = |method: &str, key: &str| summary.methods[method].values[key];
    for variable in ["u", "v"] {
        let key = format!("rmse_analysis.{variable}");
        assert!(score("fkf", &key) < 0.6 * score("free", &key), "{key}");
    }
    // 25 masts in 20 cycles: σ/√500 at best, beside the prior of 2 m/s.
    assert!(score("fkf", "bias_rmse") < 0.3, "{}", score("fkf", "bias_rmse"));
    let chi2 = score("fkf", "innovation_chi2");
    assert!((0.7..1.3).contains(&chi2), "{chi2}");
}

#[test]
fn lorenz_96_has_the_published_error_and_all_outputs() {
    let directory = tempfile::tempdir().unwrap();
    let outputs = Outputs::of(OUTPUTS.iter().map(|output| output.name).filter(|name| *name != "live"));
    let few = RunOptions { cycles: Some(210), outputs, ..RunOptions::new(directory.path().join("few")) };
    own_model::run(&few, &mut quiet()).unwrap();

    let options = RunOptions { threads: Some(1), ..RunOptions::new(directory.path().join("run")) };
    let values = &own_model::run(&options, &mut quiet()).unwrap().methods["etkf"].values;
    assert!((0.17..0.23).contains(&values["rmse_analysis.x"]), "{}", values["rmse_analysis.x"]);
    assert!((0.8..1.2).contains(&values["innovation_chi2"]), "{}", values["innovation_chi2"]);
}

#[test]
fn a_model_from_outside_keeps_the_contract() {
    let (layout, step) = (Layout::ring(40, "x", "1"), Duration::from_seconds(21_600));
    let mut x = State::from_values(&layout, (0..40).map(|i| 8.0 + f64::from(i).sin()).collect());
    let model = Stepped::new(own_model::Lorenz96(layout.clone()), step, TimeScheme::Rk4).unwrap();
    forecast(&model, &mut x, 360).unwrap();
    check_contract(&model, &x);
    let leapfrog = Leapfrog::new(own_model::Lorenz96(layout), step, 0.1).unwrap();
    check_contract(&leapfrog, &leapfrog.start(&x));
}

#[test]
fn a_scenario_with_a_given_model_has_no_tables_of_it() {
    let layout = Layout::ring(40, "x", "1");
    let parse = |text: &str, background: State| {
        let model = own_model::Lorenz96(layout.clone());
        let model = Stepped::new(model, Duration::from_seconds(21_600), TimeScheme::Rk4).unwrap();
        Scenario::parse_with_model(Path::new("mine.toml"), text, model, background).unwrap_err().to_string()
    };
    let start = "title = 't'\nphenomenon = 'p'\nsource = 's'\nseed = 1\nstart = 2026-01-01T00:00:00Z\n";
    let rest = "background_error = { components = [{ kind = 'white', variable = 'x', sigma = 1 }] }\n\
                cycle = { count = 1, window_hours = 6 }\nmethods = { free = { kind = 'free' } }\n";
    for (tables, reason) in [
        ("model = { kind = \"advection\" }\n", "[model] is given by code"),
        ("initial = { kind = \"rest\" }\n", "[initial] is given by code"),
        ("truth = { model = { forcing = 9 } }\n", "has no keys"),
    ] {
        let error = parse(&format!("{start}{rest}{tables}"), State::zeros(&layout));
        assert!(error.contains(reason), "{error}");
    }
    let other = parse(start, State::zeros(&Layout::ring(41, "x", "1")));
    assert!(other.contains("not a state of the given model"), "{other}");
}
