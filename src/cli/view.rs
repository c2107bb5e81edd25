//! `isobar view`.

use crate::output::recorded::SavedRun;
use crate::output::recorded::recording::{self, VIEWER_VERSION};
use crate::text::shown_path;
use miette::{Report, miette};
use std::io::ErrorKind;
use std::path::{Path, absolute};
use std::process::{Command, ExitCode};

/// Opens the recording of a run in the viewer, and waits until it is closed.
pub fn view(run: &Path) -> Result<ExitCode, Report> {
    let run = SavedRun::open(run)?;
    let recording = recording::of_run(&run)?;
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
