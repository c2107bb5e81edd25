//! `viewer_data.bin`: what an isobar without the viewer's SDK leaves of a run, so that a recording can be made of it later.

use crate::synthetic_run::SyntheticRun;
use isobar::event::Event;
use isobar::output::viewer_data::{VIEWER_DATA_FILE, ViewerData};
use isobar::output::{Sink, SinkError};
#[cfg(not(feature = "rerun"))]
use {
    crate::common::{isobar, one_line, text},
    isobar::output::{Existing, OutputDirectory, Outputs, open_all},
};

/// Holds a run.
struct Held(ViewerData);

impl Sink for Held {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        self.0.history.record(event).map_err(|reason| SinkError { path: "history".into(), reason })
    }
}

/// What the viewer shows of a run.
fn shown(run: &SyntheticRun) -> ViewerData {
    let mut held = Held(ViewerData::new(&run.info));
    run.play(&mut held).unwrap();
    held.0
}

#[test]
fn what_is_read_is_what_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(VIEWER_DATA_FILE);
    // With maps on the grid, and on a coarser one.
    for run in [SyntheticRun::new(8, 6, 3, 5), SyntheticRun::new(300, 4, 2, 2)] {
        let data = shown(&run);
        data.write(&path).unwrap();
        let read = ViewerData::read(&path).unwrap();
        let parts = |data: &ViewerData| {
            let history = &data.history;
            format!(
                "{:?}",
                (&data.info, &history.cycles, &history.parameters, &history.verdicts, &history.station_biases)
            )
        };
        assert!(data.history.cycles.len() > 2);
        assert_eq!(parts(&read), parts(&data));
    }
}

#[test]
fn parts_of_different_runs_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(VIEWER_DATA_FILE);
    let run = SyntheticRun::new(8, 6, 2, 2);
    for other in [SyntheticRun::new(8, 7, 2, 2), SyntheticRun::new(8, 6, 2, 3)] {
        let mut data = shown(&run);
        data.history.cycles = shown(&other).history.cycles;
        data.write(&path).unwrap();
        assert!(ViewerData::read(&path).unwrap_err().contains("not those of one run"));
    }
    std::fs::write(&path, "isobar checkpoint 1, version 0.1.0\n").unwrap();
    assert!(ViewerData::read(&path).unwrap_err().contains("it is not a file of viewer data"));
}

#[cfg(not(feature = "rerun"))]
#[test]
fn an_isobar_without_the_sdk_leaves_the_data_and_says_what_makes_the_recording() {
    let parent = tempfile::tempdir().unwrap();
    let run = SyntheticRun::new(8, 6, 3, 2);
    let directory = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    run.play(&mut open_all(&run.info, &directory, &Outputs::of(["rerun"])).unwrap()).unwrap();
    directory.complete().unwrap();
    assert!(ViewerData::read(&parent.path().join("run").join(VIEWER_DATA_FILE)).is_ok());
    let output = isobar(parent.path(), &["view", "run"]);
    assert_eq!(output.status.code(), Some(1));
    let said = one_line(&text(&output.stderr));
    assert!(said.contains("`cargo run --release --features rerun -- view run`"), "{said}");
}
