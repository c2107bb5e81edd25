//! Known sources: B u(t) of dx/dt = f(x) + B u(t), patterns in space times functions of time.

use crate::error::ModelError;
use crate::grid::{Boundary, Grid, Location};
use crate::state::Layout;
use crate::time::Time;
use crate::time_function::TimeFunction;
use crate::vector::axpy;
use std::ops::Range;

/// A source of one variable.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// The variable, by number.
    pub variable: usize,
    /// A column of B: what it adds where u is 1, `[y, x]`, in the variable's unit per second.
    pub pattern: Vec<f64>,
    /// u(t).
    pub function: TimeFunction,
}

/// All sources of a model; they do not depend on its state. Empty for an autonomous model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Forcing {
    /// The sources, which add up.
    pub sources: Vec<Source>,
}

impl Forcing {
    /// Whether there are no sources.
    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }

    /// Fails unless all sources fit states of a layout: a variable that is there, a finite value for each cell, none that flows
    /// through a wall, and a function of time.
    ///
    /// # Errors
    /// [`ModelError`] that says what is wrong.
    pub fn check(&self, layout: &Layout) -> Result<(), ModelError> {
        let grid = &layout.grid;
        for (number, Source { variable, pattern, function }) in self.sources.iter().enumerate() {
            let fault =
                |what: String| Err(ModelError::Source { reason: format!("source {number} of the forcing {what}") });
            let Some(variable) = layout.variables.get(*variable) else {
                return fault("acts on a variable that the model does not have".into());
            };
            if pattern.len() != grid.cells() {
                return fault(format!("has {} values, but the grid {} cells", pattern.len(), grid.cells()));
            }
            if let Some(value) = pattern.iter().find(|value| !value.is_finite()) {
                return fault(format!("has the value {value}"));
            }
            let has_wall = grid.boundary == Boundary::Channel && variable.location == Location::YFace;
            if has_wall && pattern[..grid.nx].iter().any(|value| *value != 0.0) {
                return fault(format!("acts on {} at the southern wall, where it is zero", variable.name));
            }
            function.check()?;
        }
        Ok(())
    }

    /// The sources on some rows of a grid, as [`Grid::take_rows`].
    pub(crate) fn in_rows(&self, grid: &Grid, rows: &Range<isize>) -> Self {
        let of_rows = |source: &Source| Source { pattern: grid.take_rows(rows, &source.pattern), ..source.clone() };
        Self { sources: self.sources.iter().map(of_rows).collect() }
    }

    /// x += factor ∫ B u dt from `from_s` to `to_s` seconds after a time, for values `[variable, y, x]`.
    pub(crate) fn add(&self, factor: f64, time: Time, span_s: [f64; 2], values: &mut [f64]) {
        for Source { variable, pattern, function } in &self.sources {
            let field = &mut values[variable * pattern.len()..][..pattern.len()];
            axpy(factor * function.integral(time, span_s), pattern, field);
        }
    }
}
