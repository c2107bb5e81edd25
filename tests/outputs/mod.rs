//! The outputs of a run, as far as they must be the same whenever it is run.

use isobar::scores::Summary;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// The netCDF files and the final state, byte for byte, and the summary without times and memory.
pub struct Outputs {
    pub files: BTreeMap<String, Vec<u8>>,
    pub summary: Summary,
}

impl Outputs {
    /// Those of a complete run.
    pub fn of(run: &Path) -> Self {
        let mut files = BTreeMap::new();
        for entry in fs::read_dir(run).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "nc" || extension == "bin") {
                let name = path.file_name().unwrap().to_string_lossy().into_owned();
                files.insert(name, fs::read(&path).unwrap());
            }
        }
        let text = fs::read_to_string(run.join("summary.json")).unwrap();
        let mut summary: Summary = serde_json::from_str(&text).unwrap();
        for scores in summary.methods.values_mut() {
            scores.values.retain(|key, _| !["seconds_per_cycle", "peak_memory_bytes"].contains(&key.as_str()));
        }
        Self { files, summary }
    }

    /// Panics unless all is the same.
    pub fn assert_same(&self, other: &Outputs, what: &str) {
        assert!(self.files.keys().eq(other.files.keys()), "{what}: other files");
        for (name, bytes) in &self.files {
            assert!(*bytes == other.files[name], "{what}: {name} differs");
        }
        assert_eq!(self.summary, other.summary, "{what}");
    }
}
