//! Same scenario, same seed: the same bits, on any number of threads, again and again, after an interruption, and in several
//! runs that go on from each other. For every shipped scenario with all of its methods.

use crate::outputs::Outputs;
use crate::runs::{run_options, scenarios};
use isobar::event::Event;
use isobar::options::CheckpointPolicy;
use isobar::options::RunOptions;
use isobar::output::{STATE, STATE_FILE, Sink, SinkError};
use isobar::progress::Progress;
use isobar::scenario::Scenario;
use std::path::Path;

const CYCLES: usize = 5;

/// A listener that ends the run in a cycle.
struct EndIn(usize);

impl Sink for EndIn {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Observed { window, .. } if window.cycle == self.0 => {
                Err(SinkError { path: "nothing".into(), reason: "this is the end".into() })
            }
            _ => Ok(()),
        }
    }
}

fn options(folder: &Path, threads: usize) -> RunOptions {
    let checkpoints = Some(CheckpointPolicy { minutes: None, cycles: Some(2) });
    RunOptions {
        threads: Some(threads),
        outputs: isobar::output::Outputs::of(["netcdf", STATE]),
        checkpoints,
        ..run_options(folder, CYCLES)
    }
}

fn complete(scenario: &Scenario, threads: usize) -> Outputs {
    let parent = tempfile::tempdir().unwrap();
    isobar::run::run(scenario, &options(parent.path(), threads), &mut Progress::new(true)).unwrap();
    Outputs::of(&parent.path().join("run"))
}

fn resumed(scenario: &Scenario) -> Outputs {
    let parent = tempfile::tempdir().unwrap();
    let error = isobar::run::run(scenario, &options(parent.path(), 2), &mut EndIn(4)).unwrap_err();
    assert!(error.to_string().contains("this is the end"), "{error}");
    assert!(!parent.path().join("run").exists());
    let options = RunOptions { resume: true, ..options(parent.path(), 8) };
    isobar::run::run(scenario, &options, &mut Progress::new(true)).unwrap();
    assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 1, "something was left");
    Outputs::of(&parent.path().join("run"))
}

/// The final state of the last of two runs that do the cycles of one.
fn in_two_runs(scenario: &Scenario) -> Vec<u8> {
    let parent = tempfile::tempdir().unwrap();
    let yesterday = parent.path().join("yesterday");
    let first = RunOptions { out: yesterday.clone(), cycles: Some(2), ..options(parent.path(), 2) };
    isobar::run::run(scenario, &first, &mut Progress::new(true)).unwrap();
    let second = RunOptions { from: Some(yesterday), cycles: Some(CYCLES - 2), ..options(parent.path(), 1) };
    let mut tomorrow = scenario.clone();
    tomorrow.start = scenario.start + scenario.cycle.window * 2;
    isobar::run::run(&tomorrow, &second, &mut Progress::new(true)).unwrap();
    std::fs::read(parent.path().join("run").join(STATE_FILE)).unwrap()
}

/// Runs on one thread, on two, and on eight after an interruption, all of which must write the same files; returns these. Two
/// runs, of which the second goes on from the first, must end in the same state.
fn checked(scenario: &Scenario) -> Outputs {
    let first = complete(scenario, 1);
    assert!(first.files[STATE_FILE] == in_two_runs(scenario), "{}: other states", scenario.name);
    let of_method = if scenario.forecast.is_some() { 2 } else { 1 };
    let others = if scenario.truth.is_some() { 3 } else { 2 };
    assert_eq!(first.files.len(), of_method * scenario.methods.len() + others, "{}", scenario.name);
    first.assert_same(&complete(scenario, 2), &scenario.name);
    first.assert_same(&resumed(scenario), &scenario.name);
    first
}

/// Checks every second scenario: the others are another test, which runs beside this one.
fn check_every_second(first: usize) {
    let mut files = 0;
    for mut scenario in scenarios().into_iter().skip(first).step_by(2) {
        scenario.cycle.score_from_cycle = 2;
        files += checked(&scenario).files.len();
    }
    assert!(files >= 40, "only {files} files");
}

#[test]
fn threads_and_interruptions_change_no_bit() {
    check_every_second(0);
}

#[test]
fn nor_in_the_other_scenarios() {
    check_every_second(1);
}

/// Those that no shipped scenario has, with all that they may keep from one cycle to the next.
#[test]
fn nor_in_other_methods() {
    let methods = r#"
        [methods]
        climatology = { kind = "climatology" }
        optimal_interpolation = { kind = "optimal_interpolation" }
        four_d_var = { kind = "4dvar", window_cycles = 3 }
        hybrid = { kind = "hybrid_3dvar", ensemble_weight = 0.5, members = 6, localization_radius_km = 400 }
        serial_kf = { kind = "serial_kf", smoother_lag_cycles = 3 }
        banded = { kind = "banded_kf", half_bandwidth = 40 }
        federated = { kind = "federated_kf", information_sharing = { sondes = 0.7, polar = 0.3 }, reset_every_cycles = 2 }
        federated_fast = { kind = "federated_fkf", factors = 20, information_sharing = { sondes = 0.7, polar = 0.3 } }
        federated_no_reset = { kind = "federated_kf", reset_every_cycles = 0 }
        adaptive_kf = { kind = "kf", smoother_lag_cycles = 2, adapt = { observation_error = true, model_error = true, memory_cycles = 5 } }
        adaptive_fkf = { kind = "fkf", factors = 20, adapt = { observation_error = true, model_error = true } }
        single_fkf = { kind = "fkf", factors = 20, factor_precision = "single", adapt = { model_error = true } }
        local_fkf = { kind = "fkf", local_factors = { per_tile = 4, tile_km = 200, support_km = 400, mixed = 1 }, factor_precision = "single", smoother_lag_cycles = 2 }
        adaptive_var = { kind = "3dvar", adapt = { background_error = true } }
        etkf = { kind = "etkf", members = 12, inflation = "adaptive", smoother_lag_cycles = 3 }
        letkf = { kind = "letkf", members = 6, localization_radius_km = 400, inflation = "adaptive", smoother_lag_cycles = 3 }
        enkf = { kind = "enkf", members = 6, localization_radius_km = 400, relaxation_to_prior_spread = 0.5, smoother_lag_cycles = 2 }
    "#;
    let model_error = "[model_error]\ncomponents = [{ kind = \"white\", variable = \"h\", sigma = 1 }]\n";
    let valid = include_str!("common/valid.toml").split("[methods.free]").next().unwrap().to_string();
    let air_mass = "[[networks.polar.bias]]\nterm = \"air_mass\"\nvariable = \"u\"\nmean = 3\nscale = 5\nsigma = 8\n";
    let forecast = "[forecast]\nlead_hours = 18\n";
    let text = valid + air_mass + model_error + forecast + methods;
    checked(&Scenario::parse(Path::new("others.toml"), &text).unwrap());
}
