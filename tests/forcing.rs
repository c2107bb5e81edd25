//! Known sources of model and truth: with every model and time scheme, at every lead time, from tables, and of unknown strength.

use crate::common::{VALID, isobar, place, text};
use crate::runs::run_options;
use isobar::progress::Progress;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar_model::{Boundary, Duration, ExactShift, Grid, Model, State};
use std::fs;
use std::path::Path;

/// A world of this model, whose truth starts at the background and has the model's own sources, without observations.
fn world(model: &str, boundary: &str, initial: &str) -> String {
    format!(
        "title = \"Sources\"\nphenomenon = \"None\"\nsource = \"The tests\"\nseed = 1\nstart = \"2026-01-15T00:00:00Z\"\n\
        grid = {{ nx = 8, ny = 6, dx_km = 100, boundary = \"{boundary}\" }}\n\
        initial = {{ {initial} }}\nbackground_error = {{ components = [] }}\n\
        cycle = {{ count = 6, window_hours = 3, score_from_cycle = 1 }}\nforecast = {{ lead_hours = 9 }}\n\
        methods = {{ free = {{ kind = \"free\" }} }}\n[model]\n{model}\n"
    )
}

/// Every model, and every time scheme of one of them.
fn worlds() -> Vec<(String, &'static str)> {
    let water = "time_step_s = 100\ncoriolis_per_s = 1e-4\n";
    let (rest, jet) = ("kind = \"rest\"", "kind = \"jet\", mean_depth_m = 1000, speed_m_per_s = 10, width_km = 200");
    let wave = "kind = \"cosine_wave\", amplitude = 1";
    let wind = "wind = { kind = \"vortex\", speed_m_per_s = 9 }\n";
    let scheme = |scheme: &str| format!("kind = \"shallow_water\"\ntime_scheme = \"{scheme}\"\n{water}");
    vec![
        (world(&scheme("rk4"), "channel", jet), "h"),
        (world(&scheme("ssp_rk3"), "channel", jet), "u"),
        (world(&scheme("leapfrog"), "channel", jet), "v"),
        (world(&format!("kind = \"linear_shallow_water\"\nmean_depth_m = 500\n{water}"), "channel", rest), "v"),
        (world(&format!("kind = \"advection\"\ntime_step_s = 600\n{wind}"), "periodic", wave), "tracer"),
        (world("kind = \"exact_shift\"\ntime_step_s = 1800\ncolumns_per_step = 1", "periodic", wave), "tracer"),
    ]
}

fn sources(of: &str, variable: &str) -> String {
    format!(
        "[[{of}]]\nvariable = \"{variable}\"\namplitude_per_day = 3\n\
        pattern = {{ kind = \"gaussian_hill\", width_km = 150, center_x_fraction = 0.3 }}\n\
        time = {{ kind = \"sinusoid\", period_hours = 12.5, phase_hours = 3 }}\n\
        [[{of}]]\nvariable = \"{variable}\"\namplitude_per_day = -0.5\n\
        pattern = {{ kind = \"cosine_wave\", waves_x = 1, waves_y = 1 }}\n"
    )
}

fn scores(text: &str) -> Summary {
    scores_of(&Scenario::parse(Path::new("sources.toml"), text).unwrap())
}

fn scores_of(scenario: &Scenario) -> Summary {
    let folder = tempfile::tempdir().unwrap();
    run(scenario, &run_options(folder.path(), scenario.cycle.count), &mut Progress::new(true)).unwrap()
}

/// Forecasts of a model that knows all are the truth at every time, also ahead, where time must go on; those of one that does not
/// know the source, or has one that the truth does not have, are not.
#[test]
fn who_knows_the_source_has_no_error_at_any_lead_time() {
    for (world, variable) in worlds() {
        let errors = |text: String| {
            let values = scores(&text).methods["free"].values.clone();
            ["rmse_background", "rmse_forecast"].map(|kind| values[&format!("{kind}.{variable}")])
        };
        let of_model = sources("forcing", variable);
        let known = errors(format!("{world}{of_model}"));
        assert_eq!(known, [0.0; 2], "{world}");
        let both = errors(format!("{world}{of_model}{}", sources("truth.forcing", variable)));
        assert_eq!(both, [0.0; 2], "{world}");
        let unknown = errors(format!("{world}{}", sources("truth.forcing", variable)));
        let imagined = errors(format!("{world}{of_model}[truth]\nforcing = []\n"));
        for errors in [unknown, imagined] {
            assert!(errors.iter().all(|error| *error > 0.01), "{errors:?}: {world}");
        }
    }
}

