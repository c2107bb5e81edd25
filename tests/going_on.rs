//! Runs that go on from each other: what they compute is what one run computes, and what cannot go on is refused.

use crate::ahead::{Listener, TRACER, parse};
use crate::runs::run_options;
use isobar::options::RunOptions;
use isobar::output::{Outputs, STATE, STATE_FILE};
use isobar::run::run;
use isobar::scenario::Scenario;
use std::fs;
use std::path::{Path, PathBuf};

/// All that a method may keep from one cycle to the next.
const METHODS: &str = r#"
[methods]
free = { kind = "free" }
var = { kind = "3dvar", adapt = { background_error = true } }
four = { kind = "4dvar", window_cycles = 3 }
hybrid = { kind = "hybrid_3dvar", ensemble_weight = 0.5, members = 6, localization_radius_km = 400 }
kf = { kind = "kf", smoother_lag_cycles = 2, adapt = { observation_error = true, model_error = true, memory_cycles = 5 } }
serial = { kind = "serial_kf", smoother_lag_cycles = 3 }
banded = { kind = "banded_kf", half_bandwidth = 20 }
fkf = { kind = "fkf", blocks = "cell", factors = 8, adapt = { model_error = true } }
persist = { kind = "fkf", factors = 8, residual = "persist" }
local = { kind = "fkf", local_factors = { per_tile = 3, tile_km = 300 }, smoother_lag_cycles = 2 }
volume = { kind = "time_volume", factors = 6, window_cycles = 4, observation_factors = [{ name = "daily", kind = "sinusoid", period_hours = 24, biases = ["fixed/tracer"] }] }
federated = { kind = "federated_kf", reset_every_cycles = 2 }
federated_fast = { kind = "federated_fkf", factors = 6, reset_every_cycles = 2 }
etkf = { kind = "etkf", members = 12, inflation = "adaptive", smoother_lag_cycles = 3 }
letkf = { kind = "letkf", members = 6, localization_radius_km = 400, inflation = "adaptive", smoother_lag_cycles = 2 }
enkf = { kind = "enkf", members = 6, localization_radius_km = 400, relaxation_to_prior_spread = 0.5, smoother_lag_cycles = 3 }
"#;

/// What depends on the number of a cycle or on the time since the first.
const AROUND: &str = r#"
[quality_control]
gross_error_limit = 4
length_km = 300
[forecast]
lead_hours = 24
every_hours = 12
from_every_cycles = 2
[diagnostics]
influence_every_cycles = 4
[networks.moving]
kind = "radiosonde"
stations = { random = 4 }
groups = ["C", "D"]
missing_rate = 0.2
interval_cycles = 2
first_cycle = 6
faults = { gross_error_rate = 0.1, gross_error_factor = 20, late_rate = 0.1 }
observe = { tracer = 0.3 }
[[networks.moving.bias]]
per = "group"
variable = "tracer"
sigma = 0.3
evolution = { kind = "random_walk", sigma_per_sqrt_day = 0.2 }
[networks.jumping]
kind = "radiosonde"
stations = { regular = [2, 2] }
groups = ["E"]
times_per_window = 3
observe = { tracer = 0.2 }
[[networks.jumping.bias]]
per = "group"
variable = "tracer"
sigma = 0.3
evolution = { kind = "jump", at_hours = 33, size = 1 }
"#;

/// A run that keeps its state, and all that it says.
fn heard(scenario: &Scenario, options: &RunOptions) -> Listener {
    let mut listener = Listener::default();
    run(scenario, options, &mut listener).unwrap();
    listener
}

fn options(folder: &Path, name: &str, cycles: usize) -> RunOptions {
    let outputs = Outputs::of([STATE]);
    RunOptions { out: folder.join(name), threads: Some(1), outputs, ..run_options(folder, cycles) }
}

fn state(folder: &Path, name: &str) -> Vec<u8> {
    fs::read(folder.join(name).join(STATE_FILE)).unwrap()
}

