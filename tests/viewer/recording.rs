//! The recording for the rerun viewer holds the run, and nothing of the clock.

use crate::common::text;
use crate::synthetic_run::SyntheticRun;
use isobar::event::{Event, Smoothed};
use isobar::output::viewer_data::{VIEWER_DATA_FILE, ViewerSink, Write};
use isobar::output::{Existing, OutputDirectory, Outputs, Sink, SinkError, open_all};
use isobar::scores::Values;
use re_sdk::external::re_log_encoding::DecoderApp;
use re_sdk::log::{Chunk, LogMsg};
use re_sdk_types::archetypes::{DepthImage, Image, Points2D, Scalars, TextDocument};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;
use std::process::Command;

/// The chunks of the recording of a run, without those of the viewer's layout, and the number of the latter.
fn recorded(run: &SyntheticRun) -> (Vec<Chunk>, usize) {
    recorded_by(run, |sinks| run.play(sinks).unwrap())
}

/// The same of what is sent to the sinks.
fn recorded_by(run: &SyntheticRun, send: impl FnOnce(&mut Vec<Box<dyn Sink>>)) -> (Vec<Chunk>, usize) {
    let parent = tempfile::tempdir().unwrap();
    let directory = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    send(&mut open_all(&run.info, &directory, &Outputs::of(["rerun"])).unwrap());
    directory.complete().unwrap();
    read(&parent.path().join("run"))
}

/// The same of the recording in a run's directory.
fn read(directory: &Path) -> (Vec<Chunk>, usize) {
    let file = File::open(directory.join("recording.rrd")).unwrap();
    let (mut chunks, mut layout) = (Vec::new(), 0);
    for message in DecoderApp::decode_lazy(BufReader::new(file)) {
        if let LogMsg::ArrowMsg(store, message) = message.unwrap() {
            assert_eq!(store.application_id().as_str(), "isobar");
            if store.is_blueprint() {
                layout += 1;
            } else {
                assert_eq!(store.recording_id().as_str(), "quickstart-seed-42");
                chunks.push(Chunk::from_arrow_msg(&message).unwrap());
            }
        }
    }
    (chunks, layout)
}

/// All that chunks hold but their numbers, which are random.
fn contents(chunks: &[Chunk]) -> Vec<String> {
    let of_chunk = |chunk: &Chunk| format!("{} {:?} {:?}", chunk.entity_path(), chunk.timelines(), chunk.components());
    chunks.iter().map(of_chunk).collect()
}

/// Number of rows with times of each entity.
fn rows(chunks: &[Chunk]) -> BTreeMap<String, usize> {
    let mut rows = BTreeMap::new();
    for chunk in chunks.iter().filter(|chunk| !chunk.is_static()) {
        *rows.entry(chunk.entity_path().to_string()).or_default() += chunk.num_rows();
    }
    rows
}

fn of<'a>(chunks: &'a [Chunk], entity: &'a str) -> impl Iterator<Item = &'a Chunk> {
    chunks.iter().filter(move |chunk| chunk.entity_path().to_string() == entity)
}

fn scalars(chunks: &[Chunk], entity: &str) -> Vec<f64> {
    let component = Scalars::descriptor_scalars().component;
    of(chunks, entity)
        .flat_map(|chunk| chunk.iter_slices::<f64>(component).flatten().copied().collect::<Vec<_>>())
        .collect()
}

#[test]
fn every_cycle_of_every_method_has_its_maps_and_curves() {
    let run = SyntheticRun::new(8, 6, 3, 5);
    let (chunks, layout) = recorded(&run);
    let rows = rows(&chunks);
    assert_eq!(["h", "u", "v", "wind"].map(|part| rows[&format!("/truth/{part}")]), [4; 4]);
    for method in ["01_fast_kalman", "02_kalman", "03_letkf_40", "04_3dvar", "05_free"] {
        for variable in ["h", "u", "v"] {
            let maps = format!("/methods/{method}/maps/{variable}");
            for part in ["background", "analysis", "increment", "analysis_error", "background_error"] {
                assert_eq!(rows[&format!("{maps}/{part}")], 3, "{maps}/{part}");
            }
            assert_eq!(rows[&format!("{maps}/observations/dots")], 3);
            assert_eq!(rows.contains_key(&format!("{maps}/spread")), method != "05_free");
        }
        assert_eq!(rows[&format!("/methods/{method}/wind")], 3);
        assert_eq!(rows[&format!("/methods/{method}/calibration/01_europe_h_FR/estimate")], 3);
        assert_eq!(rows[&format!("/methods/{method}/calibration/04_polar_scan_linear/truth")], 4);
    }
    let written = scalars(&chunks, "/comparison/h/02_kalman");
    assert_eq!(written, run.results[1].iter().map(|result| result.2.values["rmse_analysis.h"]).collect::<Vec<_>>());
    // Every score that is drawn of the method as a whole, whichever there are.
    for (kind, _) in run.info.drawn(false) {
        let written = scalars(&chunks, &format!("/comparison/{}/02_kalman", kind.name));
        assert_eq!(written, run.results[1].iter().map(|result| result.2.values[kind.name]).collect::<Vec<_>>());
    }
    assert_eq!(rows["/comparison/mean_departure/05_free"], 3);
    let upper = scalars(&chunks, "/methods/01_fast_kalman/calibration/02_europe_h_DE/above");
    let expected = run.results[0].iter().map(|(_, analysis, _)| {
        analysis.estimate.calibration[1] + 2.0 * analysis.estimate.calibration_spread.as_ref().unwrap()[1]
    });
    assert_eq!(upper, expected.collect::<Vec<_>>());
    assert!(layout > 0, "the recording has no layout");
}

