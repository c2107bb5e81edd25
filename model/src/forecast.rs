//! What a model is: three small traits, each a capability, and the loops over time steps, each written once.

use crate::arithmetic::Arithmetic;
use crate::bands::Bands;
use crate::communicator::RankFailure;
use crate::error::ModelError;
use crate::state::{Layout, State};
use crate::stored::{ColumnsMut, Stored};
use crate::time::{Duration, Time};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// A forecast model: x(t + Δt) = M(x(t), t).
///
/// The time t is that of the state: it is advanced with it, copied with it and stored with it, so that a forecast starts at the
/// time of its state, and at no other.
pub trait Model: Send + Sync {
    /// Grid and variables.
    fn layout(&self) -> &Arc<Layout>;

    /// The time step Δt.
    fn time_step(&self) -> Duration;

    /// The steps of the time scheme that are one [`Model::step`].
    fn substeps(&self) -> usize {
        1
    }

    /// The largest stable step of the time scheme at `x` \[s\]; infinite where there is no limit.
    fn largest_time_step_s(&self, x: &State) -> f64;

    /// The model on some rows of the grid, as a domain of its own with walls at both ends, where `rows` may go beyond a periodic
    /// edge: a step is the same as on the whole, to the bit, but within [`Model::reach`] rows of an end that is no wall of the
    /// whole, where it may change nothing. `None` if there is no such form of it.
    fn in_rows(&self, _rows: &Range<isize>) -> Option<Arc<dyn Adjoint>> {
        None
    }

    /// How many rows of the state on either side a step depends on, at most.
    fn reach(&self) -> usize {
        self.layout().grid.ny
    }

    /// What advances states that several ranks have, each its rows; `None` if this process has all of them.
    fn in_bands(&self) -> Option<&dyn InBands> {
        None
    }

    /// Whether M depends on t, so that a forecast can start only from a state that knows its valid time.
    fn needs_time(&self) -> bool {
        false
    }

    /// Fails if no forecast can start from the values of `x`: one is not finite or, where the model has a thickness, that is not
    /// positive.
    ///
    /// # Errors
    /// [`ModelError`] with the place and the value.
    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        require_finite_state(x)
    }

    /// Advances `x` by one time step: its values, and its valid time by [`State::advance`]. A model whose right-hand side
    /// depends on time finds the time before the step in [`State::time`].
    fn step(&self, x: &mut State);

    /// How many states [`Model::steps`] is best called with: one, if it gains nothing from several.
    fn best_together(&self) -> usize {
        1
    }

    /// Advances each of the states by `steps` time steps, to the same bits as by single steps of each alone, where these stay
    /// finite; where they do not, to values that are not all finite.
    ///
    /// The default takes single steps; a model overrides it if it is faster with all steps, or with several states, at once.
    fn steps(&self, states: &mut [State], steps: usize) {
        for x in states {
            for _ in 0..steps {
                self.step(x);
                if x.first_non_finite().is_some() {
                    break;
                }
            }
        }
    }
}

/// A model of which each of several ranks has the states and increments in its band of rows. All functions are collective.
pub trait InBands: Send + Sync {
    /// Which rank has which rows.
    fn bands(&self) -> &Bands;

    /// Advances this rank's parts of states, `[variable, own y, x]` each, all valid at the same time.
    ///
    /// # Errors
    /// As [`forecast`], for the first state that fails on any rank.
    fn forecast_parts(&self, parts: &mut [&mut [f64]], time: Option<Time>, steps: usize) -> Result<(), ForecastError>;

    /// Advances this rank's parts of increments, `[variable, own y, x]` one after another, along the trajectory from a whole state.
    ///
    /// # Errors
    /// [`ForecastError::OnRank`] if one is not finite at the end.
    fn forecast_tl_parts(&self, at: &State, parts: ColumnsMut<'_>, steps: usize) -> Result<(), ForecastError>;
}

/// A model with its tangent-linear: δx(t + Δt) = M'(x(t)) δx(t).
pub trait TangentLinear: Model {
    /// Advances increments by one time step of the model linearised at `at`.
    ///
    /// `columns` holds any number of increments one after another, each `[variable, y, x]`: a column-major matrix.
    fn step_tl(&self, at: &State, columns: &mut [f64]);

