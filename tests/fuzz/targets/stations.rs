//! A station file.
#![no_main]

use isobar_obs::StationFile;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Ok(stations) = StationFile::parse(text, "stations.csv") {
        assert!(!stations.records().is_empty());
    }
});
