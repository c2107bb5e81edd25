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
        "sondes/h/all: not stable, adjusted all the same: the observations leave 54 % of its prior variance; needs a test point \
         to 13 m or better, or a network without bias that observes the same",
    ] {
        assert!(printed.contains(part), "{part} is missing:\n{printed}");
    }
    let stability = &method["stability"];
    assert_eq!(stability["references"], serde_json::json!(["sondes/h/all"]));
    assert_eq!(stability["parameters"][0]["stable"], false);
    assert!(stability["variances"]["h"]["trend"].as_f64().unwrap() < 1.1, "{stability}");
    assert!(stability["variances"]["h"]["per_cycle"].as_f64().unwrap() > 1.0, "{stability}");
}

/// A row of `verdicts.csv`: cycle, parameter, whether it is stable and frozen, and the share of its prior variance.
type Row = (usize, String, bool, bool, f64);

/// The verdicts on the biases of the scenario in its cycles, and at the end; `shown`: how the page tells them.
fn verdicts(change: impl Fn(String) -> String, method: &str, shown: &str) -> (Vec<Row>, serde_json::Value) {
    let parent = tempdir().unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/no_reference_station.toml");
    let shipped = fs::read_to_string(shipped).unwrap();
    fs::write(parent.path().join("own.toml"), change(shipped.split("[expected]").next().unwrap().to_string())).unwrap();
    let arguments = ["run", "own.toml", "--methods", method, "--quiet", "--no-rerun", "--no-netcdf"];
    let output = isobar(parent.path(), &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let out = parent.path().join("out/own");
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains(shown), "the page does not say {shown}");
    let mut rows = csv::Reader::from_path(out.join("verdicts.csv")).unwrap();
    let rows = rows.records().map(|row| {
        let row = row.unwrap();
        assert_eq!((row.len(), &row[2]), (9, method));
        assert_eq!(row[8].is_empty(), &row[4] == "true", "{row:?}");
        let ratio = row[6].parse().unwrap();
        (row[0].parse().unwrap(), row[3].to_string(), &row[4] == "true", &row[5] == "true", ratio)
    });
    let summary: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    (rows.collect(), summary["methods"][method]["stability"]["parameters"].clone())
}

/// Half of the stations without bias, and a bias that counts as determined once 1 % of its prior variance is left.
fn demanding(scenario: String) -> String {
    let groups = "groups = [\"all\", \"reference\"]\nreference_groups = [\"reference\"]";
    scenario.replace("groups = [\"all\"]", groups) + "\n[stability]\nvariance_ratio = 0.01\n"
}

/// A verdict is reported once, and again when it changes; the last is the verdict at the end.
#[test]
fn verdicts_of_every_cycle_are_told_where_they_change() {
    for method in ["fkf", "kf"] {
        let (rows, end) = verdicts(demanding, method, "from cycle ");
        let [first, second] = rows.as_slice() else { panic!("{rows:?}") };
        assert!(first.0 == 1 && !first.2 && first.4 > 0.01 && first.4 < 1.0, "{rows:?}");
        assert!(second.0 > 1 && second.2 && second.4 <= 0.01, "{rows:?}");
        assert_eq!(end[0]["stable"], true);
        let (rows, end) = verdicts(|scenario| scenario, method, "never");
        assert!(rows.len() == 1 && !rows[0].2 && end[0]["stable"] == false, "{rows:?}");
        let frozen = |scenario: String| format!("{scenario}\n[stability]\nfreeze_after_cycles = 10\n");
        let (rows, end) = verdicts(frozen, method, "frozen from cycle 10");
        assert!(rows.len() == 2 && rows[1].0 == 10 && !rows[1].2 && rows[1].3, "{rows:?}");
        assert_eq!(end[0]["frozen"], true);
    }
}

