//! A station file.
#![no_main]

use isobar_obs::Stations;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Ok(stations) = Stations::parse(text, "stations.csv") {
        assert!(!stations.records().is_empty());
        for column in stations.columns().to_vec() {
            let groups = vec!["A".to_string()];
            let _ = stations.clone().only("network", &column, &groups);
        }
    }
});
