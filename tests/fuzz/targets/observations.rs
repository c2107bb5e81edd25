//! A file of observations.
#![no_main]

use isobar_obs::ObservationFile;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Ok(file) = ObservationFile::parse(text, "observations.csv", None) {
        assert!(!file.records().is_empty());
        for record in file.records() {
            assert!(record.value.is_finite() && record.sigma.is_none_or(|sigma| sigma > 0.0 && sigma.is_finite()));
        }
    }
});
