//! A model that several ranks integrate together.
//!
//! The equations are those of the whole: each rank has them on its rows with as many on either side as a step depends on
//! ([`Model::in_rows`]). These are received from the ranks that have them before each step, for all states and increments at once; a
//! sweep over rows computes of them what the later stages need, and no more. So every value has the bits that it has on one rank.

use super::{Bands, RowExchange};
use crate::communicator::{Communicator, RankFailure, all_succeed};
use crate::error::ModelError;
use crate::forecast::{self, Adjoint, ForecastError, InBands, Model, TangentLinear};
use crate::state::{Layout, State};
use crate::stored::{ColumnsMut, Stored};
use crate::time::{Duration, Time};
use rayon::prelude::*;
use std::sync::Arc;

/// Columns whose rows travel in one message: many for few messages, few for the memory that they take with the rows beside them.
const TOGETHER: usize = 32;

/// A model that several ranks integrate together.
///
/// What has a whole state is given and gives it on all ranks: [`Model::step`] and [`Model::steps`] are collective, and return the same
/// on each. Increments and adjoint increments of whole columns are advanced by each rank for itself. Of what is too large for one
/// rank each has its part, which [`InBands::forecast_parts`] and [`InBands::forecast_tl_parts`] advance.
pub struct BandedModel {
    whole: Arc<dyn Adjoint>,
    local: Arc<dyn Adjoint>,
    bands: Bands,
    exchange: RowExchange,
}

impl BandedModel {
    /// The same model, integrated by the ranks of a communicator together.
    ///
    /// # Errors
    /// [`ModelError::Bands`] if the model has no form on some rows, or there are more ranks than rows.
    pub fn new(whole: Arc<dyn Adjoint>, communicator: Arc<dyn Communicator>) -> Result<Self, ModelError> {
        let grid = &whole.layout().grid;
        if communicator.ranks() > grid.ny {
            let reason = format!("{} ranks cannot share the {} rows of the grid", communicator.ranks(), grid.ny);
            return Err(ModelError::Bands { reason });
        }
        let bands = Bands::new(grid, communicator);
        let exchange = RowExchange::new(&bands, whole.reach());
        let local = whole.in_rows(exchange.rows()).ok_or_else(|| ModelError::Bands {
            reason: "this model cannot be integrated by several ranks: it has no form on some rows of its grid".into(),
        })?;
        Ok(Self { whole, local, bands, exchange })
    }

    /// [`InBands::forecast_tl_parts`] in the precision of the increments.
    fn forecast_tl_in<S: Stored>(&self, at: &State, parts: &mut [S], steps: usize) -> Result<(), ForecastError> {
        let (own_len, layout) = (self.own_len(), self.local.layout());
        let own_state = self.bands.own_part(at.values());
        for parts in parts.chunks_mut(TOGETHER * own_len) {
            let mut at = self.widened(&own_state, at.time());
            let mut wide = vec![S::default(); parts.len() / own_len * layout.len()];
            for (wide, part) in wide.chunks_exact_mut(layout.len()).zip(parts.chunks_exact(own_len)) {
                self.exchange.widen(part, wide);
            }
            let mut exchange = |fields: &mut [ColumnsMut<'_>]| self.exchange.fill(&self.bands, fields);
            self.local.steps_tl_exchanging(&mut at, S::columns_mut(&mut wide), steps, &mut exchange);
            for (wide, part) in wide.chunks_exact(layout.len()).zip(parts.chunks_exact_mut(own_len)) {
                self.exchange.narrow(wide, part);
            }
            let bad = parts.iter().position(|value| !value.widen().is_finite());
            let reason = |index: usize| format!("an increment is not finite: {}", self.describe(index % own_len));
            let own = bad.map_or(Ok(()), |index| Err(reason(index)));
            all_succeed(self.bands.communicator(), own).map_err(ForecastError::OnRank)?;
        }
        Ok(())
    }

    /// Values of this rank's part of a state.
    fn own_len(&self) -> usize {
        self.bands.own_cells().len() * self.whole.layout().variables.len()
    }

    /// A state on the rank's rows and those beside them, with zeros there.
    fn widened(&self, part: &[f64], time: Option<Time>) -> State {
        let mut values = vec![0.0; self.local.layout().len()];
        self.exchange.widen(part, &mut values);
        State::from_values(self.local.layout(), values).valid_at(time)
    }

    /// The rank's part of such a state.
    fn own_values(&self, state: &State) -> Vec<f64> {
        let mut part = vec![0.0; self.own_len()];
        self.exchange.narrow(state.values(), &mut part);
        part
    }

    /// Receives the rows beside the rank's. Collective.
    fn fill(&self, states: &mut [State]) {
        let len = self.exchange.rows().len() * self.bands.grid().nx;
        let fields =
            states.iter_mut().flat_map(|state| state.values_mut().chunks_exact_mut(len)).map(ColumnsMut::Double);
        self.exchange.fill(&self.bands, &mut fields.collect::<Vec<_>>());
    }

    /// The place of a value of this rank's part in words, as in the whole.
    fn describe(&self, index: usize) -> String {
        let cells = self.bands.own_cells();
        let (variable, cell) = (index / cells.len(), index % cells.len());
        self.whole.layout().describe(variable * self.bands.grid().cells() + cells.start + cell)
    }

    /// Fails if a state is impossible on any rank. What has gone wrong is found by going the same way again from the whole of it.
    fn require_all(
        &self,
        bad: Option<usize>,
        parts: &[&mut [f64]],
        time: Option<Time>,
        steps: usize,
    ) -> Result<(), ForecastError> {
        let own = bad.map_or(parts.len(), |number| number) as f64;
        let of_ranks = self.bands.communicator().gather_all(&[own]);
        let first = of_ranks.iter().map(|of_rank| of_rank[0] as usize).min().unwrap_or(parts.len());
        let Some(part) = parts.get(first) else { return Ok(()) };
        let values = self.bands.gather(part.to_vec());
        let mut whole = State::from_values(self.whole.layout(), values).valid_at(time);
        forecast::forecast(&*self.whole, &mut whole, steps)?;
        let reason = "a state that is impossible in its band is possible as a whole".into();
        Err(ForecastError::OnRank(RankFailure { rank: 0, reason }))
    }
}

/// Advances each of several states by a step.
fn advance_each(model: &dyn Model, states: &mut [State]) {
    let together = forecast::together(model, states.len());
    states.par_chunks_mut(together).for_each(|states| model.steps(states, 1));
}

impl InBands for BandedModel {
    fn bands(&self) -> &Bands {
        &self.bands
    }

