//! `error_correlation` of networks and of methods, in whole runs.

use crate::common::{isobar, one_line, text};
use crate::passive::{METHODS, WORLD, summary};
use crate::runs::run_options;
use isobar::output::Sink;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::{MethodScores, kind};
use std::path::Path;

/// The world with correlated errors, and with these methods.
fn world(correlation: &str, methods: &str) -> String {
    let place = "observe = { tracer = 0.1 }\n";
    assert!(WORLD.contains(place));
    WORLD.replace(place, &format!("{place}{correlation}\n")) + methods
}

fn by_distance(keys: &str) -> String {
    format!("error_correlation = {{ kind = \"by_distance\", {keys} }}")
}

/// The scores without what a method has cost.
fn results(scores: &MethodScores) -> MethodScores {
    let mut own = scores.clone();
    own.values.retain(|key, _| kind(key.split('.').next().unwrap()).unwrap().regressed);
    own
}

/// With a length far below the distances, and with the errors taken for independent, all methods have the bits of a world
/// without correlation or of its assumption; with a length of some cells all of them run, and most have other results.
#[test]
fn every_method_takes_correlated_errors_and_independent_ones_change_nothing() {
    let without = summary(&world("", METHODS));
    let nearly = summary(&world(&by_distance("length_km = 0.001"), METHODS));
    let with = summary(&world(&by_distance("length_km = 200"), METHODS));
    let assumed = summary(&world(&by_distance("length_km = 200, assumed_length_km = 0"), METHODS));
    let ignoring: String = METHODS
        .split_inclusive('\n')
        .map(|line| match line.trim() {
            "kind = \"free\"" | "kind = \"climatology\"" => line.to_string(),
            own if own.starts_with("kind = ") => format!("{line}error_correlation = \"ignore\"\n"),
            _ => line.to_string(),
        })
        .collect();
    let ignored = summary(&world(&by_distance("length_km = 200"), &ignoring));
    for other in [&nearly, &with, &assumed, &ignored] {
        assert_eq!(
            (other.methods.len(), other.failures().count()),
            (16, 0),
            "{:?}",
            other.failures().collect::<Vec<_>>()
        );
    }
    for (name, scores) in &without.methods {
        assert_eq!(results(scores), results(&nearly.methods[name]), "{name}");
        assert_eq!(results(&assumed.methods[name]), results(&ignored.methods[name]), "{name}");
        let uses = !["free", "climatology"].contains(&name.as_str());
        assert_eq!(results(&with.methods[name]) != results(&assumed.methods[name]), uses, "{name}");
    }
}

/// Departures are those of the observations as they were reported: in the first cycle, whose background is the same, they do not
/// depend on what a method makes of the correlation.
#[test]
fn departures_are_those_of_the_observations() {
    let kind = |name: &str, kind: &str| {
        format!(
            "[methods.{name}]\nkind = \"{kind}\"\n[methods.{name}_ignoring]\nkind = \"{kind}\"\nerror_correlation = \"ignore\"\n"
        )
    };
    let methods = kind("kf", "kf") + &kind("oi", "optimal_interpolation") + &kind("fkf", "fkf");
    let text = world(&by_distance("length_km = 200"), &methods);
    let scenario = Scenario::parse(Path::new("s.toml"), &text).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut listener: Vec<Box<dyn Sink>> = Vec::new();
    let summary = run(&scenario, &run_options(folder.path(), 1), &mut listener).unwrap();
    let of = |name: &str| {
        let own = &summary.methods[name].diagnostics.as_ref().unwrap().observations["fixed/tracer"];
        [own.innovation_mean, own.innovation_rms]
    };
    for name in ["kf", "oi", "fkf"] {
        let (known, ignored) = (of(name), of(&format!("{name}_ignoring")));
        assert!(
            known.iter().zip(ignored).all(|(a, b)| (a - b).abs() < 1e-12 && a.abs() > 1e-3),
            "{known:?} {ignored:?}"
        );
        let residual =
            |name: &str| summary.methods[name].diagnostics.as_ref().unwrap().observations["fixed/tracer"].residual_mean;
        assert_ne!(residual(name), residual(&format!("{name}_ignoring")));
    }
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let kf = "[methods.kf]\nkind = \"kf\"\n";
    let initialise = "[initialise]\nmethod = \"high-pass\"\ncycles = 2\nbox_km = 300\n";
    let scan_line = "error_correlation = { kind = \"scan_line\", length_km = 200 }";
    let file = "[networks.file]\nkind = \"file\"\nfile = \"o.csv\"\nsigma = 1\n\
                error_correlation = { kind = \"by_distance\", length_km = 200, report_by = \"orbit\" }\n";
    for (scenario, wanted) in [
        (world(scan_line, kf), "networks.fixed.error_correlation.kind"),
        (world(&by_distance("length_km = -1"), kf), "networks.fixed.error_correlation.length_km"),
        (world(&by_distance("length_km = 200, report_by = \"orbit\""), kf), "unknown key `report_by`"),
        (
            world(&by_distance("length_km = 200"), &format!("{kf}{initialise}")),
            "the method `kf` cannot be initialised: a high-pass filter takes errors as independent, and those of network fixed",
        ),
        (
            world(&format!("withhold = 0.2\n{}", by_distance("length_km = 200")), kf),
            "withhold would compare methods with",
        ),
        (world("", &format!("{kf}{file}")), "no column `orbit`"),
        (
            world("", "[methods.free]\nkind = \"free\"\nerror_correlation = \"ignore\"\n"),
            "unknown key `error_correlation`",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("s.toml"), &scenario).unwrap();
        std::fs::write(folder.path().join("o.csv"), "cycle,column,row,value,id\n1,4,5,5,C\n").unwrap();
        let output = isobar(folder.path(), &["check", "s.toml"]);
        let said = one_line(&text(&output.stderr));
        assert!(!output.status.success() && said.contains(wanted), "{wanted}: {said}");
    }
    // A method that ignores the correlation may be initialised.
    let ignoring = format!("{kf}error_correlation = \"ignore\"\n{initialise}");
    assert!(Scenario::parse(Path::new("s.toml"), &world(&by_distance("length_km = 200"), &ignoring)).is_ok());
}

/// Factors of observations with patterns have the pattern's value where an observation is, and cannot be whitened.
#[test]
fn a_time_volume_with_patterns_of_observations_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let pattern: String = (0..60).map(|cell| format!("{}\n", cell % 7)).collect();
    std::fs::write(folder.path().join("pattern.csv"), pattern).unwrap();
    let method = |correlation: &str| {
        format!(
            "[methods.window]\nkind = \"time_volume\"\nblocks = \"domain\"\nwindow_cycles = 3\n{correlation}\
             observation_factors = [{{ name = \"b\", kind = \"constant\", biases = [\"fixed/tracer\"], patterns_file = \"pattern.csv\" }}]\n"
        )
    };
    let said = |correlation: &str| {
        let scenario = world(&by_distance("length_km = 200"), &method(correlation));
        std::fs::write(folder.path().join("s.toml"), &scenario).unwrap();
        let output = isobar(folder.path(), &["check", "s.toml"]);
        let said = one_line(&text(&output.stderr));
        (output.status.success(), said)
    };
    let (ok, message) = said("");
    let wanted = "the errors of network fixed are correlated, which this method cannot take: factors of observations with patterns";
    assert!(!ok && message.contains(wanted), "{message}");
    let (ok, message) = said("error_correlation = \"ignore\"\n");
    assert!(ok, "{message}");
}
