//! What the sinks write is what happened: every number, bit for bit, read back by an independent reader.

use crate::synthetic_run::SyntheticRun;
use isobar::event::{Event, MethodInfo, Smoothed};
use isobar::output::history::History;
use isobar::output::{Existing, OutputDirectory, Outputs, Sink, SinkError, open_all};
use isobar::plot::Thinning;
use isobar::readings::Readings;
use netcdf_reader::NcFile;
use std::borrow::Cow;
use std::path::Path;

const FILL_VALUE: f64 = 9.96921e36;
fn netcdf() -> Outputs {
    Outputs::of(["netcdf"])
}

/// Plays the run into a new directory, completes it, and lets `look` see it.
fn written(run: &SyntheticRun, look: impl FnOnce(&Path)) {
    let parent = tempfile::tempdir().unwrap();
    let destination = parent.path().join("run");
    let directory = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
    run.play(&mut open_all(&run.info, &directory, &netcdf()).unwrap()).unwrap();
    directory.complete().unwrap();
    look(&destination);
}

fn numbers(file: &NcFile, name: &str) -> Vec<u64> {
    let values = file.read_variable::<f64>(name).unwrap_or_else(|error| panic!("{name}: {error}"));
    values.iter().map(|value| value.to_bits()).collect()
}

fn bits<'a>(values: impl IntoIterator<Item = &'a f64>) -> Vec<u64> {
    values.into_iter().map(|value| value.to_bits()).collect()
}

fn attribute(file: &NcFile, variable: &str, name: &str) -> Option<String> {
    let variable = file.variable(variable).unwrap();
    variable.attribute(name).and_then(|attribute| attribute.value.as_string())
}

fn global(file: &NcFile, name: &str) -> String {
    file.global_attribute(name).unwrap().value.as_string().unwrap()
}

fn dimensions(file: &NcFile, variable: &str) -> Vec<String> {
    file.variable(variable).unwrap().dimensions().iter().map(|dimension| dimension.name.clone()).collect()
}

/// The sink's answer to a run that is not consistent.
fn error_of(run: &SyntheticRun) -> SinkError {
    let parent = tempfile::tempdir().unwrap();
    let directory = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    let mut sinks = open_all(&run.info, &directory, &netcdf()).unwrap();
    run.play(&mut sinks).unwrap_err()
}

#[test]
fn the_truth_is_written_on_its_staggered_grid() {
    let run = SyntheticRun::new(8, 6, 3, 2);
    written(&run, |directory| {
        let file = NcFile::open(directory.join("truth.nc")).unwrap();
        let times: Vec<f64> = (0..=3).map(|cycle| run.time(cycle).seconds() as f64).collect();
        assert_eq!(numbers(&file, "time"), bits(&times));
        assert!(file.dimension("time").unwrap().is_unlimited);
        for (number, name) in ["h", "u", "v"].into_iter().enumerate() {
            let expected: Vec<f64> =
                run.truth.iter().flat_map(|state| state.field(number).iter().copied().collect::<Vec<_>>()).collect();
            assert_eq!(numbers(&file, name), bits(&expected), "{name}");
        }
        assert_eq!(numbers(&file, "calibration"), bits(run.true_calibration.iter().flatten()));
        assert_eq!(
            file.read_variable_as_strings("parameter_name").unwrap(),
            ["europe/h/FR", "europe/h/DE", "polar/constant", "polar/scan_linear"]
        );
        assert_eq!(dimensions(&file, "h"), ["time", "y", "x"]);
        assert_eq!(dimensions(&file, "u"), ["time", "y", "x_u"]);
        assert_eq!(dimensions(&file, "v"), ["time", "y_v", "x"]);
        assert_eq!(numbers(&file, "x")[..2], bits(&[125_000.0, 375_000.0]));
        assert_eq!(numbers(&file, "x_u")[..2], bits(&[0.0, 250_000.0]));
        assert_eq!(numbers(&file, "y")[..2], bits(&[125_000.0, 375_000.0]));
        assert_eq!(numbers(&file, "y_v")[..2], bits(&[0.0, 250_000.0]));
        for (variable, name, value) in [
            ("time", "units", "seconds since 1970-01-01 00:00:00"),
            ("time", "calendar", "standard"),
            ("x", "standard_name", "projection_x_coordinate"),
            ("y", "standard_name", "projection_y_coordinate"),
            ("x_u", "units", "m"),
            ("y_v", "units", "m"),
            ("h", "standard_name", "geopotential_height"),
            ("u", "units", "m s-1"),
            ("u", "coordinates", "latitude_u longitude_u"),
            ("h", "coordinates", "latitude longitude"),
            ("h", "grid_mapping", "lambert_azimuthal_equal_area"),
            ("lambert_azimuthal_equal_area", "grid_mapping_name", "lambert_azimuthal_equal_area"),
        ] {
            assert_eq!(attribute(&file, variable, name).as_deref(), Some(value), "{variable}:{name}");
        }
    });
}

