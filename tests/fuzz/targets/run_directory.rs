//! The files of a run's directory: `summary.json`, a zero byte, `scores.csv`. They are compared, or refused in words that no
//! terminal obeys.
#![no_main]

use isobar::comparison::Comparison;
use isobar::output::recorded::{SavedRun, Scores};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|text: &str| {
    let (json, csv) = text.split_once('\0').unwrap_or((text, ""));
    let directory = Path::new("run");
    let scores = Scores::parse(csv);
    match SavedRun::parse(json, directory, &directory.join("summary.json")) {
        Err(error) => assert!(!error.to_string().chars().any(char::is_control), "{error}"),
        Ok(run) => {
            let Ok(scores) = scores else { return };
            let comparison = Comparison::of(vec![(run.clone(), scores.clone()), (run, scores)]);
            let _ = (comparison.between_runs(), comparison.within_runs());
        }
    }
});
