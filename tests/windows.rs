//! What the shipped scenarios of time volumes and of the first calibration promise.

use crate::runs::run_options;
use isobar::output::Sink;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use std::collections::BTreeMap;
use std::path::Path;

/// Estimate, sigma and verdict of parameters, by method and name.
type Parameters = BTreeMap<(String, String), (f64, Option<f64>, String)>;

/// Runs a shipped scenario, with its text changed; its scores, and its parameters as of the last cycle that has them.
fn results(name: &str, change: impl Fn(String) -> String, methods: &[&str]) -> (Summary, Parameters) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/{name}.toml"));
    let text = change(std::fs::read_to_string(&path).unwrap());
    let scenario = Scenario::parse(&path, &text).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut options = run_options(folder.path(), scenario.cycle.count);
    options.methods = Some(methods.iter().map(ToString::to_string).collect());
    let mut listener: Vec<Box<dyn Sink>> = Vec::new();
    let summary = run(&scenario, &options, &mut listener).unwrap();
    let mut parameters = BTreeMap::new();
    if let Ok(mut reader) = csv::Reader::from_path(options.out.join("parameters.csv")) {
        for row in reader.records().map(Result::unwrap) {
            let value = (row[5].parse().unwrap(), row[6].parse().ok(), row[7].to_string());
            parameters.insert((row[2].to_string(), row[3].to_string()), value);
        }
    }
    (summary, parameters)
}

/// The truth is 12 m cos(2π (t − 15 h)/24 h).
#[test]
fn the_diurnal_bias_is_recovered() {
    let (summary, parameters) = results("diurnal_bias", |text| text, &["fkf", "window"]);
    for (name, phase) in [("diurnal/cosine", f64::cos as fn(f64) -> f64), ("diurnal/sine", f64::sin)] {
        let (value, sigma, verdict) = &parameters[&("window".to_string(), name.to_string())];
        let truth = 12.0 * phase(std::f64::consts::TAU * 15.0 / 24.0);
        assert_eq!(verdict, "determined");
        assert!((value - truth).abs() < 3.0 * sigma.unwrap(), "{name}: {value} ± {sigma:?}, and not {truth}");
    }
    let biases = |name: &str| summary.methods[name].values["bias_rmse"];
    assert!(biases("window") < 0.2 * biases("fkf"));
    // The monitor's verdict: biases stand firm, and only who knows of the cycle has innovations as large as claimed.
    let verdict = |name: &str| summary.methods[name].stability.as_ref().unwrap();
    let own = verdict("window");
    assert_eq!((own.parameters.len(), own.undetermined.len(), own.references.len()), (2, 0, 0));
    for parameter in &own.parameters {
        assert!(parameter.stable && parameter.observations > 0, "{parameter:?}");
        assert!(parameter.variance_ratio > 0.0 && parameter.variance_ratio < 0.05, "{parameter:?}");
    }
    assert!(own.innovation_chi2.unwrap().holds() && !verdict("fkf").innovation_chi2.unwrap().holds(), "{own:?}");
}

