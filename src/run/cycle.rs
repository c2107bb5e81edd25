//! One cycle of one method. The truth cannot enter here: there is no parameter for it.

use super::influence;
use super::monitor::{self, Fault, Monitor};
use crate::correlations::Correlations;
use crate::memory::{self, Memory};
use crate::outcome::{Outcome, Smoothed, UnusedDepartures};
use crate::readings::Readings;
use crate::scores::stability::{Freezing, Stability, Verdicts, Watch, judge};
use isobar_assim::{
    Assimilator, Calibrated, CalibrationAccuracy, Error, Estimate, EstimatedParameter, Structure, Unknown,
    appropriate_time, reserve_workspace,
};
use isobar_model::{Duration, Layout, Model, State};
use isobar_obs::{Calibration, ObservationWindow, TimedObservations};
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::borrow::Cow;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

/// A method in its cycle.
pub struct Runner {
    method: Calibrated,
    /// The model that says whether a state is possible.
    model: Option<Arc<dyn Model>>,
    /// By what rule biases are judged.
    judging: Judging,
    /// Memory that the method holds between cycles \[bytes\].
    held_bytes: i64,
    progress: Progress,
}

/// The progress of a method so far: all that a checkpoint holds of its [`Runner`] beside the method itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    monitor: Monitor,
    watch: Watch,
    /// What the stability monitor found when parameters were frozen.
    when_frozen: Option<Stability>,
    /// The analysis from which the method's trajectory through the next window starts; `None` if it takes all observations as
    /// valid at the end of a window.
    trajectory_start: Option<State>,
    /// What it said of each bias last.
    verdicts: Verdicts,
    /// The most memory that the method held at one time \[bytes\].
    pub peak_bytes: u64,
    /// Wall-clock seconds in all cycles.
    pub seconds: f64,
}

impl Progress {
    /// Forgets what the method has cost so far, which is no part of what another run goes on with.
    pub fn forget_cost(&mut self) {
        (self.peak_bytes, self.seconds) = (0, 0.0);
    }
}

/// By what rule biases are judged, and when those without a stable update are frozen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Judging {
    /// The parameters.
    pub calibration: Calibration,
    /// Those that keep more than this share of their prior variance have no stable update.
    pub variance_ratio: f64,
    /// When those without one are adjusted no more.
    pub freezing: Freezing,
    /// The cycle of the method's first analysis, before which none is frozen.
    pub first_analysis: usize,
}

impl Runner {
    /// Sets up a method.
    ///
    /// # Errors
    /// Those of `build`.
    pub fn new<M: Into<Calibrated>, E>(build: impl FnOnce() -> Result<M, E>) -> Result<Self, E> {
        reserve_workspace();
        let (method, memory) = memory::measured(|| build().map(Into::into));
        let mut runner = Self {
            method: method?,
            model: None,
            judging: Judging::default(),
            held_bytes: 0,
            progress: Progress::default(),
        };
        runner.account(memory);
        Ok(runner)
    }

    /// The same with a stability monitor that counts from a cycle on, and perhaps freezes parameters.
    pub fn watched(self, from_cycle: usize, judging: Judging) -> Self {
        Self { progress: Progress { watch: Watch::new(from_cycle), ..self.progress }, judging, ..self }
    }

    /// The same with a model whose states the estimates must be.
    pub fn of_model(self, model: Arc<dyn Model>) -> Self {
        Self { model: Some(model), ..self }
    }

    /// The same where observations within a window are compared with the trajectory from the last analysis at their times, first
    /// from this background: see [`isobar_obs::WithinWindow`]. The trajectory is that of the model alone, without random errors.
    pub fn at_appropriate_time(self, background: State) -> Self {
        Self { progress: Progress { trajectory_start: Some(background), ..self.progress }, ..self }
    }

    /// What the stability monitor says of the biases.
    ///
    /// # Errors
    /// If the prior of the parameters is no covariance.
    pub fn stability(&self, layout: &Layout) -> Result<Stability, isobar_assim::Error> {
        let Judging { calibration, variance_ratio, .. } = &self.judging;
        let Progress { watch, when_frozen, .. } = &self.progress;
        judge(watch, &self.method, calibration, layout, *variance_ratio, when_frozen.as_ref())
    }

