//! Exact performance: the Kalman filter is the best, knows what it is worth, and Monte Carlo comes to the same.

use crate::common::{CARRIED_TRACER, VALID, isobar, text};
use isobar::event::Event;
use isobar::exact::{ExactOptions, ExactSummary, exact};
use isobar::output::{Sink, SinkError};
use isobar::scenario::Scenario;
use isobar::scores::statistics::independent_mean;
use std::fs;
use std::path::Path;

/// A tracer with biased stations, all whose statistics the methods know.
fn tracer() -> String {
    CARRIED_TRACER.replace("count = 14", "count = 12") + METHODS
}

const WALK: &str = "{ kind = \"random_walk\", sigma_per_sqrt_day = 0.1 }";
const AR1: &str = "{ kind = \"ar1\", correlation_hours = 36 }";

const METHODS: &str = r#"evolution = { kind = "random_walk", sigma_per_sqrt_day = 0.1 }
[methods.kf]
kind = "kf"
[methods.serial]
kind = "serial_kf"
[methods.fkf]
kind = "fkf"
blocks = "cell"
factors = 6
[methods.blind]
kind = "kf"
bias = "ignore"
[methods.var]
kind = "3dvar"
covariance_scale = 0.4
tolerance = 1e-10
max_iterations = 500
[methods.oi]
kind = "optimal_interpolation"
covariance_scale = 0.4
[methods.free]
kind = "free"
[methods.known]
kind = "kf"
bias = "known"
"#;

fn parse(text: &str) -> Scenario {
    Scenario::parse(Path::new("tracer.toml"), text).unwrap()
}

fn summary(text: &str) -> ExactSummary {
    exact(&parse(text), &ExactOptions::default()).unwrap()
}

#[test]
fn the_kalman_filter_is_the_best_and_knows_what_it_is_worth() {
    [WALK, AR1].into_iter().for_each(|evolution| the_kalman_filter_is_the_best(&tracer().replace(WALK, evolution)));
}

fn the_kalman_filter_is_the_best(text: &str) {
    let summary = summary(text);
    let of = |name: &str| &summary.methods[name];
    let kf = of("kf");
    let spread = kf["spread_analysis.tracer"];
    assert!((kf["rmse_analysis.tracer"] / spread - 1.0).abs() < 1e-9, "{kf:?}");
    assert!((kf["bias_rmse"] / kf["bias_spread"] - 1.0).abs() < 1e-9, "{kf:?}");
    for name in ["serial", "fkf", "blind", "var", "oi", "free"] {
        assert!(of(name)["rmse_analysis.tracer"] > kf["rmse_analysis.tracer"] * (1.0 - 1e-9), "{name}: {:?}", of(name));
        if let Some(bias) = of(name).get("bias_rmse") {
            assert!(*bias > kf["bias_rmse"] * (1.0 - 1e-9), "{name}");
        }
    }
    assert!((of("serial")["rmse_analysis.tracer"] / kf["rmse_analysis.tracer"] - 1.0).abs() < 1e-9);
    // To the accuracy of the minimiser.
    assert!((of("var")["rmse_analysis.tracer"] / of("oi")["rmse_analysis.tracer"] - 1.0).abs() < 1e-6);
    assert!(of("known")["rmse_analysis.tracer"] < kf["rmse_analysis.tracer"] && !of("known").contains_key("bias_rmse"));
    // Somebody who knows of no bias claims too little.
    assert!(of("blind")["rmse_analysis.tracer"] > 1.2 * of("blind")["spread_analysis.tracer"]);
    assert!(of("free")["rmse_analysis.tracer"] > 2.0 * kf["rmse_analysis.tracer"]);
}

#[test]
fn a_filter_that_assumes_wrong_statistics_is_worse_than_one_that_knows() {
    let wrong = tracer().replace("[cycle]", "[truth]\nmodel_error_scale = 4\n[cycle]");
    let (right, wrong) = (summary(&tracer()), summary(&wrong));
    let kf = &wrong.methods["kf"];
    assert!(kf["rmse_analysis.tracer"] > 1.2 * kf["spread_analysis.tracer"], "{kf:?}");
    assert_eq!(kf["spread_analysis.tracer"], right.methods["kf"]["spread_analysis.tracer"]);
}

