//! Bad observations: rejected with a code, counted, never assimilated, and hardly missed.

use crate::common::{VALID, isobar, text};
use crate::runs::run_options;
use isobar::progress::Progress;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use netcdf_reader::NcFile;
use std::fs;
use std::path::Path;

/// A run of the quickstart's methods that assimilate and know of biases, with these settings of networks and of quality
/// control.
fn quickstart(network: &str, control: &str) -> Summary {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/quickstart.toml");
    let text = fs::read_to_string(&path).unwrap();
    let text = text.split("[expected]").next().unwrap();
    let text = ["radiosonde", "satellite"].iter().fold(text.to_string(), |text, kind| {
        let kind = format!("kind = \"{kind}\"\n");
        text.replace(&kind, &format!("{kind}{network}\n"))
    });
    let scenario = Scenario::parse(&path, &format!("{text}\n{control}\n")).unwrap();
    let parent = tempfile::tempdir().unwrap();
    let mut options = run_options(parent.path(), scenario.cycle.count);
    options.methods = Some(["var", "kf", "fkf"].map(String::from).to_vec());
    isobar::run::run(&scenario, &options, &mut Progress::new(true)).unwrap()
}

#[test]
fn five_percent_of_gross_errors_cost_less_than_a_tenth() {
    let gross = "faults = { gross_error_rate = 0.05 }";
    let clean = quickstart("", "[quality_control]");
    let checked = quickstart(gross, "");
    let unchecked = quickstart(gross, "[quality_control]\ngross_error_limit = 1e6");
    let wrongly: usize = clean.observations.rejected.values().sum();
    let total = clean.observations.used + wrongly;
    println!("clean: {wrongly} of {total} rejected. {}", checked.observations.describe_rejected().unwrap());
    assert!(wrongly * 1000 <= total, "{wrongly} of {total} good observations are rejected");
    let rejected: usize = checked.observations.rejected.values().sum();
    assert!((0.02..0.06).contains(&(rejected as f64 / total as f64)), "{rejected} of {total}");
    let mut worst = 0.0_f64;
    for (name, scores) in &clean.methods {
        for (score, rmse) in scores.values.iter().filter(|(score, _)| score.starts_with("rmse_analysis")) {
            let ratio = |other: &Summary| other.methods[name].values[score] / rmse;
            let (with, without) = (ratio(&checked), ratio(&unchecked));
            println!("{name} {score}: {with:.3} times the clean error, {without:.2} without the check");
            assert!(with <= 1.1, "{name} {score}: {with}");
            worst = worst.max(without);
        }
    }
    assert!(worst > 1.5, "gross errors do no harm: the test says nothing");
}