/// Smooths the estimate of every cycle with the observations of the next.
struct Smoothing<'a>(&'a mut Vec<Box<dyn Sink>>);

impl Sink for Smoothing<'_> {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        self.0.record(event)?;
        let Event::Analysed(analysed) = event else { return Ok(()) };
        let (method, cycle) = (analysed.method, analysed.cycle - 1);
        let (estimate, scores) = (Cow::Borrowed(&analysed.analysis.estimate), Cow::Owned(Values::new()));
        let smoothed = Smoothed { method, cycle, later_cycles: 1, estimate, scores };
        if cycle > 0 { self.0.record(&Event::Smoothed(smoothed)) } else { Ok(()) }
    }
}

#[test]
fn smoothed_fields_are_shown_of_the_cycles_that_have_them() {
    let run = SyntheticRun::new(8, 6, 3, 2);
    let rows = rows(&recorded_by(&run, |sinks| run.play(&mut Smoothing(sinks)).unwrap()).0);
    for part in ["smoothed", "smoothed_error"] {
        assert_eq!(rows[&format!("/methods/02_kalman/maps/h/{part}")], 2);
    }
}

#[test]
fn maps_have_north_at_the_top() {
    let run = SyntheticRun::new(8, 6, 2, 1);
    let (chunks, _) = recorded(&run);
    let component = DepthImage::descriptor_buffer().component;
    let images: Vec<Vec<u8>> = of(&chunks, "/truth/h")
        .flat_map(|chunk| {
            chunk.iter_slices::<&[u8]>(component).flatten().map(|bytes| bytes.to_vec()).collect::<Vec<_>>()
        })
        .collect();
    assert_eq!(images.len(), 3);
    for (image, truth) in images.iter().zip(&run.truth) {
        let values = image.chunks(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()));
        let field = truth.field(0);
        let expected: Vec<f32> =
            (0..6).rev().flat_map(|j| field.row(j).iter().map(|&h| h as f32).collect::<Vec<_>>()).collect();
        assert_eq!(values.collect::<Vec<_>>(), expected);
    }
    // Red where the analysis is too high, blue where it is too low.
    let component = Image::descriptor_buffer().component;
    let error = &run.results[0][0].1.estimate.state - &run.truth[1];
    let image = of(&chunks, "/methods/01_fast_kalman/maps/h/analysis_error")
        .find_map(|chunk| chunk.iter_slices::<&[u8]>(component).flatten().next().map(|bytes| bytes.to_vec()))
        .unwrap();
    let colors: Vec<bool> = image.chunks(3).map(|pixel| pixel[0] >= pixel[2]).collect();
    let signs: Vec<bool> =
        (0..6).rev().flat_map(|j| (0..8).map(move |i| (j, i))).map(|at| error.field(0)[at] >= 0.0).collect();
    assert!(signs.contains(&true) && signs.contains(&false));
    let different = colors.iter().zip(&signs).filter(|(a, b)| a != b).count();
    assert!(different <= 1, "{different} of 48 pixels have the wrong colour");
}

#[test]
fn blocks_and_common_factors_have_maps_where_a_method_has_them() {
    let run = SyntheticRun::new(8, 6, 3, 2);
    let (chunks, _) = recorded(&run);
    let rows = rows(&chunks);
    let path = |part: &str| format!("/methods/01_fast_kalman/structure/{part}");
    assert_eq!((rows[&path("parts/map")], rows[&path("parts/headline")]), (3, 3));
    // Factors in cycles 1 and 3.
    for part in ["factor_1/map", "factor_1/wind", "factor_2/headline"] {
        assert_eq!(rows[&path(part)], 2, "{part}");
    }
    assert!(!rows.contains_key(&path("factor_3/map")));
    assert!(!rows.keys().any(|entity| entity.starts_with("/methods/02_kalman/structure")));
    let (map, headline) = (path("parts/map"), path("factor_1/headline"));
    let component = Image::descriptor_buffer().component;
    let image = of(&chunks, &map)
        .find_map(|chunk| chunk.iter_slices::<&[u8]>(component).flatten().next().map(|bytes| bytes.to_vec()))
        .unwrap();
    // Columns in pairs: coloured, grey, coloured, grey.
    let is_grey: Vec<bool> = image.chunks(3).take(8).map(|pixel| pixel[0] == pixel[1]).collect();
    assert_eq!(is_grey, [false, false, true, true, false, false, true, true]);
    let component = Points2D::descriptor_labels().component;
    let text = of(&chunks, &headline).find_map(|chunk| chunk.iter_slices::<String>(component).flatten().next());
    assert_eq!(text.unwrap().to_string(), "cycle 1: ±1 m, 30 % of the claimed variance, europe/h/FR −7.26 m");
}