#[test]
fn latitude_and_longitude_are_those_of_the_projection() {
    let run = SyntheticRun::new(8, 6, 1, 1);
    let (grid, projection) = (&run.info.layout.grid, run.info.projection.as_ref().unwrap());
    written(&run, |directory| {
        let file = NcFile::open(directory.join("truth.nc")).unwrap();
        let place = projection.inverse(2.5 * grid.dx_m, 1.5 * grid.dy_m).unwrap();
        assert_eq!(numbers(&file, "latitude")[8 + 2], place.0.to_bits());
        assert_eq!(numbers(&file, "longitude")[8 + 2], place.1.to_bits());
        let number = |name: &str| {
            let variable = file.variable("lambert_azimuthal_equal_area").unwrap();
            variable.attribute(name).unwrap().value.as_f64().unwrap()
        };
        assert_eq!(number("latitude_of_projection_origin"), 50.0);
        assert_eq!(number("longitude_of_projection_origin"), 10.0);
        assert_eq!(number("false_easting"), 1_000_000.0);
        assert_eq!(number("false_northing"), 750_000.0);
        assert_eq!(number("earth_radius"), 6_371_229.0);
    });
}

#[test]
fn a_plane_beside_the_earth_has_no_grid_mapping() {
    let mut run = SyntheticRun::new(8, 6, 1, 1);
    run.info.projection = None;
    written(&run, |directory| {
        for name in ["truth.nc", "fast_kalman.nc", "observations.nc"] {
            let file = NcFile::open(directory.join(name)).unwrap();
            assert!(file.variable("latitude").is_err() && file.variable("lambert_azimuthal_equal_area").is_err());
        }
        let file = NcFile::open(directory.join("truth.nc")).unwrap();
        assert_eq!(attribute(&file, "h", "grid_mapping"), None);
        assert_eq!(attribute(&file, "x_u", "standard_name").as_deref(), Some("projection_x_coordinate"));
        assert_eq!(attribute(&file, "y_v", "standard_name").as_deref(), Some("projection_y_coordinate"));
    });
}

#[test]
fn each_method_has_its_backgrounds_analyses_and_spreads() {
    let run = SyntheticRun::new(8, 6, 3, 5);
    written(&run, |directory| {
        for (number, results) in run.results.iter().enumerate() {
            let name = &run.info.methods[number].name;
            let file = NcFile::open(directory.join(format!("{name}.nc"))).unwrap();
            assert_eq!(file.dimension("time").unwrap().size, 3);
            let concatenated = |values: &dyn Fn(usize) -> Vec<f64>| (0..3).flat_map(values).collect::<Vec<_>>();
            for variable in 0..3 {
                let short = run.info.layout.variables[variable].name;
                let field = |values: &[f64]| values[variable * 48..(variable + 1) * 48].to_vec();
                let expected = concatenated(&|cycle| field(results[cycle].0.state.values()));
                assert_eq!(numbers(&file, &format!("{short}_background")), bits(&expected));
                let expected = concatenated(&|cycle| field(results[cycle].1.estimate.state.values()));
                assert_eq!(numbers(&file, &format!("{short}_analysis")), bits(&expected));
                if name == "free" {
                    assert!(file.variable(&format!("{short}_background_spread")).is_err());
                    continue;
                }
                let expected = concatenated(&|cycle| field(results[cycle].0.state_spread.as_ref().unwrap()));
                assert_eq!(numbers(&file, &format!("{short}_background_spread")), bits(&expected));
                let expected = concatenated(&|cycle| field(results[cycle].1.estimate.state_spread.as_ref().unwrap()));
                assert_eq!(numbers(&file, &format!("{short}_analysis_spread")), bits(&expected));
            }
            let expected = concatenated(&|cycle| results[cycle].1.estimate.calibration.clone());
            assert_eq!(numbers(&file, "calibration_analysis"), bits(&expected));
            assert_eq!(attribute(&file, "calibration_analysis", "units").as_deref(), Some("m"));
            if name != "free" {
                let expected = concatenated(&|cycle| results[cycle].0.calibration_spread.clone().unwrap());
                assert_eq!(numbers(&file, "calibration_background_spread"), bits(&expected));
            }
            assert_eq!(global(&file, "method"), *name);
        }
    });
}

