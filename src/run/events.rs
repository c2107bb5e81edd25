//! Where the events of a run go.

use super::checkpoint::Keeper;
use crate::event::Event;
use crate::output::{Sink, SinkError};

/// All that hears the events of a run.
pub(super) struct Events<'a> {
    /// Journal and checkpoints, if the run has them.
    pub keeper: Option<Keeper>,
    /// The outputs.
    pub sinks: Vec<Box<dyn Sink>>,
    /// The progress display, or a test.
    pub listener: &'a mut dyn Sink,
}

impl Events<'_> {
    /// Writes an event to the journal, and announces it.
    ///
    /// # Errors
    /// Those of the journal and the outputs.
    pub fn send(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        if let Some(keeper) = &mut self.keeper {
            keeper.record(event)?;
        }
        self.announce(event)
    }

    /// Sends an event to outputs and listener, but not to the journal.
    ///
    /// # Errors
    /// Those of the outputs.
    pub fn announce(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        self.sinks.record(event)?;
        for warning in self.sinks.warnings() {
            self.listener.record(&Event::Warning(&warning))?;
        }
        self.listener.record(event)
    }
}