/// Runs the cycles one after the other in as many runs as there are numbers, each going on from the one before; what all of them
/// say, and the directory of the last.
fn in_parts(folder: &Path, scenario: &Scenario, parts: &[usize]) -> (Listener, String) {
    let (mut all, mut done, mut from) = (Listener::default(), 0, None::<PathBuf>);
    for (number, &cycles) in parts.iter().enumerate() {
        let start = scenario.start + scenario.cycle.window * done;
        let mut scenario = scenario.clone();
        scenario.start = start;
        let name = format!("part_{number}");
        let options = RunOptions { from, ..options(folder, &name, cycles) };
        let part = heard(&scenario, &options);
        let info = part.info.unwrap();
        assert_eq!((info.done, info.cycles), (done, done + cycles));
        assert_eq!((info.begin(), info.count()), (start, cycles));
        assert!(part.analysed.keys().all(|(_, cycle)| (done + 1..=done + cycles).contains(cycle)));
        all.analysed.extend(part.analysed);
        all.observed.extend(part.observed);
        all.truth.extend(part.truth);
        all.forecasts.extend(part.forecasts);
        all.verdicts.extend(part.verdicts);
        (done, from) = (done + cycles, Some(options.out));
    }
    (all, format!("part_{}", parts.len() - 1))
}

/// Every estimate, observation, truth, forecast and score is that of one run, and so is the state at the end.
fn assert_same_in_parts(scenario: &Scenario, parts: &[usize]) {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let cycles = parts.iter().sum();
    let whole = heard(scenario, &options(folder, "whole", cycles));
    let (all, last) = in_parts(folder, scenario, parts);
    assert_eq!(whole.analysed.len(), cycles * scenario.methods.len());
    assert!(whole.forecasts.len() > scenario.methods.len() || scenario.forecast.is_none());
    assert!(whole.analysed.keys().eq(all.analysed.keys()));
    for (key, own) in &whole.analysed {
        assert_eq!(*own, all.analysed[key], "method and cycle {key:?}");
    }
    let observed = |it: &Listener| postcard::to_stdvec(&it.observed).unwrap();
    assert!(observed(&whole) == observed(&all) && whole.truth == all.truth);
    assert_eq!(whole.verdicts, all.verdicts);
    assert!(
        whole.forecasts.keys().eq(all.forecasts.keys()),
        "{:?}, {:?}",
        whole.forecasts.keys(),
        all.forecasts.keys()
    );
    for (key, own) in &whole.forecasts {
        assert_eq!(*own, all.forecasts[key], "method, start and lead {key:?}");
    }
    assert!(state(folder, "whole") == state(folder, &last), "other states at the end");
}

#[test]
fn a_run_in_parts_is_the_same_run_with_all_methods() {
    let scenario = parse(&[TRACER, AROUND, METHODS]);
    assert_same_in_parts(&scenario, &[5, 1, 3, 4]);
}

/// Sources of the model, and others of the truth, that change within a cycle and have no period in common with it.
const SOURCES: &str = r#"
[[forcing]]
variable = "tracer"
amplitude_per_day = 2
pattern = { kind = "gaussian_hill", width_km = 200 }
time = { kind = "sinusoid", period_hours = 17, phase_hours = 3 }
[[truth.forcing]]
variable = "tracer"
amplitude_per_day = 3
pattern = { kind = "cosine_wave", waves_y = 1 }
time = { kind = "sinusoid", period_hours = 29 }
"#;

/// Time goes on where a run goes on, and does not begin anew.
#[test]
fn a_run_in_parts_is_the_same_run_with_a_forcing() {
    let scenario = parse(&[TRACER, AROUND, SOURCES, METHODS]);
    assert_same_in_parts(&scenario, &[5, 1, 3, 4]);
}

/// The high-pass filter's first cycles, and parameters that are frozen after a cycle, may lie in one run or another.
#[test]
fn first_calibration_and_freezing_go_on() {
    let frozen = "[initialise]\nmethod = \"high-pass\"\nmethods = [\"kf\"]\ncycles = 5\nbox_km = 400\n[stability]\nfreeze_after_cycles = 7\n\
        [methods]\nkf = { kind = \"kf\" }\nfkf = { kind = \"fkf\", factors = 6 }\n";
    assert_same_in_parts(&parse(&[TRACER, frozen]), &[3, 6, 2]);
    let compared = frozen.replace(
        "[stability]",
        "[[comparisons]]\nsensor = \"fixed/tracer/B\"\ntime = \"2026-01-15T13:00:00Z\"\nsigma = 0.1\n\
        [[comparisons]]\nsensor = \"fixed/tracer/B\"\ntime = \"2026-01-17T13:00:00Z\"\nsigma = 0.1\n[stability]",
    );
    assert_same_in_parts(&parse(&[TRACER, &compared]), &[3, 6, 2]);
    let by_rule = frozen.replace(
        "freeze_after_cycles = 7",
        "variance_ratio = 0.02\nfreeze_unstable_cycles = 2\nthaw_stable_cycles = 3",
    );
    assert_same_in_parts(&parse(&[TRACER, &by_rule]), &[3, 1, 5, 2]);
}
