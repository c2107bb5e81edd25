//! Every time scheme of a scenario: the methods see nothing of it but the forecasts.

use crate::runs::run_options;
use isobar::progress::Progress;
use isobar::scenario::Scenario;
use std::path::Path;

/// RMSE of the analysis of h for `fkf` and `four_d_var` in the quickstart with a time scheme and a step \[s\].
fn errors(time_scheme: &str, time_step_s: i64) -> [f64; 2] {
    let text = include_str!("../scenarios/quickstart.toml").split("[methods.").next().unwrap();
    let methods =
        "[methods]\nfkf = { kind = \"fkf\", factors = 40 }\nfour_d_var = { kind = \"4dvar\", window_cycles = 2 }\n";
    let text = format!("{text}{methods}")
        .replace("time_scheme = \"rk4\"", &format!("time_scheme = \"{time_scheme}\""))
        .replace("time_step_s = 1200", &format!("time_step_s = {time_step_s}"));
    let mut scenario =
        Scenario::parse(&Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/scheme.toml"), &text).unwrap();
    scenario.cycle.score_from_cycle = 2;
    let parent = tempfile::tempdir().unwrap();
    let summary = isobar::run::run(&scenario, &run_options(parent.path(), 5), &mut Progress::new(true)).unwrap();
    ["fkf", "four_d_var"].map(|method| summary.methods[method].values["rmse_analysis.h"])
}

/// The truth of each run has the model's own scheme, so that the schemes differ by how the weather went a little, and by
/// nothing else: tangent-linear and adjoint serve the filter and 4D-Var as well. Leapfrog, begun anew in every cycle, needs a short
/// step.
#[test]
fn methods_are_as_good_with_any_time_scheme() {
    let expected = errors("rk4", 720);
    for (scheme, time_step_s) in [("ssp_rk3", 720), ("leapfrog", 200)] {
        for (found, expected) in errors(scheme, time_step_s).into_iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 0.05, "{scheme}: {found} m, not {expected} m");
        }
    }
}
