//! Runs with fixed-lag smoothers: what their files and scores say, and what is refused.

use crate::runs::run_options;
use isobar::output::Sink;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use netcdf_reader::NcFile;
use std::path::Path;

/// A small scenario that uses most keys.
const VALID: &str = include_str!("common/valid.toml");

const LAG: usize = 3;
const CYCLES: usize = 9;
const FILL_VALUE: f64 = 9.96921e36;

/// The small scenario with these methods.
fn scenario(methods: &str) -> String {
    VALID.split("[methods.free]").next().unwrap().to_string() + methods
}

fn complete(text: &str, look: impl FnOnce(&Path, &Summary)) {
    let scenario = Scenario::parse(Path::new("small.toml"), text).unwrap_or_else(|error| panic!("{error}"));
    let folder = tempfile::tempdir().unwrap();
    let options = isobar::options::RunOptions {
        outputs: isobar::output::Outputs::of(["netcdf"]),
        ..run_options(folder.path(), CYCLES)
    };
    let summary = run(&scenario, &options, &mut Vec::<Box<dyn Sink>>::new()).unwrap();
    look(&folder.path().join("run"), &summary);
}

fn numbers(file: &NcFile, name: &str) -> Vec<f64> {
    let values = file.read_variable::<f64>(name).unwrap_or_else(|error| panic!("{name}: {error}"));
    values.iter().copied().collect()
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|value| value * value).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

const METHODS: &str = r#"
[methods]
kf = { kind = "kf", smoother_lag_cycles = 3 }
serial_kf = { kind = "serial_kf", smoother_lag_cycles = 3 }
etkf = { kind = "etkf", members = 60, smoother_lag_cycles = 3 }
letkf = { kind = "letkf", members = 30, localization_radius_km = 600, smoother_lag_cycles = 3 }
enkf = { kind = "enkf", members = 60, localization_radius_km = 900, smoother_lag_cycles = 3 }
local = { kind = "fkf", local_factors = { per_tile = 12, tile_km = 300 }, smoother_lag_cycles = 3 }
plain = { kind = "kf" }
"#;

/// Scores are counted from cycle 2 on.
#[test]
fn smoothed_estimates_stand_at_their_own_time_and_are_scored_there() {
    complete(&scenario(METHODS), |run, summary| {
        let truth = NcFile::open(run.join("truth.nc")).unwrap();
        for method in ["kf", "serial_kf", "etkf", "letkf", "enkf", "local"] {
            let file = NcFile::open(run.join(format!("{method}.nc"))).unwrap();
            let later: Vec<f64> = (1..=CYCLES).map(|cycle| LAG.min(CYCLES - cycle) as f64).collect();
            assert_eq!(numbers(&file, "smoother_later_cycles"), later, "{method}");
            let scores = &summary.methods[method];
            let score = |kind: &str, name: &str| scores.values[&format!("{kind}.{name}")];
            assert_eq!(scores.smoother_lag_cycles, Some(LAG));
            for name in ["h", "u", "v"] {
                let read = |stage: &str| numbers(&file, &format!("{name}_{stage}"));
                let (analysis, estimate, spread) = (read("analysis"), read("smoothed"), read("smoothed_spread"));
                let cells = estimate.len() / CYCLES;
                let last = (CYCLES - 1) * cells..;
                assert_eq!(relative(&estimate[last.clone()], &analysis[last]), 0.0, "{method}, {name}");
                assert!(relative(&estimate[..cells], &analysis[..cells]) > 1e-3);
                // The truth has a record before the first cycle.
                let (true_values, claims) = (numbers(&truth, name), spread.into_iter().skip(cells));
                let errors = estimate.iter().zip(&true_values[cells..]).map(|(a, b)| a - b).skip(cells);
                assert!(
                    (root_mean_square(errors) / score("rmse_smoothed", name) - 1.0).abs() < 1e-9,
                    "{method}, {name}"
                );
                let claimed = score("spread_smoothed", name);
                assert!((root_mean_square(claims) / claimed - 1.0).abs() < 1e-9);
                assert!(claimed < score("spread_analysis", name), "{method}, {name}");
            }
            let (biases, true_biases) = (numbers(&file, "calibration_smoothed"), numbers(&truth, "calibration"));
            let parameters = biases.len() / CYCLES;
            let errors = biases.iter().zip(&true_biases[parameters..]).map(|(a, b)| a - b);
            let expected = scores.values["bias_rmse_smoothed"];
            assert!((root_mean_square(errors.skip(parameters)) / expected - 1.0).abs() < 1e-9, "{method}");
            assert!(scores.values["bias_spread_smoothed"] < scores.values["bias_spread"]);
        }
        scores_of_cycles_are_those_of_the_run(run, summary);
        // The same filter, and the same smoother whichever way it analyses.
        let of = |method: &str| &summary.methods[method];
        for name in ["h", "u", "v"].map(|name| format!("rmse_analysis.{name}")) {
            assert_eq!(of("kf").values[&name], of("plain").values[&name]);
        }
        assert!(of("plain").smoother_lag_cycles.is_none());
        let [all, serial] = ["kf", "serial_kf"].map(|method| &of(method).values["rmse_smoothed.h"]);
        assert!((all / serial - 1.0).abs() < 1e-6, "{all} and {serial}");
        let table = isobar::tables::scores::on_terminal(summary, &[("h", "m"), ("u", "m s-1"), ("v", "m s-1")], 100);
        let part = table.split("as later observations revise them").nth(1).expect("there is a table of them");
        let rows: Vec<&str> = part.lines().filter(|line| line.contains(" 3 ")).collect();
        assert!(rows.len() == 6 && table.lines().all(|line| line.chars().count() <= 100), "{table}");
    });
}

