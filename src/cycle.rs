//! One cycle of one method. The truth cannot enter here: there is no parameter for it.

use isobar_assim::{Analysis, Assimilator, Error, Estimate};
use isobar_model::Duration;
use isobar_obs::ObservationWindow;
use peak_alloc::PeakAlloc;
use std::time::Instant;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// A method, and what it has cost so far.
pub struct Runner {
    method: Box<dyn Assimilator>,
    /// Memory that the method holds between cycles \[bytes\].
    held_bytes: i64,
    /// The most that it held at one time \[bytes\].
    pub peak_bytes: u64,
    /// Wall-clock seconds in all cycles.
    pub seconds: f64,
}

/// What a method made of one cycle.
pub struct Outcome {
    /// The estimate before the observations.
    pub background: Estimate,
    /// The analysis.
    pub analysis: Analysis,
    /// Wall-clock seconds that it took.
    pub seconds: f64,
}

impl Runner {
    /// Sets up a method.
    ///
    /// # Errors
    /// Those of `build`.
    pub fn new<E>(build: impl FnOnce() -> Result<Box<dyn Assimilator>, E>) -> Result<Self, E> {
        let (method, memory) = measured(build);
        let mut runner = Self { method: method?, held_bytes: 0, peak_bytes: 0, seconds: 0.0 };
        runner.account(memory);
        Ok(runner)
    }

    /// Forecasts over a window and analyses the observations at its end.
    ///
    /// # Errors
    /// Those of the method.
    pub fn cycle(&mut self, window: Duration, observed: &ObservationWindow) -> Result<Outcome, Error> {
        let began = Instant::now();
        let (result, memory) = measured(|| -> Result<_, Error> {
            let background = self.method.forecast(window)?;
            let analysis = self.method.analyse(observed)?;
            Ok((background, analysis))
        });
        self.account(memory);
        let (background, analysis) = result?;
        let seconds = began.elapsed().as_secs_f64();
        self.seconds += seconds;
        Ok(Outcome { background, analysis, seconds })
    }

    fn account(&mut self, (peak, left): (i64, i64)) {
        self.peak_bytes = self.peak_bytes.max((self.held_bytes + peak).max(0) as u64);
        self.held_bytes += left;
    }
}

/// The result of `work`, with the memory that it took at most and that it left allocated, beyond what there was before.
fn measured<T>(work: impl FnOnce() -> T) -> (T, (i64, i64)) {
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage() as i64;
    let result = work();
    (result, (MEMORY.peak_usage() as i64 - before, MEMORY.current_usage() as i64 - before))
}