/// A bias that is given and jumps is no random one: it is a mean error, which the filter takes out over time.
#[test]
fn a_given_bias_and_its_jump_are_a_mean_error() {
    let given = tracer()
        .replace(
            "sigma = 0.3\nevolution",
            "value = 0.6\nassumed_sigma = 0.3\nassumed_drift_per_sqrt_day = 0.1\nevolution",
        )
        .replace(WALK, "{ kind = \"jump\", at_hours = 36, size = 0.5 }");
    let summary = summary(&given);
    let blind = &summary.methods["blind"];
    // Cycles 3 to 5 at 0.6, then 6 to 12 at 1.1.
    let expected = ((3.0 * 0.36 + 7.0 * 1.21) / 10.0_f64).sqrt();
    assert!((blind["bias_rmse"] / expected - 1.0).abs() < 1e-9, "{blind:?}, {expected}");
    assert!(summary.methods["kf"]["bias_rmse"] < 0.5 * expected);
}

/// Mean square errors of each method.
#[derive(Default)]
struct Squares(Vec<[f64; 2]>);

impl Sink for Squares {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        if let Event::Finished(summary) = event {
            let of = |scores: &isobar::scores::MethodScores| {
                ["rmse_analysis.tracer", "bias_rmse"].map(|score| scores.values.get(score).map_or(0.0, |it| it.powi(2)))
            };
            self.0 = summary.methods.values().map(of).collect();
        }
        Ok(())
    }
}

/// Within four standard errors of the mean over seeds, for eight methods and their biases.
#[test]
fn the_mean_over_seeds_comes_to_the_same() {
    [WALK, AR1].into_iter().for_each(|evolution| mean_over_seeds(&tracer().replace(WALK, evolution)));
}

#[test]
fn methods_that_let_biases_decay_as_they_do_not_are_refused() {
    let text = tracer().replace(WALK, AR1).replace("evolution =", "assumed_drift_per_sqrt_day = 0.1\nevolution =");
    let error = exact(&parse(&text), &ExactOptions::default()).unwrap_err().to_string();
    assert!(error.contains("is an AR(1) process"), "{error}");
}

fn mean_over_seeds(text: &str) {
    let scenario = parse(text);
    let directory = tempfile::tempdir().unwrap();
    let runs: Vec<Vec<[f64; 2]>> = (0..150)
        .map(|seed| {
            let own = directory.path().join(seed.to_string());
            let options = isobar::options::RunOptions {
                seed: Some(seed),
                threads: Some(1),
                ..crate::runs::run_options(&own, 12)
            };
            let mut squares = Squares::default();
            isobar::run::run(&scenario, &options, &mut squares).unwrap();
            squares.0
        })
        .collect();
    let exact = summary(text);
    for (number, (name, scores)) in exact.methods.iter().enumerate() {
        let expected =
            ["rmse_analysis.tracer", "bias_rmse"].map(|score| scores.get(score).map_or(0.0, |it| it.powi(2)));
        for (which, expected) in expected.into_iter().enumerate() {
            let values: Vec<f64> = runs.iter().map(|run| run[number][which]).collect();
            let found = independent_mean(&values).unwrap();
            // The half-width is 1.98 standard errors.
            let tolerance = 2.0 * found.half_width.unwrap_or(0.0) + 1e-12;
            assert!((found.mean - expected).abs() <= tolerance, "{name}: {found:?}, exactly {expected}");
        }
    }
}

