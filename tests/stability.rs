//! The stability monitor, as the user of the program sees it.

use crate::common::{isobar, text};
use std::fs;
use std::path::Path;
use tempfile::tempdir;

/// Runs a shipped scenario with one method; what is printed, and the summary.
fn run(change: impl Fn(String) -> String, method: &str) -> (String, serde_json::Value) {
    let parent = tempdir().unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/no_reference_station.toml");
    let shipped = fs::read_to_string(shipped).unwrap();
    let scenario = change(shipped.split("[expected]").next().unwrap().to_string());
    fs::write(parent.path().join("own.toml"), scenario).unwrap();
    let arguments = ["run", "own.toml", "--methods", method, "--quiet", "--no-rerun", "--no-netcdf"];
    let output = isobar(parent.path(), &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let page = fs::read_to_string(parent.path().join("out/own/report.html")).unwrap();
    assert!(page.contains("Stability of the bias estimates"));
    let summary = fs::read_to_string(parent.path().join("out/own/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    // Sentences go on on the next line.
    let printed = text(&output.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    (printed, summary["methods"][method].clone())
}

#[test]
fn a_bias_that_nothing_tells_from_the_mean_height_is_named_with_what_would_cure_it() {
    let (printed, method) = run(|scenario| scenario, "fkf");
    for part in [
        "fkf: 0 of 1 stable; innovations white",
        "cannot be separated: the mean h and sondes/h/all (correlation -1.00; keeps 54 % of its prior variance)",
        "an unbiased observation of the mean h would tell them apart, to 14 m or better",
        "stations without bias (reference_groups), of sondes/h/all",
        "sondes/h/all: not stable, adjusted all the same: the observations leave 54 % of its prior variance",
    ] {
        assert!(printed.contains(part), "{part} is missing:\n{printed}");
    }
    let stability = &method["stability"];
    assert_eq!(stability["references"], serde_json::json!(["sondes/h/all"]));
    assert_eq!(stability["parameters"][0]["stable"], false);
    assert!(stability["variances"]["h"]["trend"].as_f64().unwrap() < 1.1, "{stability}");
    assert!(stability["variances"]["h"]["per_cycle"].as_f64().unwrap() > 1.0, "{stability}");
}

/// What it recommends does cure it: half of the stations without bias.
#[test]
fn a_reference_group_makes_the_bias_stable() {
    let referenced = |scenario: String| {
        scenario.replace("groups = [\"all\"]", "groups = [\"all\", \"reference\"]\nreference_groups = [\"reference\"]")
    };
    let (printed, method) = run(referenced, "fkf");
    assert!(printed.contains("fkf: all 1 stable; innovations white"), "{printed}");
    let parameter = &method["stability"]["parameters"][0];
    assert!(parameter["stable"] == true && parameter["variance_ratio"].as_f64().unwrap() < 0.25, "{parameter}");
    assert_eq!(method["stability"]["undetermined"], serde_json::json!([]));
}

/// A frozen bias stays at its prior, with its prior's spread, and the verdict is that of the time at which it was frozen.
#[test]
fn a_bias_without_a_stable_update_is_frozen_if_the_scenario_says_so() {
    let freezing = |scenario: String| format!("{scenario}\n[stability]\nfreeze_after_cycles = 10\n");
    for method in ["fkf", "kf"] {
        let (printed, scores) = run(freezing, method);
        assert!(printed.contains("0 of 1 stable, 1 frozen"), "{printed}");
        assert!(printed.contains("sondes/h/all: not stable, frozen: the observations leave 5"), "{printed}");
        assert!((scores["bias_spread"].as_f64().unwrap() - 20.0).abs() < 1e-6, "{scores}");
        // The state's errors are claimed with those of the frozen bias: about as large as the priors of both leave them.
        let (spread, error) = (&scores["spread_analysis"]["h"], &scores["rmse_analysis"]["h"]);
        assert!(spread.as_f64().unwrap() > error.as_f64().unwrap(), "{scores}");
        assert_eq!(scores["stability"]["parameters"][0]["frozen"], true);
    }
}
