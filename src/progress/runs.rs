//! How far several runs are, all on one display.

use super::display::Display;
use crate::event::Event;
use crate::output::{Sink, SinkError};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Shows the progress of runs that may run at the same time.
pub struct RunsProgress {
    shared: Mutex<Shared>,
    noun: &'static str,
    runs: usize,
    analyses_per_run: usize,
}

struct Shared {
    display: Display,
    analyses: usize,
    complete: usize,
}

impl RunsProgress {
    /// A display that suits standard error; nothing at all if `quiet`. `noun` says what the runs are, in the plural.
    pub fn new(quiet: bool, title: &str, noun: &'static str, runs: usize, analyses_per_run: usize) -> Self {
        let mut display = Display::new(quiet);
        display.start(title, runs * analyses_per_run);
        Self { shared: Mutex::new(Shared { display, analyses: 0, complete: 0 }), noun, runs, analyses_per_run }
    }

    /// What hears the run of this name; the run is complete when it is dropped.
    pub fn listener(&self, name: String) -> RunListener<'_> {
        RunListener { progress: self, name, done: 0 }
    }

    /// Does something that prints, without the display in its way.
    pub fn aside(&self, work: impl FnOnce()) {
        self.lock().display.aside(work);
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Hears one run.
pub struct RunListener<'a> {
    progress: &'a RunsProgress,
    name: String,
    done: usize,
}

impl Sink for RunListener<'_> {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Analysed(analysed) => self.analysed(1, analysed.cycle),
            Event::Failed { failure, .. } => self.method_failed(failure.cycle, &failure.reason),
            Event::Warning(text) => self.warning(text),
            _ => {}
        }
        Ok(())
    }
}

impl RunListener<'_> {
    /// There were this many more analyses, the last of them in `cycle`.
    pub fn analysed(&mut self, count: usize, cycle: usize) {
        self.done += count;
        let mut shared = self.progress.lock();
        shared.analyses += count;
        let Shared { display, analyses, complete } = &mut *shared;
        let (name, RunsProgress { runs, noun, .. }) = (&self.name, self.progress);
        display.advance(*analyses, || format!("{complete} of {runs} {noun}; {name}, cycle {cycle}"));
    }

    /// A method has failed.
    pub fn method_failed(&mut self, cycle: usize, reason: &str) {
        self.warning(&format!("a method failed in cycle {cycle}: {reason}"));
    }

    /// There is something to be said to the user.
    pub fn warning(&mut self, text: &str) {
        self.progress.lock().display.warn(&format!("{}: {text}", self.name));
    }
}

impl Drop for RunListener<'_> {
    fn drop(&mut self) {
        let mut shared = self.progress.lock();
        shared.complete += 1;
        // What a run that failed leaves undone will never be done.
        shared.analyses += self.progress.analyses_per_run.saturating_sub(self.done);
    }
}