/// A model that is made by code takes sources as any other.
#[test]
fn a_model_from_code_has_sources() {
    let (world, variable) = worlds().pop().unwrap();
    let of_code = |line: &&str| {
        !["grid", "initial", "[model]", "kind", "time_step_s", "columns"].iter().any(|it| line.starts_with(it))
    };
    let text: String = world.lines().filter(of_code).map(|line| format!("{line}\n")).collect();
    let grid = Grid { nx: 8, ny: 6, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    let error = |more: &str| {
        let model = ExactShift::new(grid.clone(), 1, 0, Duration::from_seconds(1800)).unwrap();
        let (background, text) =
            (State::zeros(model.layout()), format!("{text}{}{more}", sources("forcing", variable)));
        let scenario = Scenario::parse_with_model(Path::new("s.toml"), &text, model, background).unwrap();
        scores_of(&scenario).methods["free"].values["rmse_forecast.tracer"]
    };
    assert_eq!(error(""), 0.0);
    assert!(error("[truth]\nforcing = []\n") > 0.01);
}

/// A table of a sinusoid is nearly the sinusoid, and a constant one the constant; a pattern of a file is the pattern.
#[test]
fn tables_of_time_and_place_are_what_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let rows = |value: &dyn Fn(f64) -> f64| -> String {
        let rows = (0..=36).map(|half_hour| {
            let hour = f64::from(half_hour) / 2.0;
            let minutes = if half_hour % 2 == 1 { 30 } else { 0 };
            format!("2026-01-15T{:02}:{minutes:02}:00Z,{}\n", half_hour / 2, value(hour))
        });
        ["time,value\n".to_string()].into_iter().chain(rows).collect()
    };
    let hours = |hour: f64| (std::f64::consts::TAU * (hour - 3.0) / 12.0).cos();
    fs::write(here.join("tide.csv"), rows(&hours)).unwrap();
    fs::write(here.join("one.csv"), rows(&|_| 1.0)).unwrap();
    // A cosine wave at the centres of 8 columns.
    let row: String =
        (0..8).map(|i| format!("{}\n", (std::f64::consts::TAU * (f64::from(i) + 0.5) / 8.0).cos())).collect();
    fs::write(here.join("wave.csv"), row.repeat(6)).unwrap();
    let (world, _) = worlds().swap_remove(4);
    let world = world.replace("forecast = { lead_hours = 9 }\n", "");
    let source = |of: &str, pattern: &str, time: &str| {
        format!("[[{of}]]\nvariable = \"tracer\"\namplitude_per_day = 3\npattern = {pattern}\ntime = {time}\n")
    };
    let wave = "{ kind = \"cosine_wave\" }";
    let error = |of_model: &str, of_truth: &str| {
        let text = format!("{world}{of_model}{of_truth}");
        let scenario = Scenario::parse(&here.join("s.toml"), &text).unwrap();
        let options = run_options(here, 6);
        let summary = run(&scenario, &options, &mut Progress::new(true)).unwrap();
        fs::remove_dir_all(options.out).unwrap();
        summary.methods["free"].values["rmse_background.tracer"]
    };
    let by_table = error(
        &source("forcing", wave, "{ kind = \"table\", file = \"tide.csv\" }"),
        &source("truth.forcing", wave, "{ kind = \"sinusoid\", period_hours = 12, phase_hours = 3 }"),
    );
    // Linear interpolation over half an hour is off by (ω h)²/8 = 0.9 % at most, and two thirds of that in the mean.
    let whole =
        error("", &source("truth.forcing", wave, "{ kind = \"sinusoid\", period_hours = 12, phase_hours = 3 }"));
    assert!(by_table > 0.0 && by_table < 0.009 * whole, "{by_table} of {whole}");
    let constant = error(
        &source("forcing", "{ kind = \"file\", file = \"wave.csv\" }", "{ kind = \"table\", file = \"one.csv\" }"),
        &source("truth.forcing", wave, "{ kind = \"constant\" }"),
    );
    assert!(constant < 1e-12, "{constant}");
}

