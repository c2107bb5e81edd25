//! Comparisons of sensors and test points within a run.

use crate::ahead::{Listener, listen, parse};
use crate::common::{CARRIED_TRACER, VALID, isobar, place, text};
use isobar::scenario::Scenario;
use std::fs;
use tempfile::tempdir;

/// Three groups whose common bias nothing tells, and one that is seldom there.
const WORLD: &str = r#"
[networks.ship]
kind = "radiosonde"
stations = { random = 1 }
observe = { tracer = 0.2 }
interval_cycles = 5
[[networks.ship.bias]]
per = "station"
variable = "tracer"
sigma = 0.3
[networks.buoys]
kind = "radiosonde"
stations = { random = 2 }
observe = { tracer = 0.2 }
interval_cycles = 5
[[networks.buoys.bias]]
per = "station"
variable = "tracer"
sigma = 0.3
"#;

const METHODS: &str = r#"
[methods]
oi = { kind = "optimal_interpolation" }
var = { kind = "3dvar" }
four = { kind = "4dvar", window_cycles = 3 }
kf = { kind = "kf" }
serial = { kind = "serial_kf" }
banded = { kind = "banded_kf", half_bandwidth = 20 }
fkf = { kind = "fkf", blocks = "cell", factors = 8 }
local = { kind = "fkf", local_factors = { per_tile = 3, tile_km = 300 } }
volume = { kind = "time_volume", factors = 6, window_cycles = 4, observation_factors = [{ name = "daily", kind = "sinusoid", period_hours = 24, biases = ["fixed/tracer"] }] }
etkf = { kind = "etkf", members = 40 }
"#;

/// The names of the parameters, in their order.
fn names(listener: &Listener) -> Vec<String> {
    listener.info.as_ref().unwrap().calibration.parameters.iter().map(|it| it.name.clone()).collect()
}

/// Shared biases and those of single stations, in blocks of their own: every method takes both from the cycle of the comparison on,
/// and one that ignores comparisons does not.
#[test]
fn every_method_takes_what_was_found() {
    let mut first = parse(&[CARRIED_TRACER, WORLD, "[methods.kf]\nkind = \"kf\"\n"]);
    first.cycle.count = 1;
    let all = names(&listen(&first).0);
    let of = |network: &str| all.iter().filter(|name| name.starts_with(network)).cloned().collect::<Vec<_>>();
    let (fixed, ship, buoys) = (of("fixed"), of("ship"), of("buoys"));
    assert_eq!((fixed.len(), ship.len(), buoys.len()), (1, 1, 2), "{all:?}");
    let comparisons = format!(
        "[[comparisons]]\nsensor = \"{}\"\nwith = \"{}\"\ntime = \"2026-01-15T20:00:00Z\"\nvalue = 0.9\nsigma = 0.01\n\
         [[comparisons]]\nsensor = \"{}\"\nwith = \"{}\"\ntime = \"2026-01-16T00:00:00Z\"\nvalue = -0.7\nsigma = 0.01\n",
        fixed[0], ship[0], buoys[0], buoys[1]
    );
    let mut scenario =
        parse(&[CARRIED_TRACER, WORLD, &comparisons, METHODS, "alone = { kind = \"kf\", comparisons = \"ignore\" }\n"]);
    scenario.cycle.count = 5;
    let (listener, summary) = listen(&scenario);
    assert!(summary.failures().next().is_none(), "{:?}", summary.failures().collect::<Vec<_>>());
    let number = |name: &String| all.iter().position(|own| own == name).unwrap();
    for (method, info) in listener.info.as_ref().unwrap().methods.iter().enumerate() {
        let differences = |cycle: usize| {
            let bias = &listener.analysed[&(method, cycle)].1.calibration;
            [
                bias[number(&fixed[0])] - bias[number(&ship[0])] - 0.9,
                bias[number(&buoys[0])] - bias[number(&buoys[1])] + 0.7,
            ]
        };
        let (before, after) = (differences(3), differences(4));
        assert!(before.iter().all(|it| it.abs() > 0.2), "{}: {before:?}", info.name);
        let found = after.iter().all(|it| it.abs() < 0.06);
        assert_eq!(found, info.name != "alone", "{}: {after:?}", info.name);
        let taken = listener.observed[&4].comparisons.len();
        assert_eq!((taken, listener.observed[&3].comparisons.len()), (2, 0));
    }
}

/// What is made from the truth is that of the true biases, with an error of its own.
#[test]
fn without_a_value_it_is_the_true_difference_with_an_error() {
    let listed = |hours: std::ops::Range<usize>| -> String {
        hours
            .map(|hour| format!("[[comparisons]]\nsensor = \"fixed/tracer/B\"\ntime = \"2026-01-15T{hour:02}:30:00Z\"\nsigma = 0.1\n"))
            .collect()
    };
    let mut scenario = parse(&[CARRIED_TRACER, &listed(0..24), "[methods.kf]\nkind = \"kf\"\n"]);
    scenario.cycle.count = 4;
    let (listener, _) = listen(&scenario);
    let found: Vec<f64> = listener.observed.values().flat_map(|it| it.comparisons.iter().map(|it| it.value)).collect();
    assert_eq!(found.len(), 24);
    let mean = found.iter().sum::<f64>() / 24.0;
    let spread = (found.iter().map(|it| (it - mean).powi(2)).sum::<f64>() / 23.0).sqrt();
    assert!((0.06..0.14).contains(&spread), "{found:?}");
    let estimate = &listener.analysed[&(0, 4)].1;
    let sigma = estimate.calibration_spread.as_ref().unwrap()[0];
    assert!(sigma < 0.1 / 24f64.sqrt() && (estimate.calibration[0] - mean).abs() < 4.0 * 0.1 / 24f64.sqrt(), "{sigma}");
    // Others in the list change nothing of them.
    let mut fewer = parse(&[CARRIED_TRACER, &listed(6..12), "[methods.kf]\nkind = \"kf\"\n"]);
    fewer.cycle.count = 4;
    let own: Vec<f64> = listen(&fewer).0.observed[&2].comparisons.iter().map(|it| it.value).collect();
    assert_eq!(own, found[6..12]);
}