    fn forecast_parts(&self, parts: &mut [&mut [f64]], time: Option<Time>, steps: usize) -> Result<(), ForecastError> {
        for parts in parts.chunks_mut(TOGETHER) {
            let mut states: Vec<State> = parts.iter().map(|part| self.widened(part, time)).collect();
            self.fill(&mut states);
            let bad = states.iter().position(|state| self.local.check_state(state).is_err());
            self.require_all(bad, parts, time, steps)?;
            for step in 1..=steps {
                advance_each(&*self.local, &mut states);
                if step < steps {
                    self.fill(&mut states);
                }
            }
            let advanced: Vec<Vec<f64>> = states.iter().map(|state| self.own_values(state)).collect();
            let is_finite = |values: &Vec<f64>| values.iter().all(|value| value.is_finite());
            self.require_all(advanced.iter().position(|values| !is_finite(values)), parts, time, steps)?;
            parts.iter_mut().zip(advanced).for_each(|(part, values)| part.copy_from_slice(&values));
        }
        Ok(())
    }

    fn forecast_tl_parts(&self, at: &State, parts: ColumnsMut<'_>, steps: usize) -> Result<(), ForecastError> {
        match parts {
            ColumnsMut::Double(parts) => self.forecast_tl_in(at, parts, steps),
            ColumnsMut::Single(parts) => self.forecast_tl_in(at, parts, steps),
        }
    }
}

impl Model for BandedModel {
    fn layout(&self) -> &Arc<Layout> {
        self.whole.layout()
    }

    fn time_step(&self) -> Duration {
        self.whole.time_step()
    }

    fn substeps(&self) -> usize {
        self.whole.substeps()
    }

    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.whole.largest_time_step_s(x)
    }

    fn in_bands(&self) -> Option<&dyn InBands> {
        Some(self)
    }

    fn needs_time(&self) -> bool {
        self.whole.needs_time()
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        self.whole.check_state(x)
    }

    fn step(&self, x: &mut State) {
        self.steps(std::slice::from_mut(x), 1);
    }

    fn best_together(&self) -> usize {
        self.whole.best_together()
    }

    /// Collective: each rank advances its rows, and all receive the whole.
    fn steps(&self, states: &mut [State], steps: usize) {
        let own = |state: &State| self.widened(&self.bands.own_part(state.values()), state.time());
        let mut local: Vec<State> = states.iter().map(own).collect();
        for _ in 0..steps {
            self.fill(&mut local);
            advance_each(&*self.local, &mut local);
        }
        let parts: Vec<f64> = local.iter().flat_map(|state| self.own_values(state)).collect();
        let whole = self.bands.gather(parts);
        for ((state, local), values) in states.iter_mut().zip(&local).zip(whole.chunks_exact(self.layout().len())) {
            *state = State::from_values(self.whole.layout(), values.to_vec()).valid_at(local.time());
        }
    }
}

impl TangentLinear for BandedModel {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        self.whole.step_tl(at, columns);
    }

    fn steps_tl_between(&self, at: &State, columns: ColumnsMut<'_>, steps: usize, between: forecast::Between<'_>) {
        self.whole.steps_tl_between(at, columns, steps, between);
    }
}

impl Adjoint for BandedModel {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        self.whole.step_ad(at, columns);
    }

    fn steps_ad(&self, states: &[State], columns: &mut [f64]) {
        self.whole.steps_ad(states, columns);
    }
}
