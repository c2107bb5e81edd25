//! Faults of a moving time volume.

use super::Case;

pub const CASES: &[Case] = &[
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 11",
        "11",
        &["a window of 11 cycles is longer than the run of 10", "from 1 to 10"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5",
        "[methods.fkf]",
        &["has nothing to estimate over its window", "give `observation_factors`"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\nobservation_factors = [{ name = \"f\", kind = \"constant\", \
         biases = [\"sonde\"] }]",
        "fkf]",
        &["there is no bias `sonde` for a factor to act on", "sondes/h/B"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\nmodel_factors = [{ name = \"f\", kind = \"constant\", variable = \"h\", \
         patterns_file = \"no.csv\" }]",
        "\"no.csv\"",
        &["no.csv does not exist", "relative to this scenario"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\nmodel_factors = [{ name = \"f\", kind = \"constant\", variable = \"h\", \
         patterns_file = \"broken.toml\" }]",
        "\"broken.toml\"",
        &["broken.toml, line 2: a quotation mark", "stands within a field that does not begin with one"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\nmodel_factors = [{ name = \"f\", kind = \"constant\", variable = \"h\", \
         drift_per_sqrt_day = 1 }]",
        "drift_per_sqrt_day",
        &["need a prior", "give `sigma`"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\ntransition_corrections = [{ candidate = \"mean_depth_m\" }]",
        "\"mean_depth_m\"",
        &["no parameter of this model", "possible here: gravity_m_per_s2, drag_per_s, coriolis_per_s"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\ntransition_corrections = [{ candidate = \"drag_per_s\", tiles = [3] }]",
        "[3]",
        &["needs two numbers", "must be [tiles in x, tiles in y]"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\ntransition_corrections = [{ candidate = \"drag_per_s\", tiles = [9, 2] }]",
        "9, 2",
        &["is 9", "from 1 to 8"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\ntransition_corrections = [{ candidate = \"drag_per_s\", tiles = [8, 6] }, \
         { candidate = \"gravity_m_per_s2\", tiles = [8, 6] }, { candidate = \"coriolis_per_s\", tiles = [5, 1] }]",
        "{ candidate = \"coriolis_per_s\"",
        &["the corrections have 101 amplitudes", "must be at most 100 in all"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\ntransition_corrections = [{ candidate = \"drag_per_s\", tiles = [2, 2], \
         patterns_file = \"no.csv\" }]",
        "patterns_file",
        &["stands beside `tiles`", "not both"],
    ),
    (
        "kind = \"fkf\"\nblocks = \"cell\"",
        "kind = \"time_volume\"\nwindow_cycles = 5\ntransition_corrections = [{ candidate = \"drag_per_s\", moves_with_flow = true }]",
        "moves_with_flow",
        &["the same everywhere has nothing that could move", "give `tiles` or `patterns_file`"],
    ),
];