/// The message of `isobar check` on the valid scenario with this before its methods, and what `fkf` is replaced by.
fn refused(comparison: &str, fkf: &str, at: &str, wanted: &[&str]) {
    let directory = tempdir().unwrap();
    let broken = VALID.replace("[methods.free]", &format!("[[comparisons]]\n{comparison}\n[methods.free]"));
    let broken = broken.replace("kind = \"fkf\"\nblocks = \"cell\"", fkf);
    fs::write(directory.path().join("broken.toml"), &broken).unwrap();
    let output = isobar(directory.path(), &["check", "broken.toml"]);
    assert_eq!(output.status.code(), Some(1), "{comparison}: {}", text(&output.stdout));
    let message = text(&output.stderr).replace("\n  │ ", " ").split_whitespace().collect::<Vec<_>>().join(" ");
    let place = format!("broken.toml:{}]", place(&broken, at));
    for part in std::iter::once(&place.as_str()).chain(wanted) {
        assert!(message.contains(part), "{part} is missing in {message}");
    }
}

#[test]
fn what_is_no_comparison_is_refused_with_its_place() {
    const FKF: &str = "kind = \"fkf\"\nblocks = \"cell\"";
    const GOOD: &str = "sensor = \"sondes/h/B\"\ntime = \"2026-01-16T00:00:00Z\"\nsigma = 2";
    let with = |old: &str, new: &str| GOOD.replace(old, new);
    let cases: [(String, &str, &[&str]); 6] = [
        (
            with("sondes/h/B", "sondes/h/C"),
            "\"sondes/h/C\"",
            &["comparison 1", "no bias that methods estimate is called \"sondes/h/C\"; did you mean \"sondes/h/B\"?"],
        ),
        (with("time", "with = \"sondes/h/B\"\ntime"), "\"sondes/h/B\"\ntime", &["the sensor itself", "another sensor"]),
        (
            with("time", "with = \"sondes\"\ntime"),
            "\"sondes\"",
            &["no bias that methods estimate is called \"sondes\""],
        ),
        (
            with("01-16T", "02-16T"),
            "\"2026-02-16T",
            &["is 2026-02-16T00:00:00Z, outside of the run", "after 2026-01-15T00:00:00Z, until 2026-01-17T12:00:00Z"],
        ),
        (with("sigma = 2", "sigma = 0"), "0\n", &["sigma` is 0", "must be a number greater than 0"]),
        (with("time = \"2026-01-16T00:00:00Z\"\n", ""), "[[comparisons]]", &["`time` is missing"]),
    ];
    for (comparison, at, wanted) in cases {
        let at = if at == "0\n" { "0\n[methods" } else { at };
        refused(&comparison, FKF, at, wanted);
    }
    for (kind, reason) in [
        ("kind = \"letkf\"\nmembers = 10\nlocalization_radius_km = 300", "its analyses are of places"),
        ("kind = \"enkf\"\nmembers = 10\nlocalization_radius_km = 300", "cut off with distance"),
        ("kind = \"federated_kf\"", "no local filter sees the sensors of two systems"),
        ("kind = \"federated_fkf\"", "no local filter sees the sensors of two systems"),
    ] {
        let at = kind.split('\n').next().unwrap();
        refused(GOOD, kind, at, &["it cannot take [[comparisons]]", reason, "comparisons = \"ignore\""]);
    }
}

#[test]
fn exact_errors_are_without_comparisons() {
    let directory = tempdir().unwrap();
    let output = isobar(directory.path(), &["exact", "isobar:/compared_sensors.toml", "--methods", "kf"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("leave out the comparisons of sensors"), "{}", text(&output.stderr));
}

/// With the scenario that shows it: whoever takes the comparisons knows the biases, and knows that.
#[test]
fn comparisons_determine_what_nothing_else_does() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/compared_sensors.toml");
    let (listener, summary) = listen(&Scenario::load(&path).unwrap());
    for method in ["kf", "fkf"] {
        let score = |name: &str, key: &str| summary.methods[name].values[key];
        let alone = format!("{method}_alone");
        for key in ["bias_rmse", "bias_spread"] {
            assert!(score(method, key) < 0.5 * score(&alone, key), "{method}: {key}");
        }
    }
    // The verdict on the first group changes in the cycle of the comparison, and otherwise when the standard first reports.
    let methods = &listener.info.as_ref().unwrap().methods;
    for (name, since) in [("kf", 6), ("fkf", 6), ("kf_alone", 8), ("fkf_alone", 8)] {
        let number = methods.iter().position(|it| it.name == name).unwrap();
        let own = listener.verdicts.iter().filter(|(_, method, verdict)| (*method, verdict.parameter) == (number, 0));
        let told: Vec<(usize, bool)> = own.map(|(cycle, _, verdict)| (*cycle, verdict.stable)).collect();
        assert_eq!(told, [(1, false), (since, true)], "{name}");
    }
}