#[test]
fn every_observation_is_a_point_with_its_departures() {
    let run = SyntheticRun::new(8, 6, 3, 2);
    written(&run, |directory| {
        let file = NcFile::open(directory.join("observations.nc")).unwrap();
        let all = |values: &dyn Fn(usize) -> Vec<f64>| bits(&(0..3).flat_map(values).collect::<Vec<_>>());
        let windows = &run.windows;
        assert_eq!(global(&file, "featureType"), "point");
        assert_eq!(numbers(&file, "value"), all(&|k| windows[k].values.clone()));
        assert_eq!(numbers(&file, "value_bias_removed"), all(&|k| run.values_bias_removed[k].clone()));
        assert_eq!(numbers(&file, "sigma"), all(&|k| windows[k].sigma.clone()));
        assert_eq!(numbers(&file, "time"), all(&|k| vec![run.time(k + 1).seconds() as f64; windows[k].len()]));
        assert_eq!(numbers(&file, "x"), all(&|k| windows[k].reports.iter().map(|report| report.x_m).collect()));
        assert_eq!(numbers(&file, "y"), all(&|k| windows[k].reports.iter().map(|report| report.y_m).collect()));
        let scan = |k: usize| windows[k].reports.iter().map(|report| report.scan.unwrap_or(FILL_VALUE)).collect();
        assert_eq!(numbers(&file, "scan"), all(&scan));
        for (name, number) in [("fast_kalman", 0), ("kalman", 1)] {
            let departures = &run.results[number];
            let background = |k: usize| departures[k].1.background_departures.clone();
            assert_eq!(numbers(&file, &format!("background_departure_{name}")), all(&background));
            let analysis = |k: usize| departures[k].1.analysis_departures.clone();
            assert_eq!(numbers(&file, &format!("analysis_departure_{name}")), all(&analysis));
        }
        let readings = |of: fn(&Readings) -> &Vec<f64>| all(&|k| of(&run.readings(k + 1)).clone());
        assert_eq!(numbers(&file, "calibrated_value_fast_kalman"), readings(|it| &it.values));
        assert_eq!(numbers(&file, "calibrated_value_fast_kalman_sigma"), readings(|it| &it.sigma));
        assert!(file.variable("calibrated_value_kalman").is_err());
        let reports: Vec<_> = windows.iter().flat_map(|window| &window.reports).collect();
        let texts = |name: &str| file.read_variable_as_strings(name).unwrap();
        assert_eq!(texts("network"), reports.iter().map(|report| &*report.network).collect::<Vec<_>>());
        assert_eq!(texts("platform"), reports.iter().map(|report| &*report.platform).collect::<Vec<_>>());
        assert_eq!(texts("variable"), reports.iter().map(|report| ["h", "u"][report.variable]).collect::<Vec<_>>());
        assert_eq!(texts("unit"), reports.iter().map(|report| ["m", "m s-1"][report.variable]).collect::<Vec<_>>());
        // Heights and winds together have no common unit.
        assert_eq!(attribute(&file, "value", "units"), None);
        let projection = run.info.projection.as_ref().unwrap();
        let latitudes = |k: usize| -> Vec<f64> {
            let places = windows[k].reports.iter().map(|report| projection.inverse(report.x_m, report.y_m));
            places.map(|place| place.unwrap().0).collect()
        };
        assert_eq!(numbers(&file, "latitude"), all(&latitudes));
    });
}

