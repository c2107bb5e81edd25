//! The recording in a run's directory: whether it is complete, as far as its first and last bytes show, and how it is made later.

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

/// The recording of a run; made now, if the run left only what it is made of.
///
/// # Errors
/// If there is neither, if this isobar cannot make it, or if the recording is not complete.
pub fn of_run(run: &SavedRun) -> Result<PathBuf, SavedRunError> {
    let path = run.directory.join(RECORDING_FILE);
    if !path.is_file() {
        let data = run.directory.join(VIEWER_DATA_FILE);
        if !data.is_file() {
            let error = SavedRunError::new(&run.directory, "the run has no recording");
            return Err(error.with_help("run it again without --no-rerun"));
        }
        make(run, &data)?;
    }
    let ends = ends(&path).map_err(|error| SavedRunError::new(&path, format!("it cannot be read: {error}")))?;
    let broken = |reason: &str| SavedRunError::new(&path, reason).with_help("run it again");
    match ends {
        (beginning, _) if beginning != BEGINNING => Err(broken("it is not a recording of rerun's second format")),
        (_, end) if !end.windows(ENDING.len()).any(|part| part == ENDING) => Err(broken("its end is missing")),
        _ => Ok(path),
    }
}

/// Makes the recording of a run.
#[cfg(feature = "rerun")]
fn make(run: &SavedRun, data: &Path) -> Result<(), SavedRunError> {
    use crate::output::viewer_data::ViewerData;
    use crate::output::{contents, rerun};
    let directory = &run.directory;
    let viewer_data = ViewerData::read(data).map_err(|reason| SavedRunError::new(data, reason))?;
    let failure = |error: std::io::Error| SavedRunError::new(directory, format!("the recording is not made: {error}"));
    // Beside its place, so that it is there complete or not at all.
    let temporary = tempfile::Builder::new().prefix(".isobar-").tempdir_in(directory).map_err(failure)?;
    let made = temporary.path().join(RECORDING_FILE);
    rerun::write(&viewer_data, &made, &run.summary).map_err(|reason| SavedRunError::new(&made, reason))?;
    contents::add(directory, RECORDING_FILE).map_err(failure)?;
    std::fs::rename(&made, directory.join(RECORDING_FILE)).map_err(failure)
}

/// Says how the recording of a run is made.
#[cfg(not(feature = "rerun"))]
fn make(run: &SavedRun, data: &Path) -> Result<(), SavedRunError> {
    let again = crate::shell::command("cargo run --release --features rerun -- view", &[&run.directory]);
    let error =
        SavedRunError::new(data, "this isobar cannot make the recording: it was built without the viewer's SDK");
    Err(error.with_help(format!(
        "in isobar's sources, `{again}` builds one that can (once, for some minutes) and opens the recording; \
         `cargo install --path . --features rerun` installs it"
    )))
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