    fn freeze(&mut self, cycle: usize, layout: &Layout) -> Result<(), isobar_assim::Error> {
        if self.judging.freezing != Freezing::AfterCycle(cycle) {
            return Ok(());
        }
        let stability = self.stability(layout)?;
        let unstable = stability.parameters.iter().enumerate().filter(|(_, own)| !own.stable);
        let unstable: Vec<usize> = unstable.map(|(number, _)| number).collect();
        self.progress.when_frozen = Some(stability);
        self.method.freeze(&unstable)
    }

    /// How many later cycles revise an estimate of the method, if it has a smoother.
    pub fn smoother_lag(&self) -> Option<usize> {
        self.method.can().smoother.map(|smoother| smoother.lag())
    }

    /// Whether the method estimates biases.
    pub fn estimates_biases(&self) -> bool {
        self.method.can().calibration.is_some()
    }

    /// Forecasts over a window and analyses the observations at its end, with bias predictors of that forecast;
    /// `with_influence` asks also what each type of observations did, which is no part of the method's cost and changes
    /// nothing in its results. After the `last` cycle no estimate will be revised any more.
    ///
    /// # Errors
    /// Why the method cannot continue: see [`Fault`]. It must not be called again.
    pub fn cycle(
        &mut self,
        window: Duration,
        observed: &ObservationWindow,
        with_influence: bool,
        last: bool,
    ) -> Result<Outcome, Fault> {
        let before = self.progress.seconds;
        let from = self.step(|method| method.forecast(window))?;
        // All members of an ensemble share the predictors of its mean.
        let observed = &*observed.anchored(&from.estimate.state);
        let observed = &*self.at_their_times(window, observed, from.estimate.calibration.len())?;
        let asked = (with_influence && !observed.is_empty()).then(|| self.method.clone());
        let analysis = self.step(|method| method.analyse(&from, observed))?;
        let smoothed = self.step(|method| smoothed(method, last))?;
        let seconds = self.progress.seconds - before;
        let unused = UnusedDepartures {
            background: departures(observed, &from.estimate),
            analysis: departures(observed, &analysis.estimate),
        };
        let calibration = self.method.can().calibration;
        let readings =
            calibration.map(|errors| Readings::new(observed, &analysis.estimate, || errors.calibration_accuracy()));
        let background = from.estimate.clone();
        let (influence, verdicts) = (None, Vec::new());
        let mut outcome = Outcome { background, analysis, smoothed, unused, readings, influence, verdicts, seconds };
        // What is given back is not the method's to hold.
        self.held_bytes -= outcome.bytes();
        self.progress.monitor.check(&outcome)?;
        if let Some(model) = &self.model {
            monitor::check_possible(&**model, &outcome)?;
        }
        if let Some(method) = asked {
            let innovations = &outcome.analysis.background_departures;
            outcome.influence = Some(guarded(|| influence::ask(&method, &from, observed, innovations))?);
        }
        let compared = if self.method.takes_comparisons() { &*observed.comparisons } else { &[] };
        self.progress.watch.add(observed, compared, &outcome);
        self.freeze(observed.cycle, outcome.background.state.layout())?;
        if let Some(start) = &mut self.progress.trajectory_start {
            // Of a method's state only the values count: not every method says when it is valid.
            *start = outcome.analysis.estimate.state.clone().valid_at(observed.time);
        }
        let Progress { watch, when_frozen, verdicts, .. } = &mut self.progress;
        let Judging { variance_ratio, freezing, first_analysis, .. } = self.judging;
        let rule = (variance_ratio, if observed.cycle < first_analysis { Freezing::Never } else { freezing });
        let analysis = &outcome.analysis.estimate;
        outcome.verdicts = verdicts.judge(watch, &mut self.method, analysis, rule, when_frozen.as_ref())?;
        Ok(outcome)
    }