/// `isobar check` names the file, the line and the times; more cycles than the table has are refused as well.
#[test]
fn a_table_that_does_not_reach_over_the_run_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let (world, _) = worlds().swap_remove(4);
    let last =
        |time: &str| fs::write(here.join("u.csv"), format!("time,value\n2026-01-15T00:00:00Z,1\n{time},2\n")).unwrap();
    let source = |of: &str| {
        format!(
            "[[{of}]]\nvariable = \"tracer\"\namplitude_per_day = 1\n\
            [[{of}]]\nvariable = \"tracer\"\namplitude_per_day = 1\ntime = {{ kind = \"table\", file = \"u.csv\" }}\n"
        )
    };
    fs::write(here.join("s.toml"), format!("{world}{}", source("forcing"))).unwrap();
    // Six cycles of three hours, and nine hours ahead of the last of them.
    last("2026-01-16T03:00:00Z");
    let checked = isobar(here, &["check", "s.toml"]);
    assert!(checked.status.success(), "{}", text(&checked.stderr));
    let refused = |arguments: &[&str], expected: &str| {
        let output = isobar(here, arguments);
        let message = text(&output.stderr).replace("\n  │ ", " ").split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(!output.status.success() && message.contains(expected), "{message}");
        assert!(message.contains("file = \"u.csv\""), "{message}");
    };
    let all = "the table of source 2 of [[forcing]] goes from 2026-01-15T00:00:00Z to 2026-01-16T02:59:00Z, but the run needs \
        it from 2026-01-15T00:00:00Z to 2026-01-16T03:00:00Z";
    refused(&["run", "s.toml", "--cycles", "7"], "to 2026-01-16T06:00:00Z");
    last("2026-01-16T02:59:00Z");
    refused(&["check", "s.toml"], all);
    refused(&["run", "s.toml"], all);
    // The truth makes no forecasts ahead.
    fs::write(here.join("s.toml"), format!("{world}{}", source("truth.forcing"))).unwrap();
    assert!(isobar(here, &["check", "s.toml"]).status.success());
    last("2026-01-15T17:59:00Z");
    refused(&["check", "s.toml"], "the table of source 2 of [[truth.forcing]]");
}

#[test]
fn faults_of_a_source_are_named_with_their_place() {
    let folder = tempfile::tempdir().unwrap();
    for (source, at, expected) in [
        ("variable = \"w\"\namplitude_per_day = 1", "\"w\"", "`forcing[0].variable` cannot be \"w\""),
        ("variable = \"h\"\namplitude = 1", "amplitude =", "did you mean `amplitude_per_day`?"),
        ("variable = \"h\"\namplitude_per_day = nan", "nan", "is NaN, but must be a finite number"),
        (
            "variable = \"h\"\namplitude_per_day = 1\ntime = { kind = \"sinusoid\", period_hours = 0.00 }",
            "0.00 }",
            "`forcing[0].time.period_hours` is 0.0, but must be a number from 0.01",
        ),
        (
            "variable = \"h\"\namplitude_per_day = 1\npattern = { kind = \"wave\" }",
            "\"wave\"",
            "`forcing[0].pattern.kind` cannot be \"wave\"",
        ),
        (
            "variable = \"h\"\namplitude_per_day = 1\ntime = { kind = \"table\", file = \"no.csv\" }",
            "\"no.csv\"",
            "the file no.csv does not exist",
        ),
    ] {
        let broken = VALID.replacen("[cycle]", &format!("[[forcing]]\n{source}\n[cycle]"), 1);
        fs::write(folder.path().join("broken.toml"), &broken).unwrap();
        let output = isobar(folder.path(), &["check", "broken.toml"]);
        let message = text(&output.stderr).replace("\n  │ ", " ").split_whitespace().collect::<Vec<_>>().join(" ");
        let place = format!("broken.toml:{}]", place(&broken, at));
        assert!(output.status.code() == Some(1) && message.contains(&place), "{place} is missing in {message}");
        assert!(message.contains(expected), "{expected}: {message}");
    }
}
