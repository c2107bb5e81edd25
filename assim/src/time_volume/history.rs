//! What is kept of the cycles of the window, from which they can be run again.

use super::observed::Observed;
use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::blocks::BlockErrors;
use crate::filter::Errors;
use crate::memory::require;
use isobar_model::Duration;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The cycles of the window and up to half a window before it, in parts of half a window, oldest first. `M` is the type of what
/// a part keeps of its start beside the covariance.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct History<M>(pub VecDeque<Part<M>>);

/// What was known at the start of some cycles, and what happened in them.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Part<M> {
    pub errors: <BlockErrors as Errors>::Memory,
    /// Without a history.
    pub memory: M,
    pub events: Vec<Event>,
}

#[derive(Clone, Serialize, Deserialize)]
pub(super) enum Event {
    Forecast(Duration),
    Analysis(Observed),
}

impl<M> Default for History<M> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<M> History<M> {
    /// What is kept of its starts.
    pub fn memories(&self) -> impl Iterator<Item = &M> {
        self.0.iter().map(|part| &part.memory)
    }

    /// Fails if its observations are not of q unknowns and a state with parameters like `s`: it has been read from a file.
    pub fn require(&self, s: &Augmented, q: usize) -> Result<(), Error> {
        for event in self.0.iter().flat_map(|part| &part.events) {
            if let Event::Analysis(observed) = event {
                require(observed.fits(s, q), "an analysis in the history of the time volume")?;
            }
        }
        Ok(())
    }
}

impl<M> Part<M> {
    /// The number of its analyses.
    pub fn analyses(&self) -> usize {
        self.events.iter().filter(|event| matches!(event, Event::Analysis(_))).count()
    }
}
