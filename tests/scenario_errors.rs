//! Faults in scenario files, as the user of the program sees them.

mod time_volume;

use crate::common::{VALID, isobar, place, place_from, text};
use std::fs;
use tempfile::tempdir;

/// What is replaced in a valid scenario, by what, the line and column of the fault, and what the message must say.
type Case = (&'static str, &'static str, &'static str, &'static [&'static str]);

const CASES: &[Case] = &[
    (
        "nx = 8",
        "nxx = 8",
        "nxx",
        &["unknown key `nxx` in [grid]", "did you mean `nx`?", "valid keys here: nx, ny, dx_km"],
    ),
    (
        "[cycle]",
        "[sensors]\nwrites = \"fkf\"\n[cycle]",
        "[sensors]",
        &["`database` is missing in [sensors]", "must be given here"],
    ),
    (
        "[cycle]",
        "[sensors]\ndatabase = \"a.db\"\nwrites = \"free\"\n[cycle]",
        "\"free\"",
        &["`sensors.writes` cannot be \"free\": no method of this name estimates biases", "one of fkf"],
    ),
    (
        "[cycle]",
        "[sensors]\ndatabase = \"a.db\"\nwrite = \"fkf\"\n[cycle]",
        "write =",
        &["unknown key `write` in [sensors]", "did you mean `writes`?"],
    ),
    (
        "[cycle]",
        "[stability]\nfreeze_after_cycles = 11\n[cycle]",
        "11",
        &["`stability.freeze_after_cycles` is 11", "from 1 to 10"],
    ),
    ("[cycle]", "[stability]\nfreeze_unstable_cycles = 0\n[cycle]", "0", &["`stability.freeze_unstable_cycles` is 0"]),
    (
        "[cycle]",
        "[stability]\nfreeze_after_cycles = 5\nfreeze_unstable_cycles = 3\n[cycle]",
        "freeze_unstable_cycles =",
        &[
            "after one cycle for good, or while they have no stable update",
            "leave out this key or `freeze_after_cycles`",
        ],
    ),
    (
        "[cycle]",
        "[stability]\nthaw_stable_cycles = 3\n[cycle]",
        "thaw_stable_cycles =",
        &["nothing is frozen that could be adjusted again", "give `freeze_unstable_cycles` as well"],
    ),
    (
        "[cycle]",
        "[forecast]\nlead_hours = 20\n[cycle]",
        "20",
        &["`forecast.lead_hours` is 20, which is not a whole number of cycles of 6 hours", "must be a multiple of 6"],
    ),
    (
        "[cycle]",
        "[forecast]\nlead_hours = 54\n[cycle]",
        "54",
        &[
            "is 9 cycles: a forecast from cycle 2, the first that counts, would end after the last, cycle 10",
            "at most 48",
        ],
    ),
    (
        "[cycle]",
        "[forecast]\nlead_hours = 48\nevery_hours = 18\n[cycle]",
        "18",
        &["`forecast.lead_hours` is 8 cycles, which is no multiple of the 3 cycles of `forecast.every_hours`"],
    ),
    ("[cycle]", "[forecast]\nevery_hours = 6\n[cycle]", "[forecast]", &["`lead_hours` is missing in [forecast]"]),
    (
        "[cycle]",
        "[forecast]\nlead_hours = 12\nfrom_every = 2\n[cycle]",
        "from_every",
        &["unknown key `from_every` in [forecast]", "did you mean `from_every_cycles`?"],
    ),
    ("[cycle]", "[stability]\nvariance_ratio = 1\n[cycle]", "1\n[cycle]", &["from 0.000001 to 0.999"]),
    ("[model]", "[modle]", "modle", &["unknown key `modle` at the top level", "did you mean `model`?"]),
    ("nx = 8", "nx = \"8\"", "\"8\"", &["`grid.nx` is a string", "must be a whole number from 4 to 4096"]),
    ("nx = 8", "nx = 8.5", "8.5", &["`grid.nx` is a number", "whole number"]),
    ("nx = 8", "nx = 3", "3\n", &["`grid.nx` is 3", "from 4 to 4096"]),
    ("nx = 8", "nx = 99999999999999999999999", "9999999", &["`grid.nx` is 99999", "from 4 to 4096"]),
    ("nx = 8\n", "", "[grid]", &["`nx` is missing in [grid]"]),
    ("dx_km = 100", "dx_km = nan", "nan", &["`grid.dx_km` is NaN", "from 0.001 to 10000"]),
    ("dx_km = 100", "dx_km = 1e400", "1e400", &["`grid.dx_km` is inf"]),
    (
        "\"channel\"",
        "\"chanel\"",
        "\"chanel\"",
        &["cannot be \"chanel\"", "did you mean \"channel\"?", "periodic, channel"],
    ),
    (
        "kind = \"shallow_water\"",
        "kind = \"shalow_water\"",
        "\"shalow_water\"",
        &["did you mean \"shallow_water\"?", "exact_shift"],
    ),
    ("kind = \"shallow_water\"\n", "", "[model]", &["`kind` is missing in [model]", "\"advection\""]),
    ("drag_per_s = 0", "mean_flow_m_per_s = 3", "mean_flow_m_per_s", &["belongs to kind \"linear_shallow_water\""]),
    (
        "drag_per_s = 0\n",
        "drag_per_s = 0\nrobert_filter = 0.1\n",
        "robert_filter",
        &["only leapfrog has this filter", "time_scheme = \"leapfrog\""],
    ),
    ("drag_per_s = 0\n", "time_scheme = \"leapfrog\"\nrobert_filter = 0.7\n", "0.7", &["robert_filter", "0.5"]),
    ("window_hours = 6", "window_hours = 0.7", "0.7", &["not a whole multiple of model.time_step_s = 600 s"]),
    ("score_from_cycle = 2", "score_from_cycle = 12", "12", &["`cycle.score_from_cycle` is 12", "from 1 to 10"]),
    ("count = 10", "count = 0", "0\n", &["`cycle.count` is 0", "from 1 to 1000000"]),
    ("count = 10", "count = 10000000", "10000000", &["from 1 to 1000000"]),
    ("sigma_height_m = 12", "sigma_height_m = -12", "-12", &["greater than 0"]),
    ("variable = \"h\"\nsigma = 20", "variable = \"z\"\nsigma = 20", "\"z\"", &["valid values: h, u, v"]),
    ("missing_rate = 0.1", "missing_rate = 1.0", "1.0", &["from 0 to below 1"]),
    (
        "reference_groups = [\"A\"]",
        "reference_groups = [\"\"]",
        "\"\"]",
        &["`networks.sondes.reference_groups[0]` is empty"],
    ),
    ("reference_groups = [\"A\"]", "reference_groups = [\"C\"]", "\"C\"]", &["valid values: A, B"]),
    (
        "{ regular = [3, 2] }",
        "{ file = \"no.csv\" }",
        "\"no.csv\"",
        &["no.csv does not exist", "relative to this scenario"],
    ),
    ("{ regular = [3, 2] }", "{ regular = [3, 2], random = 3 }", "{ regular", &["exactly one of"]),
    ("{ regular = [3, 2] }", "{ random = 10000000 }", "10000000", &["from 1 to 100000"]),
    (
        "kind = \"jet\"",
        "kind = \"cosine_wave\"",
        "\"cosine_wave\"",
        &["valid values: rest, jet, vortices, random_balanced"],
    ),
    ("coriolis_per_s = 1e-4", "coriolis_per_s = 0", "\"jet\"", &["needs rotation"]),
    ("[methods.fkf]", "[methods.\"../fkf\"]", "\"../fkf\"", &["\"../fkf\" cannot be the name of a method"]),
    ("blocks = \"cell\"", "blocks = \"cel\"", "\"cel\"", &["did you mean \"cell\"?"]),
    ("blocks = \"cell\"", "blocks = { tile = [9, 2] }", "9,", &["`methods.fkf.blocks.tile[0]` is 9", "from 1 to 8"]),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"federated_kf\"\ninformation_sharing = { sondes = 0.5, polar = 0.4 }",
        "{ sondes = 0.5",
        &["the factors of `methods.fkf.information_sharing` sum to 0.9", "must sum to 1"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"federated_kf\"\ninformation_sharing = { sondes = 0.5, polars = 0.5 }",
        "polars",
        &["unknown key `polars`", "did you mean `polar`?"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"federated_fkf\"\nfactors = 4\nbias_coupling = \"drop\"",
        "bias_coupling",
        &["unknown key `bias_coupling`"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"federated_fkf\"\ninformation_sharing = { sondes = 0.5, polar = 0.4 }",
        "{ sondes = 0.5",
        &["the factors of `methods.fkf.information_sharing` sum to 0.9", "must sum to 1"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"banded_kf\"\nhalf_bandwidth = -1",
        "-1",
        &["`methods.fkf.half_bandwidth` is -1"],
    ),
    (
        "blocks = \"cell\"",
        "adapt = { memory_cycles = 5 }",
        "{ memory_cycles",
        &["`methods.fkf.adapt` adapts nothing", "needs `observation_error = true` or `model_error = true`"],
    ),
    (
        "blocks = \"cell\"",
        "adapt = { model_error = true }",
        "{ model_error",
        &["there is no model error that could be adapted", "needs components in [model_error]"],
    ),
    (
        "blocks = \"cell\"",
        "adapt = { background_error = true }",
        "background_error",
        &["unknown key `background_error` in [methods.fkf.adapt]"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"federated_kf\"\ninformation_sharing = { sondes = 1 }",
        "{ sondes = 1",
        &["`polar` is missing in [methods.fkf.information_sharing]"],
    ),
    (
        "blocks = \"cell\"",
        "factors = 4\nfactor_grid = 8",
        "8\n",
        &["cells of 8 × 8 do not make a grid", "1, 2, 4 or 8, divide both sides and leave at least 4 cells"],
    ),
    (
        "blocks = \"cell\"",
        "factors = 4\nfactor_precision = \"half\"",
        "\"half\"",
        &["`methods.fkf.factor_precision` cannot be \"half\"", "valid values: double, single"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 2\nfactor_precision = \"single\"",
        "factor_precision",
        &["unknown key `factor_precision` in [methods.fkf]"],
    ),
    (
        "title = \"A test\"",
        "regression = 1\ntitle = \"A test\"",
        "1\n",
        &["`regression` is a whole number", "true or false"],
    ),
    (
        "blocks = \"cell\"",
        "largest_component = 0",
        "0\n",
        &["`methods.fkf.largest_component` is 0", "from 1 to 1000000"],
    ),
    (
        "blocks = \"cell\"",
        "separator_factors = -1",
        "-1\n",
        &["`methods.fkf.separator_factors` is -1", "from 0 to 100000"],
    ),
    (
        "blocks = \"cell\"",
        "factors = { retained = 1.5, at_most = 9 }",
        "1.5",
        &["`methods.fkf.factors.retained` is 1.5", "from 0.01 to 1"],
    ),
    ("blocks = \"cell\"", "factors = { retained = 0.9 }", "{ retained", &["`at_most` is missing"]),
    (
        "blocks = \"cell\"",
        "factors = { kept = 0.9, at_most = 9 }",
        "kept",
        &["unknown key `kept`", "retained, at_most"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"fkf\"\nfactors = \"many\"",
        "\"many\"",
        &["`methods.fkf.factors` cannot be \"many\"", "must be \"auto\" or a whole number from 0 to 100000"],
    ),
    (
        "kind = \"fkf\"",
        "kind = \"fkd\"",
        "\"fkd\"",
        &["did you mean \"fkf\"?", "free, climatology", "etkf, letkf, enkf"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"letkf\"\nmembers = 20",
        "[methods.fkf]",
        &["`localization_radius_km` is missing in [methods.fkf]"],
    ),
    ("kind = \"fkf\"\nblocks = \"cell\"", "kind = \"etkf\"\nmembers = -77", "-77", &["from 2 to 100000"]),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"enkf\"\nmembers = 20\ninflation = \"adaptiv\"",
        "\"adaptiv\"",
        &["did you mean \"adaptive\"?"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"etkf\"\nmembers = 20\nadaptive_inflation_sigma = 0.1",
        "adaptive_inflation_sigma",
        &["without adaptive inflation", "it needs inflation = \"adaptive\""],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"4dvar\"\nwindow_cycles = 0.571",
        "0.571",
        &["a whole number from 1 to 1000"],
    ),
    (
        "[methods.free]",
        "[initialise]\nmethod = \"high-pass\"\ncycles = 11\nbox_km = 300\n\n[methods.free]",
        "11",
        &["an initialisation from 11 cycles is longer than the run of 10"],
    ),
    (
        "[methods.free]",
        "[initialise]\nmethod = \"high-pass\"\ncycles = 4\nbox_km = 300\nmethods = [\"free\"]\n\n[methods.free]",
        "\"free\"",
        &["the method `free` cannot be initialised", "fkf"],
    ),
    (
        "term = \"offset\"",
        "term = \"scan_cubic\"",
        "\"scan_cubic\"",
        &["offset, scan_linear, scan_quadratic, air_mass"],
    ),
    (
        "term = \"offset\"",
        "term = \"air_mass\"\nvariable = \"q\"\nmean = 1000\nscale = 40",
        "\"q\"",
        &["`networks.polar.bias[0].variable` cannot be", "valid values: h, u, v"],
    ),
    (
        "term = \"offset\"",
        "term = \"air_mass\"\nvariable = \"h\"\nmean = 999\nscale = 0",
        "0\n",
        &["`networks.polar.bias[0].scale` is 0.0"],
    ),
    ("term = \"offset\"", "term = \"air_mass\"\nvariable = \"h\"\nscale = 40", "[[networks.polar.bias]]", &["`mean`"]),
    ("term = \"offset\"", "term = \"offset\"\nscale = 40", "scale = 40", &["unknown key `scale`", "air_mass"]),
    ("term = \"offset\"\n", "", "[[networks.polar.bias]]", &["`term` is missing"]),
    ("swath_width_km = 300", "swath_width_km = 3000", "3000", &["narrower than the domain (800 km)"]),
    ("footprint_sigma_km = 50", "footprint_sigma_km = 10", "10\n", &["0 for a point, or 50 km (half of a cell)"]),
    ("missing_rate = 0.1", "first_cycle = 0", "0\n", &["`networks.sondes.first_cycle` is 0", "from 1 to 1000000"]),
    ("along_track_spacing_km = 100", "along_track_spacing_km = 0.001", "0.001", &["at most a million footprints"]),
    ("start = \"2026-01-15T00:00:00Z\"", "start = \"yesterday\"", "\"yesterday\"", &["\"2026-01-15T00:00:00Z\""]),
    ("model = { drag_per_s = 1e-6 }", "model = { drag_per = 1e-6 }", "drag_per ", &["did you mean `drag_per_s`?"]),
    (
        "model = { drag_per_s = 1e-6 }",
        "model = { kind = \"advection\" }",
        "\"advection",
        &["has other variables than [model]"],
    ),
    ("nx = 8", "nx = = 8", "= 8", &["not valid TOML"]),
    ("nx = 8", "nx = 8\nnx = 9", "nx = 9", &["not valid TOML", "duplicate key"]),
    ("title = \"A test\"", "title = \"a\\u001b[31mb\"", "\"a\\u001b", &["contains a control character"]),
];

#[test]
fn every_fault_is_shown_with_its_place_and_what_is_allowed() {
    let directory = tempdir().unwrap();
    let mut faults = Vec::new();
    for (number, (old, new, at, wanted)) in CASES.iter().chain(time_volume::CASES).enumerate() {
        assert!(VALID.contains(old), "case {number}: {old} is not in the valid scenario");
        let broken = VALID.replacen(old, new, 1);
        let changed = VALID.find(old).unwrap();
        let is_new = broken[changed..].starts_with(new) && new.contains(at.trim_end());
        let at = if is_new { place_from(&broken, changed, at) } else { place(&broken, at) };
        let path = directory.path().join("broken.toml");
        fs::write(&path, &broken).unwrap();
        let output = isobar(directory.path(), &["check", "broken.toml"]);
        let message = text(&output.stderr);
        let flat = message.replace("\n  │ ", " ").split_whitespace().collect::<Vec<_>>().join(" ");
        if output.status.code() != Some(1) || !output.stdout.is_empty() {
            faults.push(format!("case {number} ({new}): exit {:?}\n{message}", output.status));
        }
        let place = format!("broken.toml:{at}]");
        for part in std::iter::once(&place.as_str()).chain(*wanted) {
            if !flat.contains(part) {
                faults.push(format!("case {number} ({new}): {part:?} is missing in\n{message}"));
            }
        }
        if message.chars().any(|c| c.is_control() && c != '\n') {
            faults.push(format!("case {number} ({new}): control characters in {message:?}"));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n\n"));
    let left: Vec<_> = fs::read_dir(directory.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["broken.toml"], "something was written");
}

#[test]
fn faults_of_the_file_as_a_whole_are_named() {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("empty.toml"), "").unwrap();
    fs::write(directory.path().join("latin1.toml"), b"title = \"caf\xe9\"\n").unwrap();
    fs::write(directory.path().join("large.toml"), VALID.to_string() + &"#\n".repeat(600_000)).unwrap();
    fs::write(directory.path().join("wide.toml"), "title = \"".to_string() + &"x".repeat(500_000)).unwrap();
    fs::create_dir(directory.path().join("directory.toml")).unwrap();
    for (name, wanted) in [
        ("empty.toml", "`title` is missing"),
        ("latin1.toml", "latin1.toml:1:13]"),
        ("large.toml", "larger than 1000 kB"),
        ("wide.toml", "not valid TOML"),
        ("directory.toml", "it is not a file"),
        ("absent.toml", "there is no file absent.toml"),
    ] {
        let output = isobar(directory.path(), &["check", name]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{name}: {message}");
        assert!(message.contains(wanted), "{name}: {message}");
    }
    assert!(isobar(directory.path(), &["check", "wide.toml"]).stderr.len() < 1000);
}

#[test]
fn control_characters_of_a_broken_file_do_not_reach_the_terminal() {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("evil.toml"), "title = 3 # \u{1b}[2J\u{9b}31m\u{202e}\n\u{1b}]0;x\u{7} = 1\n")
        .unwrap();
    let output = isobar(directory.path(), &["check", "evil.toml"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1));
    assert!(message.contains("evil.toml:1:"), "{message}");
    assert!(!message.chars().any(|c| (c.is_control() && c != '\n') || c == '\u{202e}'), "{message:?}");
}
