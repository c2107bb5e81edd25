//! A truth by a model of another kind than the methods', `truth.model.kind`.

use crate::ahead::{Listener, TRACER, listen, parse};
use crate::common::{VALID, isobar, one_line, place, text};
use crate::json_schema::faults;
use crate::runs::run_options;
use isobar::exact::{ExactOptions, exact};
use isobar::options::RunOptions;
use isobar::output::{Outputs, STATE};
use isobar::reference::{explain, schema};
use isobar::run::run;
use isobar::scenario::{Scenario, TruthSettings};
use std::fs;
use std::path::Path;

/// Water in a channel, with observations within the window and random errors of the model.
const WATER: &str = r#"
title = "Water"
phenomenon = "None"
source = "The tests"
seed = 5
start = "2026-01-15T00:00:00Z"
grid = { nx = 10, ny = 8, dx_km = 150, boundary = "channel" }
background_error = { components = [{ kind = "balanced", sigma_height_m = 15, length_km = 400 }] }
model_error = { components = [{ kind = "balanced", sigma_height_m = 2, length_km = 400 }] }
cycle = { count = 7, window_hours = 3, score_from_cycle = 2 }
[methods]
free = { kind = "free" }
kf = { kind = "kf" }
[networks.sondes]
kind = "radiosonde"
stations = { regular = [3, 3] }
groups = ["A", "B"]
reference_groups = ["A"]
times_per_window = 3
sigma_height_m = 5
sigma_wind_m_per_s = 1.5
bias = [{ per = "group", variable = "h", sigma = 8 }]
[[forcing]]
variable = "h"
amplitude_per_day = 20
time = { kind = "sinusoid", period_hours = 17 }
"#;

const SHARED: &str = "time_step_s = 600\ncoriolis_per_s = 1.1e-4\nhyperdiffusion_m4_per_s = 1e14\ndrag_per_s = 1e-6\n";

const JET: &str = "kind = \"jet\"\nspeed_m_per_s = 20\nwidth_km = 250\n";