#[test]
fn the_program_prints_it_and_names_what_it_cannot_compute() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let write = |name: &str, text: &str| fs::write(here.join(name), text).unwrap();
    let ensemble = "[methods.etkf]\nkind = \"etkf\"\nmembers = 10\n";
    write("tracer.toml", &format!("{}{ensemble}", tracer()));
    write("nonlinear.toml", VALID);
    write("other.toml", &tracer().replace("[cycle]", "[truth]\nmodel = { scheme = \"third_order_upwind\" }\n[cycle]"));
    write("faulty.toml", &tracer().replace("missing_rate = 0.0", "faults = { gross_error_rate = 0.1 }"));
    let satellite = "[networks.polar]\nkind = \"satellite\"\nvariable = \"tracer\"\nsigma = 0.3\nswath_width_km = 300\n\
                     scan_positions = 3\nalong_track_spacing_km = 100\nfootprint_sigma_km = 0\n[[networks.polar.bias]]\n\
                     term = \"air_mass\"\nvariable = \"tracer\"\nmean = 0\nscale = 1\nsigma = 0.1\n[methods.kf]";
    write("air_mass.toml", &tracer().replacen("[methods.kf]", satellite, 1));
    write("large.toml", &tracer().replace("nx = 9", "nx = 900"));
    let output = isobar(here, &["exact", "tracer.toml"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.contains("etkf is left out: the gain of an ensemble is random") && said.contains("known"), "{said}");
    let complaint = |arguments: &[&str]| {
        let output = isobar(here, &[&["exact"], arguments].concat());
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let ensemble = complaint(&["tracer.toml", "--methods", "etkf"]);
    assert!(ensemble.contains("method etkf cannot be computed") && ensemble.contains("tracer.toml:"), "{ensemble}");
    assert!(complaint(&["nonlinear.toml"]).contains("shallow_water is not linear"));
    assert!(complaint(&["other.toml"]).contains("the same model for the truth"));
    assert!(complaint(&["faulty.toml"]).contains("network fixed has faults"));
    assert!(complaint(&["air_mass.toml"]).contains("network polar has air_mass"));
    assert!(complaint(&["large.toml"]).contains("more than the 4000"));
    assert!(complaint(&["tracer.toml", "--methods", "kv"]).contains("no method `kv`"));
    assert!(complaint(&["tracer.toml", "--cycles", "2"]).contains("counts scores from cycle 3"));
}

#[test]
fn exact_scores_are_written_for_programs_and_other_files_are_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("tracer.toml"), tracer()).unwrap();
    let arguments = ["exact", "tracer.toml", "--methods", "kf,free", "--cycles", "4", "--quiet", "--out", "e.json"];
    let output = isobar(here, &arguments);
    assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output.stderr));
    let document: serde_json::Value = serde_json::from_slice(&fs::read(here.join("e.json")).unwrap()).unwrap();
    let methods = Some(vec!["kf".to_string(), "free".into()]);
    let expected = exact(&parse(&tracer()), &ExactOptions { methods, cycles: Some(4) }).unwrap();
    let rows = document["scores"].as_array().unwrap();
    assert_eq!(rows.len(), expected.methods.values().map(|values| values.len()).sum::<usize>());
    for row in rows {
        let variable = row["variable"].as_str().map_or(String::new(), |name| format!(".{name}"));
        let key = format!("{}{variable}", row["score"].as_str().unwrap());
        let value = expected.methods[row["method"].as_str().unwrap()][&key];
        assert!((row["value"].as_f64().unwrap() / value - 1.0).abs() < 1e-12, "{row}");
    }
    let again = isobar(here, &arguments);
    assert!(text(&again.stderr).contains("e.json exists") && again.status.code() == Some(1));
    assert!(isobar(here, &[&arguments[..], &["--overwrite"]].concat()).status.success());
    fs::write(here.join("e.json"), "{\"thesis\": 1}").unwrap();
    let refused = isobar(here, &[&arguments[..], &["--overwrite"]].concat());
    assert!(
        text(&refused.stderr).contains("--overwrite replaces only files of isobar exact")
            && refused.status.code() == Some(1)
    );
    assert_eq!(fs::read_to_string(here.join("e.json")).unwrap(), "{\"thesis\": 1}");
}
