//! `isobar explain` and `isobar schema`: what the reader checks, for people and for editors.

use crate::common::{TRACER, VALID, isobar, text};
use crate::json_schema::faults;
use isobar::reference::{explain, schema, sections};
use isobar::scenario::Scenario;
use isobar::shipped;
use serde_json::Value;
use std::path::Path;

fn said(key: &str) -> String {
    let directory = tempfile::tempdir().unwrap();
    let output = isobar(directory.path(), &["explain", key]);
    assert!(output.status.success(), "{key}: {}", text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn keys_kinds_and_tables_are_explained() {
    for (key, wanted) in [
        ("grid.dx_km", &["unit: km", "value: a number from 0.001 to 10000", "default: must be given"][..]),
        ("methods.letkf", &["localization_radius_km", "members"]),
        ("methods", &["letkf", "fkf", "what it is"]),
        ("networks.radiosonde.bias", &["sigma", "evolution", "per"]),
        ("networks.sondes.bias.0.sigma", &["standard deviation from which the bias is drawn"]),
        (
            "methods.var.covariance_scale",
            &["factor on the covariance B", "default: 1", "of kind: optimal_interpolation, 3dvar"],
        ),
        ("methods.kind", &["letkf"]),
        ("background_error.components.0.length_km", &["unit: km", "balanced"]),
        ("truth.initial.jet", &["An eastward jet"]),
        ("truth.model.coriolis_per_s", &["unit: 1/s"]),
        ("sweep.vary.methods.from", &["the first value"]),
        ("output", &["netcdf: True or false.", "report"]),
        ("cycle", &["window_hours", "score_from_cycle"]),
    ] {
        let said = said(key);
        wanted.iter().for_each(|wanted| {
            assert!(said.to_lowercase().contains(&wanted.to_lowercase()), "{key}: no {wanted:?} in\n{said}")
        });
    }
    let directory = tempfile::tempdir().unwrap();
    let all = text(&isobar(directory.path(), &["explain"]).stdout);
    for section in sections() {
        assert!(all.lines().any(|line| line.starts_with(&section.name)), "{}", section.name);
        assert!(explain(&section.name).is_ok());
    }
}

#[test]
fn unknown_keys_get_suggestions() {
    for (key, wanted) in [
        ("grid.dx", "did you mean `grid.dx_km`?"),
        ("methods.letfk", "did you mean `methods.letkf`?"),
        ("dx_km", "elsewhere: grid.dx_km"),
        ("gird", "did you mean `grid`?"),
        ("grid.nx.more", "nothing is known below it"),
        ("localisation_radius_km", "localization_radius_km`?"),
        ("", "known at the top level: title"),
    ] {
        let unknown = explain(key).unwrap_err();
        assert!(unknown.help.contains(wanted), "{key}: {}", unknown.help);
    }
}

fn json(scenario: &str) -> Value {
    fn of(value: toml::Value) -> Value {
        match value {
            toml::Value::Datetime(time) => Value::String(time.to_string()),
            toml::Value::Array(values) => values.into_iter().map(of).collect(),
            toml::Value::Table(table) => table.into_iter().map(|(key, value)| (key, of(value))).collect(),
            plain => serde_json::to_value(plain).unwrap(),
        }
    }
    of(toml::Value::Table(scenario.parse().unwrap()))
}

#[test]
fn every_scenario_fits_the_schema() {
    let schema = schema();
    let template = include_str!("../src/cli/template.toml").to_string();
    let scenarios = shipped::scenarios().map(|path| Scenario::load(&path).unwrap().text);
    for text in scenarios.chain([template, VALID.into()]) {
        assert_eq!(faults(&schema, &json(&text)), Vec::<String>::new(), "{}", &text[..200]);
    }
    let directory = tempfile::tempdir().unwrap();
    let printed: Value = serde_json::from_slice(&isobar(directory.path(), &["schema"]).stdout).unwrap();
    assert_eq!(printed, schema);
}

/// What the reader refuses for itself, and not for the rest of the file, the schema refuses as well.
#[test]
fn faulty_scenarios_do_not_fit_the_schema() {
    let schema = schema();
    for (right, wrong) in [
        ("nx = ", "nxx = "),
        ("boundary = \"channel\"", "boundary = \"open\""),
        ("seed = 1", "seed = -1"),
        ("seed = 1", "seed = \"one\""),
        ("kind = \"jet\"", "kind = \"jett\""),
        ("kind = \"jet\"", "kindd = \"jet\""),
        ("width_km = 200", "width_m = 200"),
        ("groups = [\"A\", \"B\"]", "groups = \"A\""),
        ("sigma_height_m = ", "sigma_height_m = -"),
        ("[methods.free]\nkind = \"free\"", "[methods.free]\nkind = \"free\"\nmembers = 3"),
        ("title = ", "titel = "),
        ("per = \"group\"", "per = \"sensor\""),
    ] {
        assert!(VALID.contains(right), "{right:?}");
        let text = VALID.replacen(right, wrong, 1);
        assert!(Scenario::parse(Path::new("small.toml"), &text).is_err(), "{wrong:?} is read");
        assert!(!faults(&schema, &json(&text)).is_empty(), "{wrong:?} fits");
    }
    assert!(!faults(&schema, &json(TRACER)).is_empty(), "there are no methods");
}