    /// Advances increments by `steps` time steps along the trajectory from `at`, to the same bits as by single steps.
    ///
    /// The default is [`TangentLinear::steps_tl_between`] with nothing done between the steps.
    fn steps_tl(&self, at: &State, columns: ColumnsMut<'_>, steps: usize) {
        self.steps_tl_between(at, columns, steps, &|_, _| ());
    }

    /// [`TangentLinear::steps_tl`] along a trajectory that something outside of the model changes between the steps, by what does
    /// not depend on the state, so that it has no part in the derivative: known sources.
    ///
    /// The default takes single steps, and advances columns in single precision in double, rounding them after the last step; a
    /// model overrides it if it is faster with all steps at once, or computes in single precision what is stored in it.
    fn steps_tl_between(&self, at: &State, columns: ColumnsMut<'_>, steps: usize, between: Between<'_>) {
        step_by_step(self, at, columns, steps, between);
    }

    /// Advances a state and increments by `steps` time steps, all together by each, before which their fields are exchanged: where
    /// others know what they are next. The bits are those of [`TangentLinear::steps_tl`] with one step after each exchange.
    ///
    /// A model overrides it if it need not arrange the increments anew for each step.
    fn steps_tl_exchanging(&self, at: &mut State, columns: ColumnsMut<'_>, steps: usize, exchange: Exchange<'_>) {
        step_by_step_exchanging(self, at, columns, steps, exchange);
    }
}

/// Changes fields before a step: those of the state and of increments, `[y, x]` each, or `[y, x, lane]` of several increments.
pub type Exchange<'a> = &'a mut dyn FnMut(&mut [ColumnsMut<'_>]);

/// Changes the values of a trajectory's state after a step, given the number of the step, from one, and the values.
pub type Between<'a> = &'a (dyn Fn(usize, &mut [f64]) + Sync);

/// A model with the adjoint of its tangent-linear: δx*(t) = M'(x(t))ᵀ δx*(t + Δt).
pub trait Adjoint: TangentLinear {
    /// Takes adjoint increments back by one time step of the model linearised at `at`; `columns` as in
    /// [`TangentLinear::step_tl`].
    fn step_ad(&self, at: &State, columns: &mut [f64]);

    /// Takes adjoint increments back by one time step from each of the states, from the last to the first, to the same bits as
    /// by single steps.
    ///
    /// The default takes single steps; a model overrides it if it is faster with all steps at once.
    fn steps_ad(&self, states: &[State], columns: &mut [f64]) {
        step_by_step_ad(self, states, columns);
    }
}

/// Why a forecast ended early.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ForecastError {
    /// The initial state is invalid.
    #[error("the forecast cannot start: {0}")]
    Start(#[from] ModelError),
    /// The state left the finite numbers.
    #[error(
        "the forecast is not finite after step {step}: {place} is {value} (CFL number of the step before: {})",
        if *cfl < 1e6 { format!("{cfl:.2}") } else { format!("{cfl:.2e}") }
    )]
    NotFinite {
        /// Steps of the time scheme done since the forecast began.
        step: usize,
        /// Variable, row and column.
        place: String,
        /// The value there.
        value: f64,
        /// Time step over the largest stable one, at the last finite state.
        cfl: f64,
    },
    /// What ranks do together failed on one of them.
    #[error("{0}")]
    OnRank(RankFailure),
    /// An increment left the finite numbers.
    #[error("the tangent-linear forecast is not finite after step {step}: increment {column}, {place}")]
    IncrementNotFinite {
        /// Steps done since the forecast began.
        step: usize,
        /// Which of the increments.
        column: usize,
        /// Variable, row and column.
        place: String,
    },
}

/// Advances `x` by `steps` time steps.
///
/// # Errors
/// [`ForecastError::Start`] if the initial state does not pass [`Model::check_state`] or lacks the time that the model needs, and
/// [`ForecastError::NotFinite`] at the first step after which a value is not finite.
pub fn forecast(model: &dyn Model, x: &mut State, steps: usize) -> Result<(), ForecastError> {
    forecast_together(model, std::slice::from_mut(x), steps)
}

/// Of how many states a thread advances together: as many as [`Model::best_together`] says, unless a thread would have none.
pub fn together(model: &dyn Model, states: usize) -> usize {
    let share = states.div_ceil(rayon::current_num_threads()).max(1);
    let groups = share.div_ceil(model.best_together().clamp(1, share));
    share.div_ceil(groups)
}

/// Advances several states by `steps` time steps each; fastest for as many at a time as [`Model::best_together`] says.
///
/// # Errors
/// As [`forecast`], for the first of the states that fails.
pub fn forecast_together(model: &dyn Model, states: &mut [State], steps: usize) -> Result<(), ForecastError> {
    states.iter().try_for_each(|x| check_start(model, x))?;
    let starts = states.to_vec();
    steps_checked(model, states, &starts, steps)
}

/// Advances `x` by `steps` time steps and, in lockstep along that trajectory, the increments in `columns`
/// (as in [`TangentLinear::step_tl`], in double or single precision); no trajectory is stored.
///
/// # Errors
/// [`ForecastError`] at the first step after which the state, or at the end an increment, is not finite.
pub fn forecast_tl<S: Stored>(
    model: &dyn TangentLinear,
    x: &mut State,
    columns: &mut [S],
    steps: usize,
) -> Result<(), ForecastError> {
    check_start(model, x)?;
    let at = x.clone();
    // The state's own forecast is as good as that of a further column, on whichever thread has time for it.
    let forecast = || steps_checked(model, std::slice::from_mut(x), std::slice::from_ref(&at), steps);
    rayon::join(|| model.steps_tl(&at, S::columns_mut(columns), steps), forecast).1?;
    require_finite_increments(model.layout(), columns, steps)
}

/// [`TangentLinear::steps_tl_between`] by single steps, up to the one after which the state is not finite.
pub(crate) fn step_by_step<M: TangentLinear + ?Sized>(
    model: &M,
    at: &State,
    columns: ColumnsMut<'_>,
    steps: usize,
    between: Between<'_>,
) {
    match columns {
        ColumnsMut::Double([]) => {}
        ColumnsMut::Double(columns) => along(model, at, steps, between, |at| model.step_tl(at, columns)),
        // Through copies in double precision, of as many columns at a time as all threads take.
        ColumnsMut::Single(columns) => {
            let group = f64::COLUMNS * rayon::current_num_threads() * model.layout().len().max(1);
            let mut copy = Vec::new();
            for group in columns.chunks_mut(group) {
                f32::in_double(group, &mut copy, |columns| {
                    model.steps_tl_between(at, ColumnsMut::Double(columns), steps, between);
                });
            }
        }
    }
}

/// [`TangentLinear::steps_tl_exchanging`] by single steps.
pub(crate) fn step_by_step_exchanging<M: TangentLinear + ?Sized>(
    model: &M,
    at: &mut State,
    mut columns: ColumnsMut<'_>,
    steps: usize,
    exchange: Exchange<'_>,
) {
    let cells = model.layout().grid.cells();
    for _ in 0..steps {
        let of_state = at.values_mut().chunks_exact_mut(cells).map(ColumnsMut::Double);
        exchange(&mut of_state.chain(columns.reborrow().fields(cells)).collect::<Vec<_>>());
        model.steps_tl(at, columns.reborrow(), 1);
        model.step(at);
    }
}

/// Calls `visit` with the state before each of the steps from `at`, up to one that is not finite.
pub(crate) fn along<M: Model + ?Sized>(
    model: &M,
    at: &State,
    steps: usize,
    between: Between<'_>,
    mut visit: impl FnMut(&State),
) {
    let mut at = at.clone();
    for step in 1..=steps {
        visit(&at);
        if step < steps {
            model.step(&mut at);
            between(step, at.values_mut());
            if at.first_non_finite().is_some() {
                return;
            }
        }
    }
}

/// [`Adjoint::steps_ad`] by single steps.
pub(crate) fn step_by_step_ad<M: Adjoint + ?Sized>(model: &M, states: &[State], columns: &mut [f64]) {
    states.iter().rev().for_each(|at| model.step_ad(at, columns));
}

/// Fails at the first value of the increments in `columns` (as in [`TangentLinear::step_tl`]) that is not finite.
///
/// # Errors
/// [`ForecastError::IncrementNotFinite`] with the number of `steps` done.
pub fn require_finite_increments<S: Stored>(layout: &Layout, columns: &[S], steps: usize) -> Result<(), ForecastError> {
    const CHUNK: usize = 8192;
    let bad = columns.par_chunks(CHUNK).position_first(|chunk| chunk.iter().any(|value| !value.widen().is_finite()));
    let Some(chunk) = bad else { return Ok(()) };
    let within = columns[chunk * CHUNK..].iter().position(|value| !value.widen().is_finite());
    let index = chunk * CHUNK + within.expect("the chunk has such a value");
    let place = layout.describe(index % layout.len());
    Err(ForecastError::IncrementNotFinite { step: steps, column: index / layout.len(), place })
}

/// The states at steps 0, 1, …, `steps` from `x`.
///
/// # Errors
/// As [`forecast`].
pub fn trajectory(model: &dyn Model, x: &State, steps: usize) -> Result<Vec<State>, ForecastError> {
    check_start(model, x)?;
    let mut states = Vec::with_capacity(steps + 1);
    states.push(x.clone());
    for step in 1..=steps {
        let mut next = states[step - 1].clone();
        model.step(&mut next);
        require_finite_step(model, &states[step - 1], &next, step)?;
        states.push(next);
    }
    Ok(states)
}

/// Takes adjoint increments back along a [`trajectory`], from its last state to its first.
pub fn backward_ad(model: &dyn Adjoint, trajectory: &[State], columns: &mut [f64]) {
    model.steps_ad(&trajectory[..trajectory.len().saturating_sub(1)], columns);
}

/// Fails if no forecast can start from a state.
fn check_start<M: Model + ?Sized>(model: &M, x: &State) -> Result<(), ModelError> {
    if model.needs_time() {
        x.require_time()?;
    }
    model.check_state(x)
}

/// Fails at the first value that is not finite.
pub(crate) fn require_finite_state(x: &State) -> Result<(), ModelError> {
    match x.first_non_finite() {
        None => Ok(()),
        Some(index) => Err(ModelError::NotFinite { place: x.layout().describe(index), value: x.values()[index] }),
    }
}

/// Advances states from their starts by `steps` time steps. What a step costs is its arithmetic: whether all went well is seen at
/// the end, and if not, at which step it did not is found by going the same way again.
fn steps_checked(model: &dyn Model, states: &mut [State], starts: &[State], steps: usize) -> Result<(), ForecastError> {
    model.steps(states, steps);
    for (x, start) in states.iter_mut().zip(starts) {
        if x.first_non_finite().is_none() {
            continue;
        }
        x.clone_from(start);
        for step in 1..=steps {
            let before = x.clone();
            model.step(x);
            require_finite_step(model, &before, x, step)?;
        }
    }
    Ok(())
}

/// Fails if the state after a step, which is counted from the beginning of the forecast, is not finite.
fn require_finite_step(model: &dyn Model, before: &State, after: &State, step: usize) -> Result<(), ForecastError> {
    match after.first_non_finite() {
        None => Ok(()),
        Some(index) => Err(ForecastError::NotFinite {
            step: step * model.substeps(),
            place: model.layout().describe(index),
            value: after.values()[index],
            cfl: model.time_step().as_f64() / model.substeps() as f64 / model.largest_time_step_s(before),
        }),
    }
}
