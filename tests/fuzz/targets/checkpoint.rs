//! A checkpoint whose checksum is right and whose contents need not be: it is refused, or taken back by a small experiment.
//! The first byte says whether the others are the contents, or changes of those of a real one.
#![no_main]

use isobar::options::CheckpointPolicy;
use isobar::run::checkpoint::file::parse;
use isobar::options::RunOptions;
use isobar::event::Event;
use isobar::run::experiment::Experiment;
use isobar::scenario::Scenario;
use isobar::output::{Sink, SinkError};
use libfuzzer_sys::fuzz_target;
use std::cell::RefCell;
use std::path::Path;

/// Ends a run in its fourth cycle.
struct EndEarly;

impl Sink for EndEarly {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Observed { window, .. } if window.cycle == 4 => {
                Err(SinkError { path: "nothing".into(), reason: "this is the end".into() })
            }
            _ => Ok(()),
        }
    }
}

fn scenario() -> Scenario {
    Scenario::parse(Path::new("small.toml"), include_str!("../../common/valid.toml")).unwrap()
}

fn experiment() -> RefCell<Experiment> {
    let options = RunOptions { cycles: Some(120), outputs: isobar::output::Outputs::of(["netcdf"]), ..RunOptions::new("nowhere") };
    RefCell::new(Experiment::builder(&scenario()).build(&options).unwrap())
}

/// A real checkpoint in two parts: its first line, and what it holds between that and its checksum.
fn real_parts() -> (Vec<u8>, Vec<u8>) {
    let parent = tempfile::tempdir().unwrap();
    let checkpoints = Some(CheckpointPolicy { minutes: None, cycles: Some(3) });
    let own = RunOptions::new(parent.path().join("run"));
    let options = RunOptions { cycles: Some(120), outputs: isobar::output::Outputs::of(["netcdf"]), checkpoints, ..own };
    assert!(isobar::run::run(&scenario(), &options, &mut EndEarly).is_err());
    let files = std::fs::read_dir(parent.path().join(".run.partial")).unwrap().map(|file| file.unwrap());
    let is_checkpoint = |file: &std::fs::DirEntry| file.file_name().to_string_lossy().starts_with("checkpoint-");
    let bytes = std::fs::read(files.into_iter().find(is_checkpoint).unwrap().path()).unwrap();
    let head = bytes.iter().position(|&byte| byte == b'\n').unwrap() + 1;
    (bytes[..head].to_vec(), bytes[head..bytes.len() - 4].to_vec())
}

thread_local! {
    static EXPERIMENT: RefCell<Experiment> = experiment();
    static REAL: (Vec<u8>, Vec<u8>) = real_parts();
}

/// The contents with a byte changed, at a place of three bytes, by every four bytes of `changes`.
fn changed(changes: &[u8]) -> Vec<u8> {
    let mut contents = REAL.with(|real| real.1.clone());
    let length = contents.len();
    for change in changes.chunks_exact(4) {
        contents[u32::from_le_bytes([change[0], change[1], change[2], 0]) as usize % length] = change[3];
    }
    contents
}

fuzz_target!(|bytes: &[u8]| {
    let _ = parse(bytes);
    let Some((first, rest)) = bytes.split_first() else { return };
    let contents = if first % 2 == 0 { rest.to_vec() } else { changed(rest) };
    let mut sealed = REAL.with(|real| [&real.0[..], &contents].concat());
    sealed.extend(crc32fast::hash(&sealed).to_le_bytes());
    if let Ok(mut contents) = parse(&sealed) {
        EXPERIMENT.with_borrow_mut(|experiment| drop(contents.head.restore(&mut contents.memories, experiment)));
    } else {
        // Nothing but a change can make a real one unreadable.
        assert!(first % 2 == 0 || !rest.is_empty());
    }
});
