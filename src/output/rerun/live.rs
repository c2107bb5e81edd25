//! A running viewer that is sent the run while it computes.

use super::names::{APPLICATION_ID, Result};
use super::ranges::Ranges;
use super::recording;
use crate::event::RunInfo;
use crate::output::history::History;
use crate::output::recorded::recording::VIEWER_VERSION;
use crate::scores::Summary;
use crate::text::clean;
use re_sdk::{RecordingStream, RecordingStreamBuilder};
use std::fmt;
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::time::Duration;

/// The port on which a viewer listens by default, and the environment variable that names another.
const PORT: u16 = 9876;
const PORT_VARIABLE: &str = "ISOBAR_VIEWER_PORT";

/// How long a viewer may take to answer.
const PATIENCE: Duration = Duration::from_secs(3);

/// A connection to a viewer.
pub struct Live {
    recording: RecordingStream,
    /// The ranges that the viewer was sent.
    ranges: Option<Ranges>,
}

impl fmt::Debug for Live {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Live").finish_non_exhaustive()
    }
}

impl Live {
    /// Connects to the viewer that listens on this machine.
    ///
    /// # Errors
    /// In words, if there is none, or the environment names no port.
    pub fn connect(info: &RunInfo) -> std::result::Result<Self, String> {
        let viewer = viewer()?;
        let absent = |reason: &dyn fmt::Display| {
            format!(
                "no rerun viewer listens on {viewer} ({reason}), the run goes on without it; start one with `rerun` \
                 before the run (pip install rerun-sdk=={VIEWER_VERSION})"
            )
        };
        // The viewer's own connection would wait for it, and only say so at the end.
        TcpStream::connect_timeout(&viewer, PATIENCE).map_err(|error| absent(&error))?;
        let builder =
            RecordingStreamBuilder::new(APPLICATION_ID).recording_id(recording::id(info)).send_properties(false);
        let recording = builder.connect_grpc_opts(format!("rerun+http://{viewer}/proxy"));
        Ok(Self { recording: recording.map_err(|error| absent(&error))?, ranges: None })
    }

    /// Shows a cycle. After 1, 2, 4, 8, … cycles it shows all of them anew, in the ranges that suit them; in between the
    /// ranges and the user's layout stay as they are.
    ///
    /// # Errors
    /// If the viewer is gone.
    pub fn show(&mut self, info: &RunInfo, history: &History, cycle: usize) -> Result {
        match &self.ranges {
            Some(ranges) if !cycle.is_power_of_two() => {
                recording::log_since(&self.recording, info, history, ranges, cycle)?;
            }
            _ => {
                let curves_since = if self.ranges.is_some() { cycle } else { 0 };
                recording::log_run(&self.recording, info, history, None, curves_since)?;
                self.ranges = Some(Ranges::of_run(info, history));
            }
        }
        self.flush()
    }

    /// Shows the complete run.
    ///
    /// # Errors
    /// If the viewer is gone.
    pub fn finish(&self, info: &RunInfo, history: &History, summary: &Summary) -> Result {
        let curves_since = if self.ranges.is_some() { info.cycles + 1 } else { 0 };
        recording::log_run(&self.recording, info, history, Some(summary), curves_since)?;
        self.flush()
    }

    fn flush(&self) -> Result {
        Ok(self.recording.flush_with_timeout(PATIENCE)?)
    }
}

/// Where the viewer listens.
fn viewer() -> std::result::Result<SocketAddr, String> {
    let port = match std::env::var_os(PORT_VARIABLE) {
        None => PORT,
        Some(text) => text.to_str().and_then(|text| text.parse().ok()).filter(|&port| port > 0).ok_or_else(|| {
            let text = clean(&text.to_string_lossy());
            format!("{PORT_VARIABLE} is `{text}`, but must be a port, 1 to 65535; the run goes on without a viewer")
        })?,
    };
    Ok(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
}
