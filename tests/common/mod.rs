//! What the tests of the program have in common.

use std::path::Path;
use std::process::{Command, Output};

/// A small scenario that uses most keys.
pub const VALID: &str = include_str!("valid.toml");

/// A tracer that does not move, on the cells of a small grid, without networks and methods.
pub const TRACER: &str = r#"title = "t"
phenomenon = "p"
source = "s"
seed = 1
start = "2026-01-15T00:00:00Z"
[grid]
nx = 16
ny = 12
dx_km = 100
boundary = "periodic"
[model]
kind = "exact_shift"
time_step_s = 3600
columns_per_step = 0
[initial]
kind = "cosine_wave"
amplitude = 0
[background_error]
components = [{ kind = "univariate", variable = "tracer", sigma = 1, length_km = 200 }]
[cycle]
count = 1
window_hours = 6
"#;

/// A tracer that a uniform wind carries: a linear model, with model errors and biased stations.
pub const CARRIED_TRACER: &str = r#"
title = "A tracer"
phenomenon = "None"
source = "The tests"
seed = 3
start = "2026-01-15T00:00:00Z"
[grid]
nx = 9
ny = 6
dx_km = 100
boundary = "periodic"
[model]
kind = "advection"
time_step_s = 3600
wind = { kind = "uniform", u_m_per_s = 9, v_m_per_s = 4 }
scheme = "first_order_upwind"
[initial]
kind = "cosine_wave"
amplitude = 1
waves_x = 2
[background_error]
components = [{ kind = "univariate", variable = "tracer", sigma = 0.5, length_km = 200 }]
[model_error]
components = [{ kind = "univariate", variable = "tracer", sigma = 0.15, length_km = 200 }]
[cycle]
count = 14
window_hours = 6
score_from_cycle = 3
[networks.fixed]
kind = "radiosonde"
stations = { regular = [3, 3] }
groups = ["A", "B"]
reference_groups = ["A"]
missing_rate = 0.0
observe = { tracer = 0.2 }
[[networks.fixed.bias]]
per = "group"
variable = "tracer"
sigma = 0.3
"#;

/// Runs the program in a directory.
pub fn isobar(directory: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(directory).args(arguments).env("NO_COLOR", "1").env("LC_ALL", "C.UTF-8").env_remove("COLUMNS");
    command.output().expect("the program can be started")
}

/// The script of every page.
pub const SCRIPT: &str = include_str!("../../src/output/report/script.js");

/// A page without its one script; a figure as it is.
pub fn without_script(page: &str) -> String {
    page.replacen(&format!("<script>{SCRIPT}</script>"), "", 1)
}

/// Output of the program.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("the program writes UTF-8")
}

/// What the program says in frames and broken lines, as one line.
pub fn one_line(text: &str) -> String {
    text.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Line and column, from 1, of `part` in `text`.
pub fn place(text: &str, part: &str) -> String {
    place_from(text, 0, part)
}

/// As [`place`], for the first `part` from byte `from` on.
pub fn place_from(text: &str, from: usize, part: &str) -> String {
    let start = from + text[from..].find(part).unwrap_or_else(|| panic!("{part} is not in the scenario"));
    let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
    format!("{}:{}", text[..start].matches('\n').count() + 1, start - line_start + 1)
}
