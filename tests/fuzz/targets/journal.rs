//! A journal: its events are told again, or it is refused. The first byte chooses between frames as they are and frames
//! whose checksums are made right.
#![no_main]

use isobar::event::{MethodInfo, RunInfo};
use isobar::run::checkpoint::journal::replay_bytes;
use isobar::scenario::Scenario;
use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::{Arc, LazyLock};

static INFO: LazyLock<RunInfo> = LazyLock::new(|| {
    let text = include_str!("../../common/valid.toml");
    let scenario = Scenario::parse(Path::new("small.toml"), text).unwrap();
    let method = |name: &str| MethodInfo { name: name.into(), description: String::new(), smoother_lag_cycles: None, estimates_biases: true };
    RunInfo {
        scenario: scenario.name.clone(),
        title: scenario.title.clone(),
        scenario_text: scenario.text.clone(),
        seed: 1,
        threads: 1,
        layout: Arc::new(isobar_model_layout()),
        projection: None,
        start: scenario.start,
        window: scenario.cycle.window,
        done: 0,
        cycles: 10,
        score_from_cycle: 2,
        calibration: Default::default(),
        methods: vec![method("free"), method("fkf")],
        has_truth: true,
        truth_file: None,
        keeps_sensors: false,
        lead_times: None,
        warnings: Vec::new(),
        networks: Vec::new(),
        notes: Vec::new(),
        stations: Vec::new(),
    }
});

fn isobar_model_layout() -> isobar_model::Layout {
    let grid = isobar_model::Grid { nx: 4, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: isobar_model::Boundary::Periodic };
    let location = isobar_model::Location::Center;
    let h = isobar_model::Variable { name: "h", long_name: "height", standard_name: None, unit: "m", location };
    isobar_model::Layout { grid, variables: vec![h] }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((first, rest)) = bytes.split_first() else { return };
    let mut journal = Vec::new();
    if *first % 2 == 0 {
        journal.extend_from_slice(rest);
    } else {
        // A frame for each piece that begins with its length.
        let mut left = rest;
        while let Some((length, after)) = left.split_first_chunk::<2>() {
            let (frame, after) = after.split_at(usize::from(u16::from_le_bytes(*length)).min(after.len()));
            journal.extend_from_slice(&(frame.len() as u64).to_le_bytes());
            journal.extend_from_slice(&crc32fast::hash(frame).to_le_bytes());
            journal.extend_from_slice(frame);
            left = after;
        }
    }
    let _ = replay_bytes(&journal, &INFO, &mut |_| Ok(()));
});