    /// The observations as the method compares them with its trajectory through the window.
    fn at_their_times<'a>(
        &mut self,
        window: Duration,
        observed: &'a ObservationWindow,
        parameters: usize,
    ) -> Result<Cow<'a, ObservationWindow>, Fault> {
        let (Some(start), Some(model)) = (&self.progress.trajectory_start, &self.model) else {
            return Ok(observed.at_end());
        };
        let began = Instant::now();
        let shift =
            |within: TimedObservations<'_>| appropriate_time::shift(&**model, start, window, within, parameters);
        let seen = guarded(|| observed.at_appropriate_time(shift));
        self.progress.seconds += began.elapsed().as_secs_f64();
        seen
    }

    /// A part of the method's work, whose cost is measured.
    fn step<T>(&mut self, work: impl FnOnce(&mut dyn Assimilator) -> Result<T, Error>) -> Result<T, Fault> {
        let began = Instant::now();
        let method = &mut self.method;
        let (result, memory) = memory::measured(|| guarded(|| work(method)));
        self.account(memory);
        self.progress.seconds += began.elapsed().as_secs_f64();
        result
    }

    /// The method's blocks and leading common factors after the cycle with this background, for viewers; no part of its cost.
    pub fn structure(&self, observed: &ObservationWindow, background: &State, factors: usize) -> Option<Structure> {
        Some(self.method.can().blocks?.structure(&observed.anchored(background), factors))
    }

    /// What goes together with the error of one value of the analysis, for viewers; no part of the method's cost.
    pub fn correlations(&self, of: usize, analysis: &Estimate) -> Option<Correlations> {
        let errors = self.method.can().joint_errors?;
        Correlations::new(of, &errors.covariance_column(Unknown::Value(of))?, analysis)
    }

    /// What the method has estimated in the last cycle beside state and calibration.
    pub fn parameters(&self) -> Vec<EstimatedParameter> {
        self.method.can().parameters.map_or_else(Vec::new, |it| it.estimated_parameters())
    }

    /// What the method knows of the biases now; `None` if it does not estimate them.
    pub fn calibration(&self) -> Option<(Vec<f64>, CalibrationAccuracy)> {
        Some((self.method.calibration(), self.method.can().calibration?.calibration_accuracy()))
    }

    /// The method as it is now, to be copied.
    pub fn method(&self) -> &dyn Assimilator {
        &self.method
    }

    /// The model whose states the estimates must be, if it is known.
    pub fn model(&self) -> Option<&dyn Model> {
        self.model.as_deref()
    }

    /// What the method has cost, and what its monitors have seen.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Sets a method that has just been built back to its memory, which must be all that there is to read, and its progress in a
    /// checkpoint.
    ///
    /// # Errors
    /// Those of the method, if it is of another one.
    pub fn restore(&mut self, from: &mut dyn Read, saved: Progress, layout: &Layout) -> Result<(), Error> {
        let (result, used) = memory::measured(|| self.method.recall(from));
        self.account(used);
        result?;
        if !matches!(from.read(&mut [0]), Ok(0)) {
            return Err(Error::Memory { reason: "it is too long".into() });
        }
        if !saved.watch.fits(layout) || !saved.verdicts.fits(self.method.frozen().len()) {
            return Err(Error::Memory { reason: "the stability monitor does not fit the experiment".into() });
        }
        let starts =
            [&self.progress.trajectory_start, &saved.trajectory_start].map(|it| it.as_ref().map(State::layout));
        if starts[0] != starts[1] {
            return Err(Error::Memory { reason: "the start of the trajectory does not fit the experiment".into() });
        }
        let peak_bytes = self.progress.peak_bytes.max(saved.peak_bytes);
        self.progress = Progress { peak_bytes, ..saved };
        Ok(())
    }

    fn account(&mut self, memory: Memory) {
        self.progress.peak_bytes = self.progress.peak_bytes.max((self.held_bytes + memory.peak_bytes).max(0) as u64);
        self.held_bytes += memory.left_bytes;
    }
}

/// How the observations that no method sees depart from an estimate.
fn departures(observed: &ObservationWindow, estimate: &Estimate) -> Vec<Option<f64>> {
    observed.aside.departures(&estimate.state, &estimate.calibration)
}

/// The estimates of a method with a smoother that no later analysis revises.
fn smoothed(method: &dyn Assimilator, last: bool) -> Result<Vec<Smoothed>, Error> {
    let Some(smoother) = method.can().smoother else { return Ok(Vec::new()) };
    let lag = smoother.lag();
    let ages = if last { 0..=lag } else { lag..=lag };
    let of_age = |cycles_ago| {
        let estimate = smoother.smoothed(cycles_ago).transpose()?;
        Some(estimate.map(|estimate| Smoothed { cycles_ago, estimate }))
    };
    ages.rev().filter_map(of_age).collect()
}

/// What a method does. A panic is a fault of this program, but no reason to lose the work of the other methods.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, Fault> {
    let result = catch_unwind(AssertUnwindSafe(work)).map_err(|panic| Fault::Panic(in_words(&*panic)))?;
    Ok(result?)
}

/// What a panic says.
fn in_words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied().or(panic.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("it does not say what").to_string()
}