#[test]
fn rejected_observations_are_written_with_their_codes_and_counted() {
    let parent = tempfile::tempdir().unwrap();
    let faults = "faults = { gross_error_rate = 0.1, gross_error_factor = 100, not_finite_rate = 0.1, \
                  duplicate_rate = 0.1, misplaced_rate = 0.1, late_rate = 0.1 }";
    let text_of = VALID.replace("missing_rate = 0.1", &format!("missing_rate = 0.1\n{faults}"));
    fs::write(parent.path().join("bad.toml"), text_of).unwrap();
    let output = isobar(parent.path(), &["run", "bad.toml", "--no-rerun"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("observations rejected by quality control:"), "{}", text(&output.stdout));
    let run = parent.path().join("out/bad");
    let summary: Summary = serde_json::from_str(&fs::read_to_string(run.join("summary.json")).unwrap()).unwrap();
    let counts = &summary.observations;
    let names: Vec<&str> = counts.rejected.keys().map(String::as_str).collect();
    assert_eq!(names, ["absurd", "duplicate", "gross_error", "late", "not_finite", "outside"], "{counts:?}");

    let file = NcFile::open(run.join("observations.nc")).unwrap();
    let codes: Vec<i32> = file.read_variable::<i32>("quality_code").unwrap().iter().copied().collect();
    let meanings =
        file.variable("quality_code").unwrap().attribute("flag_meanings").unwrap().value.as_string().unwrap();
    let meanings: Vec<&str> = meanings.split(' ').collect();
    assert_eq!(codes.iter().filter(|&&code| code == 0).count(), counts.used);
    for (name, &count) in &counts.rejected {
        let code = meanings.iter().position(|meaning| meaning == name).unwrap() as i32;
        assert_eq!(codes.iter().filter(|&&it| it == code).count(), count, "{name}");
    }
    let values: Vec<f64> = file.read_variable::<f64>("value").unwrap().iter().copied().collect();
    let departures: Vec<f64> = file.read_variable::<f64>("analysis_departure_fkf").unwrap().iter().copied().collect();
    let fill = 9.96921e36;
    for ((value, departure), code) in values.iter().zip(&departures).zip(&codes) {
        let has_none = ["not_finite", "outside"].contains(&meanings[*code as usize]);
        assert!(value.is_finite() && (*departure == fill) == has_none, "{value} {departure} {code}");
    }
    assert!(fs::read_to_string(run.join("report.html")).unwrap().contains("rejected by quality control"));
}

/// Heights of 14 stations; one contradicts its neighbours. By the equations of quality control, computed apart in
/// double precision (s² = 1623 m² from the median departure, L = 600 km), the others predict 5486.9 m there.
#[test]
fn a_rejected_observation_is_told_with_its_reason() {
    let scenario = r#"
title = "One gross error"
phenomenon = "Quality control"
source = "made up"
seed = 1
start = "2026-01-15T00:00:00Z"

[grid]
nx = 20
ny = 16
dx_km = 200
boundary = "channel"

[model]
kind = "linear_shallow_water"
time_step_s = 300
coriolis_per_s = 1.0e-4
mean_depth_m = 5500

[initial]
kind = "rest"

[background_error]
components = [{ kind = "univariate", variable = "h", sigma = 150, length_km = 500 }]

[cycle]
count = 1
window_hours = 6

[quality_control]
gross_error_limit = 4
length_km = 600

[networks.stations]
kind = "file"
file = "observations.csv"

[methods.oi]
kind = "optimal_interpolation"
[methods.free]
kind = "free"
"#;
    let places = [
        (3098, 2713, 5434),
        (3109, 2564, 5437),
        (2055, 1299, 5470),
        (1229, 1580, 5517),
        (394, 2095, 5494),
        (1580, 370, 5543),
        (1671, 1756, 5221),
        (363, 960, 5526),
        (376, 2663, 5491),
        (3797, 380, 5517),
        (2549, 2102, 5436),
        (1044, 2636, 5506),
        (1766, 836, 5528),
        (3707, 2707, 5479),
    ];
    let rows = places.iter().zip(1..).map(|((x, y, h), number)| format!("1,{x}000,{y}000,h,{h},10,S{number:02}\n"));
    let observations = "cycle,x_m,y_m,variable,value,sigma,id\n".to_string() + &rows.collect::<String>();
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("s.toml"), scenario).unwrap();
    fs::write(parent.path().join("observations.csv"), observations).unwrap();
    let output = isobar(parent.path(), &["run", "s.toml", "--no-rerun", "--quiet"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let run = parent.path().join("out/s");
    let file = NcFile::open(run.join("observations.nc")).unwrap();
    let numbers = |name: &str| -> Vec<f64> { file.read_variable::<f64>(name).unwrap().iter().copied().collect() };
    let platforms = file.read_variable_as_strings("platform").unwrap();
    let place = platforms.iter().position(|name| name == "S07").unwrap();
    let found = |name: &str| numbers(name)[place];
    assert!((found("quality_prediction") - 5486.9).abs() < 0.1 && (found("quality_z") + 11.14).abs() < 0.01);
    assert_eq!((found("value"), found("quality_neighbours")), (5221.0, 13.0));
    for method in ["oi", "free"] {
        assert!((found(&format!("background_departure_{method}")) + 279.0).abs() < 1e-9, "{method}");
    }
    assert!((found("analysis_departure_oi") + 279.0).abs() > 1.0);
    // What is used has its prediction as well.
    assert!(numbers("quality_z").iter().filter(|z| z.abs() < 4.0).count() == 13);
    let diagnosed = text(&isobar(parent.path(), &["diagnose", "--all", "out/s"]).stdout);
    let row = diagnosed.lines().find(|line| line.contains("stations S07")).unwrap_or_else(|| panic!("{diagnosed}"));
    assert!(["gross_error", "5221", "5486.9", "-11.1"].iter().all(|part| row.contains(part)), "{row}");
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(report.contains("stations S07") && report.contains("5486.9"));
}
