//! The recording in a run's directory, and whether it is complete, as far as its first and last bytes show.

use super::{SavedRun, SavedRunError};
use crate::output::viewer_data::VIEWER_DATA_FILE;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Name of the recording in a run's directory.
pub const RECORDING_FILE: &str = "recording.rrd";

/// The version of the viewer that shows recordings; that of the SDK in Cargo.toml.
pub const VIEWER_VERSION: &str = "0.36.3";

/// What a recording begins with, and what the record at its end holds.
const BEGINNING: &[u8] = b"RRF2";
const ENDING: &[u8] = b"FOOT";
const ENDING_WITHIN: u64 = 64;

/// What there is to look at of a run.
#[derive(Debug)]
pub enum Viewable {
    /// Its recording.
    Recording(PathBuf),
    /// The file of which a recording can be made.
    Data(PathBuf),
}

/// What there is to look at of a run.
///
/// # Errors
/// If there is nothing, or the recording is not complete.
pub fn of_run(run: &SavedRun) -> Result<Viewable, SavedRunError> {
    let path = run.directory.join(RECORDING_FILE);
    if !path.is_file() {
        let data = run.directory.join(VIEWER_DATA_FILE);
        if data.is_file() {
            return Ok(Viewable::Data(data));
        }
        let error = SavedRunError::new(&run.directory, "the run has no recording");
        return Err(error.with_help("run it again without --no-rerun"));
    }
    let ends = ends(&path).map_err(|error| SavedRunError::new(&path, format!("it cannot be read: {error}")))?;
    let broken = |reason: &str| SavedRunError::new(&path, reason).with_help("run it again");
    match ends {
        (beginning, _) if beginning != BEGINNING => Err(broken("it is not a recording of rerun's second format")),
        (_, end) if !end.windows(ENDING.len()).any(|part| part == ENDING) => Err(broken("its end is missing")),
        _ => Ok(Viewable::Recording(path)),
    }
}

fn ends(path: &Path) -> std::io::Result<(Vec<u8>, Vec<u8>)> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let (mut beginning, mut end) = (Vec::new(), Vec::new());
    file.by_ref().take(BEGINNING.len() as u64).read_to_end(&mut beginning)?;
    file.seek(SeekFrom::Start(length.saturating_sub(ENDING_WITHIN)))?;
    file.read_to_end(&mut end)?;
    Ok((beginning, end))
}