/// Two kinds of models with the same variables.
struct Kinds {
    /// `[model]` and `[initial]`.
    whole: [String; 2],
    /// What `[truth.model]` says of each.
    truth: [&'static str; 2],
    world: String,
}

fn kinds() -> [Kinds; 2] {
    let wind = "wind = { kind = \"uniform\", u_m_per_s = 9, v_m_per_s = 4 }";
    let tracer = format!("time_step_s = 3600\nkind = \"advection\"\n{wind}\n");
    let (model, initial) = (TRACER.find("[model]").unwrap(), TRACER.find("[initial]").unwrap());
    let methods = "[methods]\nfree = { kind = \"free\" }\nkf = { kind = \"kf\" }\n";
    [
        Kinds {
            whole: [
                format!("[model]\nkind = \"shallow_water\"\n{SHARED}[initial]\nmean_depth_m = 900\n{JET}"),
                format!("[model]\nkind = \"linear_shallow_water\"\nmean_depth_m = 900\n{SHARED}[initial]\n{JET}"),
            ],
            truth: ["kind = \"shallow_water\"", "kind = \"linear_shallow_water\"\nmean_depth_m = 900"],
            world: WATER.into(),
        },
        Kinds {
            whole: [
                format!("[model]\n{tracer}"),
                "[model]\nkind = \"exact_shift\"\ntime_step_s = 3600\ncolumns_per_step = 1\n".into(),
            ],
            truth: [
                "kind = \"advection\"\nwind = { kind = \"uniform\", u_m_per_s = 9, v_m_per_s = 4 }",
                "kind = \"exact_shift\"\ncolumns_per_step = 1",
            ],
            world: [&TRACER[..model], &TRACER[initial..], methods].concat(),
        },
    ]
}

/// The truth and all that is seen of it is that of a scenario whose whole model is of its kind; methods have the other one, and
/// compute something else.
#[test]
fn a_truth_of_another_kind_is_that_of_a_scenario_of_this_kind() {
    for Kinds { whole, truth, world } in &kinds() {
        for (own, other) in [(0, 1), (1, 0)] {
            let (mixed, _) = listen(&parse(&[world, &whole[other], "[truth.model]\n", truth[own]]));
            let [(of_truth, _), (of_methods, _)] = [own, other].map(|kind| listen(&parse(&[world, &whole[kind]])));
            let cycles = mixed.info.as_ref().unwrap().cycles;
            assert!(mixed.truth.len() == cycles + 1 && mixed.truth == of_truth.truth, "{}", truth[own]);
            let observed = |it: &Listener| postcard::to_stdvec(&it.observed).unwrap();
            assert!(observed(&mixed) == observed(&of_truth), "{}", truth[own]);
            assert!(mixed.truth[&cycles] != of_methods.truth[&cycles], "{}", truth[own]);
            // The free run sees nothing of the truth, and the same methods with the same observations differ by their model.
            let background = |it: &Listener, method: usize| it.analysed[&(method, cycles)].0.state.values().to_vec();
            assert_eq!(background(&mixed, 0), background(&of_methods, 0), "{}", truth[own]);
            assert!(background(&mixed, 1) != background(&of_truth, 1), "{}", truth[own]);
        }
    }
}

/// Keys that both kinds have come from `[model]`, those that only one has do not.
#[test]
fn keys_of_both_kinds_are_inherited_unless_they_are_given() {
    let [Kinds { whole, world, .. }, _] = kinds();
    let truth = |scenario: &Scenario| match &scenario.truth {
        Some(TruthSettings::Twin(twin)) => twin.model.clone(),
        other => panic!("{other:?}"),
    };
    let linear = whole[1].replace("mean_depth_m", "mean_flow_m_per_s = 5\ntime_scheme = \"ssp_rk3\"\nmean_depth_m");
    let inherited = parse(&[&world, &linear, "[truth.model]\nkind = \"shallow_water\"\ndrag_per_s = 3e-6\n"]);
    let model = truth(&inherited);
    let water = model.equations.water().unwrap();
    assert!(model.kind == "shallow_water" && model.equations.basic_state().is_none());
    assert_eq!((water.parameters.coriolis_per_s, water.parameters.drag_per_s), (1.1e-4, 3e-6));
    assert_eq!((model.time_step.seconds(), &model.forcing), (600, &inherited.model.forcing));
    assert!(inherited.truth_has_other_model());
    let explicit = "[truth.model]\nkind = \"shallow_water\"\ntime_scheme = \"ssp_rk3\"\ndrag_per_s = 3e-6\n";
    let bits = |parts: &[&str]| listen(&parse(parts)).0.truth;
    assert!(bits(&[&world, &linear, explicit]) == inherited_truth(&inherited));
    assert!(bits(&[&world, &linear, &explicit.replace("ssp_rk3", "rk4")]) != inherited_truth(&inherited));
    // What belongs to the methods' time scheme is not that of the truth's.
    let plain = whole[0].replace("600", "300");
    let leapfrog = plain.replace("[initial]", "time_scheme = \"leapfrog\"\nrobert_filter = 0.05\n[initial]");
    assert!(bits(&[&world, &leapfrog, "[truth.model]\ntime_scheme = \"rk4\"\n"]) == bits(&[&world, &plain]));
    // The methods' kind says nothing new.
    let same = parse(&[&world, &whole[0], "[truth.model]\nkind = \"shallow_water\"\n"]);
    assert!(!same.truth_has_other_model() && listen(&same).0.truth == bits(&[&world, &whole[0]]));
}

fn inherited_truth(scenario: &Scenario) -> std::collections::BTreeMap<usize, isobar_model::State> {
    listen(scenario).0.truth
}

/// A truth of another kind goes on where a run goes on.
#[test]
fn a_run_in_parts_is_the_same_run_with_a_truth_of_another_kind() {
    let [Kinds { whole, truth, world }, _] = kinds();
    let scenario = parse(&[&world, &whole[1], "[truth.model]\n", truth[0]]);
    let folder = tempfile::tempdir().unwrap();
    let heard = |scenario: &Scenario, name: &str, cycles: usize, from: Option<&str>| {
        let mut listener = Listener::default();
        let from = from.map(|name| folder.path().join(name));
        let outputs = Outputs::of([STATE]);
        let out = folder.path().join(name);
        let options = RunOptions { out, from, threads: Some(1), outputs, ..run_options(folder.path(), cycles) };
        run(scenario, &options, &mut listener).unwrap();
        listener
    };
    let all = heard(&scenario, "all", 7, None);
    let first = heard(&scenario, "first", 3, None);
    let mut later = scenario.clone();
    later.start = later.start + later.cycle.window * 3;
    let rest = heard(&later, "rest", 4, Some("first"));
    assert!(first.truth.iter().chain(&rest.truth).all(|(cycle, state)| all.truth[cycle] == *state));
    assert!(rest.analysed.len() == 8 && rest.analysed.iter().all(|(key, own)| all.analysed[key] == *own));
    // Another truth is not the one before.
    let text = [&world, &*whole[1], "[truth.model]\nkind = \"linear_shallow_water\"\nmean_depth_m = 950\n"].concat();
    let mut other = Scenario::parse(Path::new("tracer.toml"), &text).unwrap();
    other.start = later.start;
    let from = Some(folder.path().join("first"));
    let options = RunOptions { out: folder.path().join("other"), from, ..run_options(folder.path(), 4) };
    let error = run(&other, &options, &mut Listener::default()).unwrap_err().to_string();
    assert!(error.contains("truth.model.kind: \"shallow_water\" before, \"linear_shallow_water\" now"), "{error}");
}

#[test]
fn faults_are_named_with_their_place() {
    let folder = tempfile::tempdir().unwrap();
    let fault = |model: &str, at: &str, wanted: &[&str]| {
        let scenario = VALID.replace("model = { drag_per_s = 1e-6 }", &format!("model = {model}"));
        fs::write(folder.path().join("s.toml"), &scenario).unwrap();
        let output = isobar(folder.path(), &["check", "s.toml"]);
        let said = one_line(&text(&output.stderr));
        assert!(!output.status.success(), "{model}: {said}");
        for wanted in wanted.iter().copied().chain([&*format!("s.toml:{}", place(&scenario, at))]) {
            assert!(said.contains(wanted), "{model}: no {wanted:?} in {said}");
        }
    };
    let other = ["a truth of kind advection has other variables than [model], of kind shallow_water"];
    let wanted = [other[0], "must be one of shallow_water, linear_shallow_water"];
    fault("{ kind = \"advection\" }", "\"advection\" }", &wanted);
    fault("{ kind = \"linear_shalow_water\" }", "\"linear_shalow", &["did you mean \"linear_shallow_water\"?"]);
    fault("{ kind = 3 }", "3 }", &["`truth.model.kind` is a whole number"]);
    fault("{ kind = \"linear_shallow_water\" }", "{ kind = \"linear_", &["`mean_depth_m` is missing in [truth.model]"]);
    fault(
        "{ mean_depth_m = 900 }",
        "mean_depth_m = 900 }",
        &["`mean_depth_m` belongs to kind \"linear_shallow_water\""],
    );
    let linear = |rest: &str| format!("{{ kind = \"linear_shallow_water\", mean_depth_m = 900{rest} }}");
    let step = ["the truth: time step 3600 s exceeds the largest stable one"];
    fault(&linear(", time_step_s = 3600"), "3600 }", &step);
    fault(&linear(", mean_flow_y_m_per_s = 3"), "3 }", &["through the walls of a channel"]);
    fault(&linear(", time_step_s = 1700"), "6\nscore", &["truth.model.time_step_s = 1700"]);
}

#[test]
fn exact_performance_needs_the_methods_model() {
    let [_, Kinds { whole, truth, world }] = kinds();
    let scenario = parse(&[&world, &whole[1], "[truth.model]\n", truth[0]]);
    let error = exact(&scenario, &ExactOptions::default()).unwrap_err().to_string();
    assert!(error.contains("exact performance needs the same model for the truth"), "{error}");
    let same = parse(&[&world, &whole[0], "[truth.model]\n", truth[0]]);
    exact(&same, &ExactOptions::default()).unwrap();
}

#[test]
fn the_kind_is_in_schema_and_reference() {
    let explained = explain("truth.model.kind").unwrap();
    assert!(explained.about.contains("linear_shallow_water"), "{explained:?}");
    assert!(explain("truth.model").unwrap().kinds.iter().any(|(kind, _)| *kind == "exact_shift"));
    let faults_with = |model: &str| {
        let text = VALID.replace("model = { drag_per_s = 1e-6 }", &format!("model = {model}"));
        let value = serde_json::to_value(text.parse::<toml::Table>().unwrap()).unwrap();
        faults(&schema(), &value)
    };
    assert_eq!(faults_with("{ kind = \"linear_shallow_water\", mean_depth_m = 900 }"), Vec::<String>::new());
    assert!(!faults_with("{ kind = \"waves\" }").is_empty());
}
