//! `isobar view`.

use crate::output::recorded::SavedRun;
use crate::output::recorded::recording::{self, VIEWER_VERSION, Viewable};
use crate::text::shown_path;
use miette::{Report, miette};
use std::io::ErrorKind;
use std::path::{Path, PathBuf, absolute};
use std::process::{Command, ExitCode};

/// Opens the recording of a run in the viewer, and waits until it is closed.
pub fn view(run: &Path) -> Result<ExitCode, Report> {
    let run = SavedRun::open(run)?;
    let recording = match recording::of_run(&run)? {
        Viewable::Recording(path) => path,
        Viewable::Data(data) => record(&run, &data)?,
    };
    let install = format!(
        "pip install rerun-sdk=={VIEWER_VERSION}\nor: cargo install rerun-cli --version {VIEWER_VERSION} --locked"
    );
    match Command::new("rerun").arg("--version").output() {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let there = shown_path(&recording);
            let reason = "the rerun viewer is not installed: there is no `rerun` on the PATH";
            return Err(miette!(help = install, "{reason} to show {there}"));
        }
        Err(error) => return Err(miette!(help = install, "the rerun viewer cannot be started: {error}")),
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stdout).into_owned();
            if let Some(version) = version(&text).filter(|version| *version != VIEWER_VERSION) {
                eprintln_quietly(&format!(
                    "warning: the rerun viewer on the PATH is {version}, the recording of {VIEWER_VERSION}; if it looks \
                     wrong: {install}"
                ));
            }
        }
    }
    // From the root: a directory whose name begins with a hyphen is no option of the viewer.
    let status = absolute(&recording).and_then(|recording| Command::new("rerun").arg(recording).status());
    match status {
        Ok(status) if status.success() => Ok(ExitCode::SUCCESS),
        Ok(status) => Err(miette!("the rerun viewer ended with {status}")),
        Err(error) => Err(miette!("the rerun viewer cannot be started: {error}")),
    }
}

/// Makes the recording of a run.
#[cfg(feature = "rerun")]
fn record(run: &SavedRun, data: &Path) -> Result<PathBuf, Report> {
    use crate::output::recorded::recording::RECORDING_FILE;
    use crate::output::viewer_data::ViewerData;
    use crate::output::{contents, rerun};
    let failure = |reason: &dyn std::fmt::Display| miette!("{}: {reason}", shown_path(data));
    let viewer_data = ViewerData::read(data).map_err(|reason| failure(&reason))?;
    // Beside its place, so that it is there complete or not at all.
    let directory = tempfile::Builder::new().prefix(".isobar-").tempdir_in(&run.directory);
    let directory = directory.map_err(|error| failure(&error))?;
    let [made, path] = [directory.path(), &run.directory].map(|directory| directory.join(RECORDING_FILE));
    rerun::write(&viewer_data, &made, &run.summary).map_err(|reason| failure(&reason))?;
    contents::add(&run.directory, RECORDING_FILE).map_err(|error| failure(&error))?;
    std::fs::rename(&made, &path).map_err(|error| failure(&error))?;
    Ok(path)
}

/// Says how the recording of a run is made.
#[cfg(not(feature = "rerun"))]
fn record(run: &SavedRun, data: &Path) -> Result<PathBuf, Report> {
    let again = crate::shell::command("cargo run --release --features rerun -- view", &[&run.directory]);
    let help = format!(
        "in isobar's sources, `{again}` builds one that can (once, for some minutes) and opens the recording; \
         `cargo install --path . --features rerun` installs it"
    );
    let reason = "this isobar cannot make the recording: it was built without the viewer's SDK";
    Err(miette!(help = help, "{}: {reason}", shown_path(data)))
}

fn eprintln_quietly(text: &str) {
    use std::io::Write;
    // There is nowhere to report that standard error is closed.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// The first word of the text that looks like a version.
fn version(text: &str) -> Option<&str> {
    text.split_whitespace()
        .find(|word| word.split('.').count() == 3 && word.split('.').take(2).all(|part| part.parse::<u32>().is_ok()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_viewers_version_is_that_of_the_sdk() {
        let manifest = include_str!("../../Cargo.toml");
        assert!(manifest.contains(&format!("re_sdk = {{ version = \"={VIEWER_VERSION}\"")));
        assert_eq!(version("rerun-cli 0.36.3 [rustc 1.92.0]"), Some("0.36.3"));
        assert_eq!(version("no such thing"), None);
    }
}
