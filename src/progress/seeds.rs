//! How far the runs of several seeds are, all on one display.

use super::display::Display;
use crate::event::Event;
use crate::output::{Sink, SinkError};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Shows the progress of runs that may run at the same time.
pub struct SeedsProgress {
    shared: Mutex<Shared>,
    seeds: usize,
    analyses_per_seed: usize,
}

struct Shared {
    display: Display,
    analyses: usize,
    complete: usize,
}

impl SeedsProgress {
    /// A display that suits standard error; nothing at all if `quiet`.
    pub fn new(quiet: bool, scenario: &str, seeds: usize, analyses_per_seed: usize) -> Self {
        let mut display = Display::new(quiet);
        display.start(scenario, seeds * analyses_per_seed);
        Self { shared: Mutex::new(Shared { display, analyses: 0, complete: 0 }), seeds, analyses_per_seed }
    }

    /// What hears the run of a seed; the seed is complete when it is dropped.
    pub fn listener(&self, seed: u64) -> SeedListener<'_> {
        SeedListener { progress: self, seed, done: 0 }
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Hears the run of one seed.
pub struct SeedListener<'a> {
    progress: &'a SeedsProgress,
    seed: u64,
    done: usize,
}

impl Sink for SeedListener<'_> {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Analysed(analysed) => {
                self.done += 1;
                let mut shared = self.progress.lock();
                shared.analyses += 1;
                let Shared { display, analyses, complete } = &mut *shared;
                let (cycle, seed, seeds) = (analysed.cycle, self.seed, self.progress.seeds);
                display.advance(*analyses, || format!("{complete} of {seeds} seeds; seed {seed}, cycle {cycle}"));
            }
            Event::Failed { failure, .. } => {
                let text =
                    format!("seed {}: a method failed in cycle {}: {}", self.seed, failure.cycle, failure.reason);
                self.progress.lock().display.warn(&text);
            }
            Event::Warning(text) => self.progress.lock().display.warn(&format!("seed {}: {text}", self.seed)),
            _ => {}
        }
        Ok(())
    }
}

impl Drop for SeedListener<'_> {
    fn drop(&mut self) {
        let mut shared = self.progress.lock();
        shared.complete += 1;
        // What a run that failed leaves undone will never be done.
        shared.analyses += self.progress.analyses_per_seed.saturating_sub(self.done);
    }
}