/// A bias that goes back to its mean has its stationary variance without observations, and is judged by the share of that: what
/// determines a constant bias does not determine one that forgets it within hours.
#[test]
fn a_bias_that_evolves_is_judged_by_its_stationary_variance() {
    let evolving = |scenario: String| {
        let bias = "variable = \"h\"\nsigma = 20\n";
        assert!(scenario.contains(bias), "{scenario}");
        demanding(scenario.replace(bias, &format!("{bias}evolution = {{ kind = \"ar1\", correlation_hours = 3 }}\n")))
    };
    let (rows, end) = verdicts(evolving, "kf", "never");
    assert!(rows.len() == 1 && !rows[0].2, "{rows:?}");
    let ratio = end[0]["variance_ratio"].as_f64().unwrap();
    assert!((0.02..rows[0].4).contains(&ratio), "{rows:?} {end}");
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

/// While nothing tells the bias from the mean height it is frozen, after three cycles of that; a reference that begins in cycle 15
/// makes it stable, and two cycles later it is adjusted again.
#[test]
fn a_bias_is_frozen_while_it_has_no_stable_update() {
    let late = |scenario: String| {
        scenario
            + "\n[stability]\nfreeze_unstable_cycles = 3\nthaw_stable_cycles = 2\n[networks.reference]\nkind = \"radiosonde\"\n\
               stations = { regular = [5, 3] }\nsigma_height_m = 12\ninterval_cycles = 15\nfirst_cycle = 15\n"
    };
    for method in ["fkf", "kf"] {
        let (rows, end) = verdicts(late, method, "frozen in cycles 3–15");
        let told: Vec<(usize, bool, bool)> = rows.iter().map(|row| (row.0, row.2, row.3)).collect();
        assert_eq!(told, [(1, false, false), (3, false, true), (15, true, true), (16, true, false)]);
        // What is kept is what three cycles left, and an update would hardly leave less until the reference begins.
        assert!((rows[1].4 / rows[0].4 - 1.0).abs() < 0.05 && rows[2].4 < 0.25, "{rows:?}");
        assert!(end[0]["stable"] == true && end[0]["frozen"] == false, "{end}");
        // It is no worse in the end than one that was never frozen.
        let never =
            |scenario: String| late(scenario).replace("freeze_unstable_cycles = 3\nthaw_stable_cycles = 2\n", "");
        let (_, other) = verdicts(never, method, "from cycle 15");
        let ratio = |end: &serde_json::Value| end[0]["variance_ratio"].as_f64().unwrap();
        assert!(ratio(&end) < 1.2 * ratio(&other), "{end} {other}");
    }
}

/// A datum as good as the monitor says is needed makes the bias stable, and one that is a little worse does not.
#[test]
fn a_test_point_or_a_comparison_as_good_as_is_needed_is_enough() {
    let standard = |scenario: String| {
        scenario.replace("groups = [\"all\"]", "groups = [\"A\", \"B\"]")
            + "\n[networks.standard]\nkind = \"radiosonde\"\nstations = { random = 1 }\nobserve = { h = 500 }\n\
               [[networks.standard.bias]]\nper = \"group\"\nvariable = \"h\"\nsigma = 1\n"
    };
    let (printed, scores) = run(standard, "fkf");
    let parameter = &scores["stability"]["parameters"][0];
    assert!(parameter["name"] == "sondes/h/A" && parameter["stable"] == false, "{parameter}");
    let needs = &parameter["needs"];
    assert_eq!(needs["comparison"]["with"], "standard/h/all", "{needs}");
    assert!(printed.contains("or a comparison with standard/h/all to "), "{printed}");
    let data = [("", &needs["test_point_sigma"]), ("with = \"standard/h/all\"\n", &needs["comparison"]["sigma"])];
    for ((with, sigma), (factor, enough)) in data.into_iter().flat_map(|it| [(it, (0.999, true)), (it, (1.001, false))])
    {
        let sigma = factor * sigma.as_f64().unwrap();
        let last = format!(
            "\n[[comparisons]]\nsensor = \"sondes/h/A\"\n{with}time = \"2026-01-25T00:00:00Z\"\nsigma = {sigma}\n"
        );
        let (_, scores) = run(|scenario| standard(scenario) + &last, "fkf");
        let parameter = &scores["stability"]["parameters"][0];
        assert_eq!(parameter["stable"], enough, "{with} {factor} {parameter}");
    }
}

/// Observed for as many cycles as it says, a bias is determined, and in half of them it is not.
#[test]
fn as_many_cycles_as_are_needed_are_enough() {
    let end = |cycles: u64| {
        let of_length = |scenario: String| {
            demanding(scenario).replace("count = 40", &format!("count = {cycles}")).replace("score_from_cycle = 21", "")
        };
        verdicts(of_length, "fkf", "cycle").1[0].clone()
    };
    let early = end(5);
    let further = early["needs"]["further_cycles"].as_u64().unwrap();
    assert!(end(5 + further)["stable"] == true, "{early}");
    assert!(end(5 + further / 2)["stable"] == false, "{early}");
}