#[test]
fn the_only_times_are_those_of_the_model_and_runs_repeat() {
    let run = SyntheticRun::new(8, 6, 2, 2);
    let (chunks, layout) = recorded(&run);
    let timelines: BTreeSet<String> =
        chunks.iter().flat_map(|chunk| chunk.timelines().keys().map(ToString::to_string)).collect();
    assert_eq!(timelines.into_iter().collect::<Vec<_>>(), ["cycle", "valid_time"]);
    let (again, layout_again) = recorded(&SyntheticRun::new(8, 6, 2, 2));
    assert_eq!(contents(&chunks), contents(&again));
    assert_eq!(layout, layout_again);
}

#[test]
fn the_texts_hold_scores_and_scenario() {
    let run = SyntheticRun::new(8, 6, 2, 2);
    let (chunks, _) = recorded(&run);
    let text = |entity: &str| {
        let component = TextDocument::descriptor_text().component;
        let text = of(&chunks, entity).find_map(|chunk| chunk.iter_slices::<String>(component).flatten().next());
        text.unwrap().to_string()
    };
    assert!(text("/text/scenario").contains(run.info.scenario_text.trim_end()));
    let scores = text("/text/scores");
    for part in [
        "| fast_kalman | ",
        "| kalman | ",
        "u [m\u{a0}s⁻¹] analysis",
        "seed 42",
        "- **kalman**: extended Kalman filter",
    ] {
        assert!(scores.contains(part), "no {part:?} in {scores}");
    }
}

#[test]
fn a_recording_that_is_made_later_is_the_same() {
    let run = SyntheticRun::new(8, 6, 3, 5);
    let parent = tempfile::tempdir().unwrap();
    for (name, outputs) in [("now", Outputs::of(["rerun"])), ("later", Outputs::default())] {
        let directory = OutputDirectory::create(parent.path().join(name), Existing::Refuse).unwrap();
        let mut sinks = open_all(&run.info, &directory, &outputs).unwrap();
        if name == "later" {
            let path = directory.path().join(VIEWER_DATA_FILE);
            let write: Write = |data, path, _| data.write(path).map_err(|error| error.to_string());
            sinks.push(Box::new(ViewerSink::create(&run.info, path, write).unwrap()));
        }
        run.play(&mut sinks).unwrap();
        directory.complete().unwrap();
    }
    let view = |name: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
        // No viewer is found.
        command.current_dir(parent.path()).args(["view", name]).env("PATH", parent.path()).output().unwrap()
    };
    let said = text(&view("later").stderr);
    assert!(said.contains("viewer is not installed") && said.contains("recording.rrd"), "{said}");
    let [now, later] = ["now", "later"].map(|name| read(&parent.path().join(name)));
    assert_eq!(contents(&later.0), contents(&now.0));
    assert_eq!(later.1, now.1);
    let listed = fs::read_to_string(parent.path().join("later/files.txt")).unwrap();
    assert!(listed.lines().any(|line| line == "recording.rrd"), "{listed}");
    let names = fs::read_dir(parent.path().join("later")).unwrap();
    let names: Vec<String> = names.map(|it| it.unwrap().file_name().to_string_lossy().into_owned()).collect();
    assert!(names.iter().all(|name| !name.starts_with('.')), "{names:?}");

    // What is damaged makes no recording.
    fs::remove_file(parent.path().join("later/recording.rrd")).unwrap();
    let path = parent.path().join("later").join(VIEWER_DATA_FILE);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&path, bytes).unwrap();
    let said = text(&view("later").stderr);
    assert!(said.contains("it is damaged") && said.contains(VIEWER_DATA_FILE), "{said}");
    assert!(!parent.path().join("later/recording.rrd").exists());
}

#[test]
fn results_that_do_not_fit_the_run_are_refused() {
    let mut run = SyntheticRun::new(8, 6, 2, 1);
    run.results[0][1].1.estimate.calibration_spread.as_mut().unwrap().pop();
    let parent = tempfile::tempdir().unwrap();
    let directory = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    let mut sinks = open_all(&run.info, &directory, &Outputs::of(["rerun"])).unwrap();
    let error = run.play(&mut sinks).unwrap_err();
    assert!(error.path.ends_with("recording.rrd") && error.reason.contains("cycle 2"), "{error}");
}