#[test]
fn a_run_without_observations_or_parameters_has_all_its_files() {
    let mut run = SyntheticRun::new(8, 6, 2, 1);
    run.info.calibration.parameters.clear();
    run.true_calibration.iter_mut().for_each(Vec::clear);
    run.values_bias_removed.iter_mut().for_each(Vec::clear);
    for window in &mut run.windows {
        window.reports.clear();
        window.values.clear();
        window.sigma.clear();
        window.times.clear();
    }
    for (background, analysis, _) in run.results.iter_mut().flatten() {
        background.calibration.clear();
        background.calibration_spread = None;
        analysis.estimate.calibration.clear();
        analysis.estimate.calibration_spread = None;
        analysis.background_departures.clear();
        analysis.analysis_departures.clear();
    }
    written(&run, |directory| {
        let file = NcFile::open(directory.join("observations.nc")).unwrap();
        assert_eq!(file.dimension("obs").unwrap().size, 0);
        assert!(NcFile::open(directory.join("truth.nc")).unwrap().variable("calibration").is_err());
        assert!(NcFile::open(directory.join("fast_kalman.nc")).unwrap().variable("calibration_analysis").is_err());
    });
}

#[test]
fn files_say_what_made_them_and_are_the_same_in_every_run() {
    let run = SyntheticRun::new(8, 6, 2, 2);
    let names =
        ["truth.nc", "fast_kalman.nc", "kalman.nc", "observations.nc", "scores.csv", "scores_long.csv", "summary.json"];
    let mut first = Vec::new();
    written(&run, |directory| {
        for name in names {
            first.push(std::fs::read(directory.join(name)).unwrap());
            if name.ends_with(".nc") {
                let file = NcFile::open(directory.join(name)).unwrap();
                assert_eq!(global(&file, "Conventions"), "CF-1.8");
                assert_eq!(global(&file, "scenario"), "quickstart");
                assert_eq!(global(&file, "seed"), "42");
                assert_eq!(global(&file, "scenario_text"), run.info.scenario_text);
                assert!(global(&file, "title").starts_with("A vortex over a channel: "));
                assert!(global(&file, "source").starts_with("isobar "));
            }
        }
        let mut found: Vec<_> = std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        found.sort();
        let mut expected = [&names[..], &["files.txt"]].concat();
        expected.sort();
        assert_eq!(found, expected);
    });
    written(&SyntheticRun::new(8, 6, 2, 2), |directory| {
        for (name, first) in names.iter().zip(&first) {
            assert_eq!(&std::fs::read(directory.join(name)).unwrap(), first, "{name}");
        }
    });
}

#[test]
fn the_summary_keeps_the_order_of_methods_and_variables() {
    let run = SyntheticRun::new(8, 6, 2, 3);
    written(&run, |directory| {
        let text = std::fs::read_to_string(directory.join("summary.json")).unwrap();
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        for (name, scores) in &run.summary.methods {
            for variable in ["h", "u", "v"] {
                let error = &scores.values[&format!("rmse_analysis.{variable}")];
                let written = value["methods"][name]["rmse_analysis"][variable].as_f64().unwrap();
                assert!((written / error - 1.0).abs() < 1e-14, "{name} {variable}: {written}");
            }
        }
        let order = ["\"fast_kalman\"", "\"kalman\"", "\"letkf-40\""].map(|name| text.find(name).unwrap());
        assert!(order.is_sorted(), "{text}");
        assert!(text.ends_with("}\n"));
    });
}

#[test]
fn a_run_that_is_not_whole_is_not_taken_for_one() {
    let mut run = SyntheticRun::new(8, 6, 2, 1);
    run.info.cycles = 3;
    let error = error_of(&run);
    assert!(error.reason.contains("2 records instead of 3"), "{error}");

    let mut run = SyntheticRun::new(8, 6, 2, 1);
    run.results[0][1].1.analysis_departures.pop();
    let error = error_of(&run);
    assert!(error.path.ends_with("observations.nc") && error.reason.contains("cycle 2"), "{error}");

    let mut run = SyntheticRun::new(8, 6, 2, 1);
    run.results[0][1].0.state_spread = None;
    let error = error_of(&run);
    assert!(error.path.ends_with("fast_kalman.nc") && error.reason.contains("h_background_spread"), "{error}");

    let mut run = SyntheticRun::new(8, 6, 2, 1);
    run.true_calibration[1].pop();
    assert!(error_of(&run).path.ends_with("truth.nc"));

    let mut run = SyntheticRun::new(8, 6, 2, 1);
    run.windows[1].cycle = 1;
    assert!(error_of(&run).reason.contains("twice"));
}