/// What the heating of 6 per day adds in a cycle of w = 3 h, 6 (P/π) sin(π w/P) cos(2π (t − w/2 − 14 h)/P), has the cosine and the sine
/// of the time at its end that the window estimates: a wind along the band does not change it.
#[test]
fn an_unknown_heating_is_found_as_strong_as_it_is() {
    use std::f64::consts::{PI, TAU};
    let (unknown, parameters) = results("forcing", |text| text, &["free", "kf", "window"]);
    let (period, hours) = (24.0, 3.0);
    let amplitude = 6.0 / 24.0 * period / PI * (PI * hours / period).sin();
    let phase = TAU * (hours / 2.0 + 14.0) / period;
    for (name, part) in [("cosine", phase.cos()), ("sine", phase.sin())] {
        let (value, sigma, verdict) = &parameters[&("window".to_string(), format!("heating/eof 1/{name}"))];
        let (truth, sigma) = (amplitude * part, sigma.unwrap());
        assert_eq!(verdict, "determined");
        assert!((value - truth).abs() < 3.0 * sigma, "{name}: {value} ± {sigma}, and not {truth}");
        assert!(sigma < 0.1 * amplitude, "{name}: ± {sigma} of {amplitude}");
    }
    let known = |text: String| text.replace("amplitude_per_day = 0\n", "amplitude_per_day = 6\n");
    let (known, of_nothing) = results("forcing", known, &["free", "kf", "window"]);
    let error = |summary: &Summary, kind: &str, method: &str| summary.methods[method].values[&format!("{kind}.tracer")];
    for kind in ["rmse_analysis", "rmse_background", "rmse_forecast"] {
        let [blind, aware, found] =
            [error(&unknown, kind, "kf"), error(&known, kind, "kf"), error(&unknown, kind, "window")];
        assert!(
            blind > 1.3 * aware && found < 1.1 * aware,
            "{kind}: {blind} without it, {aware} with it, {found} found"
        );
    }
    // Where there is nothing left to be found, nothing is found.
    for (value, sigma, _) in of_nothing.values() {
        assert!(value.abs() < 3.0 * sigma.unwrap(), "{value} ± {sigma:?}");
    }
}

#[test]
fn a_wrong_model_is_corrected() {
    let (wrong, parameters) = results("wrong_model", |text| text, &["corrected"]);
    for (name, truth) in [("advection_x_m_per_s", 2.0), ("mean_depth_m", 50.0)] {
        let (value, sigma, verdict) = &parameters[&("corrected".to_string(), format!("transition/{name}"))];
        assert_eq!(verdict, "determined", "{name}");
        // With this seed the advection is 3.5 claimed σ from the truth; over seeds the claims are tested in assim/tests/corrected_tiles.rs.
        assert!((value - truth).abs() < 4.0 * sigma.unwrap(), "{name}: {value} ± {sigma:?}, and not {truth}");
    }
    let right = |text: String| {
        let text = text.replace("\nmean_depth_m = 1000\n", "\nmean_depth_m = 1050\n");
        text.replace("\nmean_flow_m_per_s = 20\n", "\nmean_flow_m_per_s = 22\n")
    };
    let (right, _) = results("wrong_model", right, &["fkf"]);
    for variable in ["h", "u", "v"] {
        let rmse =
            |summary: &Summary, method: &str| summary.methods[method].values[&format!("rmse_analysis.{variable}")];
        let ratio = rmse(&wrong, "corrected") / rmse(&right, "fkf");
        // The way to the right model is among the cycles that count.
        assert!(ratio < 1.15, "{variable}: {ratio} times the error with the right model");
    }
}

#[test]
fn the_first_calibration_is_found_without_a_prior_and_what_is_not_is_named() {
    let (summary, parameters) = results("first_calibration", |text| text, &["fkf", "fkf_high_pass"]);
    let biases = |name: &str| summary.methods[name].values["bias_rmse"];
    assert!(biases("fkf_high_pass") < 0.85 * biases("fkf"), "{} {}", biases("fkf_high_pass"), biases("fkf"));
    // And it knows how well, which with the wrong prior it does not.
    let honest = |name: &str| biases(name) / summary.methods[name].values["bias_spread"];
    assert!(honest("fkf_high_pass") < 1.25 && honest("fkf") > 1.4, "{} {}", honest("fkf_high_pass"), honest("fkf"));
    assert_eq!(parameters.len(), 3);
    assert!(parameters.values().all(|it| it.2 == "determined"), "{parameters:?}");
    let without = |text: String| text.replace("reference_groups = [\"A\"]\n", "");
    let (_, parameters) = results("first_calibration", without, &["fkf_high_pass"]);
    let verdict = &parameters[&("fkf_high_pass".to_string(), "high-pass/sondes/h/B".to_string())].2;
    assert!(verdict.starts_with("not determined: sondes/h/A + sondes/h/B"), "{verdict}");
}
