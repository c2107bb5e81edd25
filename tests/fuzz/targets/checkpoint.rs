//! A checkpoint whose checksum is right and whose contents need not be: it is refused, or taken back by a small experiment.
#![no_main]

use isobar::checkpoint::file::parse;
use isobar::cli::RunOptions;
use isobar::experiment::Experiment;
use isobar::scenario::Scenario;
use libfuzzer_sys::fuzz_target;
use std::cell::RefCell;
use std::path::Path;

fn experiment() -> RefCell<Experiment> {
    let text = include_str!("../../common/valid.toml");
    let scenario = Scenario::parse(Path::new("small.toml"), text).unwrap();
    let options = RunOptions { cycles: Some(120), netcdf: true, ..RunOptions::new("nowhere") };
    RefCell::new(Experiment::new(&scenario, &options).unwrap())
}

thread_local! {
    static EXPERIMENT: RefCell<Experiment> = experiment();
}

fuzz_target!(|bytes: &[u8]| {
    let _ = parse(bytes);
    let head = format!("isobar checkpoint 1, version {}\n", isobar::VERSION);
    let mut sealed = [head.as_bytes(), bytes].concat();
    sealed.extend(crc32fast::hash(&sealed).to_le_bytes());
    if let Ok((checkpoint, memories)) = parse(&sealed) {
        EXPERIMENT.with_borrow_mut(|experiment| drop(checkpoint.restore(&memories, experiment)));
    }
});