/// The roots of the mean squares of the columns of `scores.csv`, over the cycles that count.
fn scores_of_cycles_are_those_of_the_run(run: &Path, summary: &Summary) {
    let mut table = csv::Reader::from_path(run.join("scores.csv")).unwrap();
    let header = table.headers().unwrap().clone();
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), CYCLES * summary.methods.len());
    assert!(rows.windows(2).all(|pair| cycle_of(&pair[0]) <= cycle_of(&pair[1])), "they are in the order of cycles");
    for (method, scores) in &summary.methods {
        let own = || rows.iter().filter(|row| row[2] == **method);
        let column = |name: &str| -> Vec<&str> {
            let place = header.iter().position(|it| it == name).unwrap_or_else(|| panic!("{name} in {header:?}"));
            own().map(|row| &row[place]).collect()
        };
        if scores.smoother_lag_cycles.is_none() {
            assert!(column("rmse_smoothed h [m]").iter().all(|field| field.is_empty()));
            assert!(column("bias_spread_smoothed").iter().all(|field| field.is_empty()));
            continue;
        }
        for (name, key) in [
            ("rmse_smoothed h [m]", "rmse_smoothed.h"),
            ("rmse_smoothed v [m s-1]", "rmse_smoothed.v"),
            ("spread_smoothed u [m s-1]", "spread_smoothed.u"),
            ("bias_rmse_smoothed", "bias_rmse_smoothed"),
            ("bias_spread_smoothed", "bias_spread_smoothed"),
        ] {
            let expected = scores.values[key];
            let figures = column(name).into_iter().skip(summary.scored_from_cycle - 1);
            let all = root_mean_square(figures.map(|field| field.parse::<f64>().unwrap()));
            assert!((all / expected - 1.0).abs() < 1e-9, "{method}, {name}: {all} and {expected}");
        }
    }
}

fn cycle_of(row: &csv::StringRecord) -> usize {
    row[0].parse().unwrap()
}

/// Largest difference relative to the largest value.
fn relative(a: &[f64], b: &[f64]) -> f64 {
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    largest(&mut a.iter().zip(b).map(|(a, b)| (a - b).abs())) / largest(&mut b.iter().map(|b| b.abs()))
}

/// With [initialise] the method analyses for the first time in the batch's last cycle: before it there is nothing to smooth.
#[test]
fn cycles_without_an_analysis_have_no_smoothed_estimate() {
    let methods = "[methods]\nkf = { kind = \"kf\", smoother_lag_cycles = 3 }\n\
                   [initialise]\nmethod = \"high-pass\"\ncycles = 4\nbox_km = 400\n";
    complete(&scenario(methods), |run, summary| {
        let file = NcFile::open(run.join("kf.nc")).unwrap();
        let later = [FILL_VALUE, FILL_VALUE, FILL_VALUE, 3.0, 3.0, 3.0, 2.0, 1.0, 0.0];
        assert_eq!(numbers(&file, "smoother_later_cycles"), later);
        assert!(numbers(&file, "h_smoothed").starts_with(&[FILL_VALUE]));
        assert!(summary.methods["kf"].values.contains_key("rmse_smoothed.h"));
    });
}

#[test]
fn what_smoothers_cannot_do_is_an_error_at_its_key() {
    let refused = |text: &str| Scenario::parse(Path::new("small.toml"), text).unwrap_err().to_string();
    let freezing =
        scenario("[stability]\nfreeze_after_cycles = 4\n[methods.kf]\nkind = \"kf\"\nsmoother_lag_cycles = 3\n");
    assert!(refused(&freezing).contains("[stability] freezes"), "{}", refused(&freezing));
    let none = refused(&scenario("[methods.kf]\nkind = \"kf\"\nsmoother_lag_cycles = 0\n"));
    assert!(none.contains("smoother_lag_cycles"), "{none}");
    let other = refused(&scenario("[methods.var]\nkind = \"3dvar\"\nsmoother_lag_cycles = 3\n"));
    assert!(other.contains("smoother_lag_cycles"), "{other}");
    let hybrid = "kind = \"hybrid_3dvar\"\nmembers = 8\nlocalization_radius_km = 500\nensemble_weight = 0.5";
    let hybrid = refused(&scenario(&format!("[methods.hybrid]\n{hybrid}\nsmoother_lag_cycles = 3\n")));
    assert!(hybrid.contains("unknown key `smoother_lag_cycles`"), "{hybrid}");
    let model_error = "[model_error]\ncomponents = [{ kind = \"white\", variable = \"h\", sigma = 1 }]\n";
    for kind in ["etkf", "letkf", "enkf"] {
        let keys = "members = 8\nmodel_error_treatment = \"square_root\"\nsmoother_lag_cycles = 3\n";
        let radius = if kind == "etkf" { "" } else { "localization_radius_km = 500\n" };
        let method = format!("[methods.members]\nkind = \"{kind}\"\n{radius}{keys}");
        let root = refused(&scenario(&format!("{model_error}{method}")));
        assert!(root.contains("which a smoother cannot follow") && root.contains("model_error_treatment"), "{root}");
        // Without errors to add, there is no square root of them.
        assert!(Scenario::parse(Path::new("small.toml"), &scenario(&method)).is_ok());
        let freezing = refused(&scenario(&format!("[stability]\nfreeze_after_cycles = 4\n{method}")));
        assert!(freezing.contains("[stability] freezes"), "{freezing}");
    }
}