#[test]
fn methods_whose_files_would_be_the_same_are_refused() {
    let parent = tempfile::tempdir().unwrap();
    let directory = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    for names in [["letkf 1", "LETKF/1"], ["truth", "kalman"], ["kalman", "observations"]] {
        let mut info = SyntheticRun::new(8, 6, 1, 1).info;
        info.methods = names
            .map(|name| MethodInfo {
                name: name.into(),
                description: String::new(),
                smoother_lag_cycles: None,
                estimates_biases: true,
            })
            .into_iter()
            .collect();
        let Err(error) = open_all(&info, &directory, &netcdf()) else { panic!("{names:?} were accepted") };
        assert!(error.reason.contains("another output"), "{error}");
    }
}

#[test]
fn a_directory_that_vanishes_is_an_error_not_a_panic() {
    let run = SyntheticRun::new(8, 6, 1, 1);
    let parent = tempfile::tempdir().unwrap();
    let directory = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    let mut sinks = open_all(&run.info, &directory, &netcdf()).unwrap();
    std::fs::remove_dir_all(directory.path()).unwrap();
    run.play_truth(&mut sinks, 0).unwrap();
    let error = sinks.record(&Event::Finished(&run.summary)).unwrap_err();
    assert!(error.path.ends_with("observations.nc"), "{error}");
}

/// Holds a run, and smooths the estimate of every cycle with the observations of the next.
struct Held(History);

impl Sink for Held {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let failure = |reason: String| SinkError { path: "history".into(), reason };
        self.0.record(event).map_err(failure)?;
        let Event::Analysed(analysed) = event else { return Ok(()) };
        let (method, cycle, estimate) =
            (analysed.method, analysed.cycle - 1, Cow::Borrowed(&analysed.analysis.estimate));
        let scores = Cow::Owned([("rmse_smoothed.u".to_string(), cycle as f64)].into());
        let smoothed = Smoothed { method, cycle, later_cycles: 1, estimate, scores };
        if cycle > 0 { self.0.record(&Event::Smoothed(smoothed)).map_err(failure) } else { Ok(()) }
    }
}

#[test]
fn a_history_holds_the_fields_that_are_shown_and_knows_when_a_score_became_known() {
    let run = SyntheticRun::new(8, 6, 4, 2);
    let thinning = Thinning::new(&run.info.layout.grid, 4);
    let mut held = Held(History::new(&run.info, thinning, |info, cycle| cycle == info.cycles / 2));
    run.play(&mut held).unwrap();
    let history = held.0;
    assert_eq!(history.cycles.iter().map(|cycle| cycle.number).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    for cycle in &history.cycles {
        let maps: Vec<_> = cycle.methods.iter().flatten().filter_map(|own| own.maps.as_ref()).collect();
        // Every estimate is revised to that of the next cycle.
        for (number, own) in maps.iter().enumerate() {
            let next = run.results[number][cycle.number].1.estimate.state.values();
            let revised: Vec<_> = next.chunks_exact(48).map(|field| thinning.apply(field)).collect();
            assert_eq!(own.smoothed.as_ref(), Some(&revised));
        }
        assert_eq!(maps.len(), if cycle.number == 2 { 2 } else { 0 });
        assert_eq!(cycle.truth.is_some(), cycle.number == 2);
        let truth: Vec<f64> = cycle.true_calibration.iter().map(|value| value.unwrap()).collect();
        assert_eq!(truth, run.true_calibration[cycle.number]);
        for own in maps {
            let sizes = [&own.background, &own.analysis].map(|fields| fields.iter().map(Vec::len).collect::<Vec<_>>());
            assert_eq!(sizes, [[12; 3], [12; 3]]);
        }
        // Those of the newest cycle are there until the next one begins.
        let reports = if [2, 4].contains(&cycle.number) { run.windows[cycle.number - 1].len() } else { 0 };
        assert_eq!((cycle.reports.len(), cycle.values.len()), (reports, reports));
    }
    let known = |key: &str, since: usize| -> Vec<(usize, f64)> {
        history.scores(1, key, since).map(|(cycle, value)| (cycle.number, value)).collect()
    };
    assert_eq!(known("rmse_smoothed.u", 0), [(1, 1.0), (2, 2.0), (3, 3.0)]);
    assert_eq!(known("rmse_smoothed.u", 4), [(3, 3.0)]);
    assert_eq!(known("rmse_analysis.u", 4).iter().map(|it| it.0).collect::<Vec<_>>(), [4]);
    assert_eq!(known("rmse_analysis.u", 0).len(), 4);
    assert!(known("crps.u", 0).is_empty(), "it has no line");
}
