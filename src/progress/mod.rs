//! How far a run is, for whoever waits for it.

mod display;
mod exact;
mod runs;

pub use exact::ExactProgress;
pub use runs::{RunListener, RunsProgress};

use crate::event::{Event, RunInfo};
use crate::output::{Sink, SinkError};
use crate::scores::Failure;
use display::Display;

/// Shows the progress of a run on standard error: a bar on a terminal, an occasional line in a pipe, or nothing.
pub struct Progress {
    display: Display,
    info: Option<RunInfo>,
    done: usize,
}

impl Progress {
    /// A display that suits standard error; nothing at all if `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self { display: Display::new(quiet), info: None, done: 0 }
    }

    fn failed(&mut self, method: usize, failure: &Failure) {
        let Some(info) = &self.info else { return };
        // What it will not do need not be waited for.
        self.done += (info.cycles + 1).saturating_sub(failure.cycle.max(info.done + 1));
        let name = info.methods.get(method).map_or("", |method| method.name.as_str());
        let (cycle, reason) = (failure.cycle, &failure.reason);
        self.display.warn(&format!("method {name} failed in cycle {cycle}, the others go on: {reason}"));
    }
}

impl Sink for Progress {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(info) => {
                self.done = 0;
                self.display.start(&info.scenario, info.count() * info.methods.len());
                self.info = Some((*info).clone());
            }
            Event::Analysed(analysed) => {
                self.done += 1;
                if let Some(info) = &self.info {
                    let name = info.methods.get(analysed.method).map_or("", |method| method.name.as_str());
                    let message = || format!("cycle {} of {}, {name}", analysed.cycle, info.cycles);
                    self.display.advance(self.done, message);
                }
            }
            Event::Finished(_) => self.display.finish(),
            Event::Warning(text) => self.display.warn(text),
            Event::Failed { method, failure } => self.failed(*method, failure),
            Event::Resumed(_) => self.display.resume(self.done),
            Event::Truth { .. }
            | Event::Observed { .. }
            | Event::Estimated(_)
            | Event::Judged(_)
            | Event::Smoothed(_)
            | Event::Outlook { .. }
            | Event::Forecast(_)
            | Event::CycleEnded(_) => {}
        }
        Ok(())
    }
}
