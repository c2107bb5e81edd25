//! The model state x: every variable's field in one contiguous array `[variable, y, x]`.

use crate::error::ModelError;
use crate::grid::{Boundary, Grid, Location};
use crate::increment::Increment;
use crate::time::{Duration, Time};
use crate::vector;
use ndarray::ArrayView2;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeSet;
use std::ops::{AddAssign, Sub};
use std::sync::{Arc, Mutex, PoisonError};

/// A prognostic variable: its names, its unit and its place in the cell.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Variable {
    /// Short name, as scenarios and files use it: `h`, `u`, `v`, `tracer`.
    pub name: &'static str,
    /// Meaning, in words.
    pub long_name: &'static str,
    /// CF standard name, where there is one.
    pub standard_name: Option<&'static str>,
    /// Unit, in UDUNITS spelling.
    pub unit: &'static str,
    /// Place in the cell.
    pub location: Location,
}

impl<'de> Deserialize<'de> for Variable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        struct Owned {
            name: String,
            long_name: String,
            standard_name: Option<String>,
            unit: String,
            location: Location,
        }
        let Owned { name, long_name, standard_name, unit, location } = Owned::deserialize(deserializer)?;
        Ok(Self {
            name: interned(name),
            long_name: interned(long_name),
            standard_name: standard_name.map(interned),
            unit: interned(unit),
            location,
        })
    }
}

/// The text as one that lives as long as the program, like those in the source: each different text is kept once.
fn interned(text: String) -> &'static str {
    static TEXTS: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut texts = TEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    match texts.get(text.as_str()) {
        Some(text) => text,
        None => {
            let text: &'static str = text.leak();
            texts.insert(text);
            text
        }
    }
}

/// Grid and variables: the meaning of each number of a [`State`] or an [`Increment`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Layout {
    /// The grid.
    pub grid: Grid,
    /// The variables, in the order in which their fields are stored.
    pub variables: Vec<Variable>,
}

impl Layout {
    /// One variable on a ring of points: a single row of cells that are 1 m wide.
    pub fn ring(points: usize, name: &'static str, unit: &'static str) -> Arc<Self> {
        let grid = Grid { nx: points, ny: 1, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let variable = Variable { name, long_name: name, standard_name: None, unit, location: Location::Center };
        Arc::new(Self { grid, variables: vec![variable] })
    }

    /// Number of values: variables × cells.
    pub fn len(&self) -> usize {
        self.variables.len() * self.grid.cells()
    }

    /// Whether there are no values at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The number of the variable of this name.
    pub fn variable(&self, name: &str) -> Option<usize> {
        self.variables.iter().position(|variable| variable.name == name)
    }

    /// Variable number, row and column of the value at `index`.
    pub fn place(&self, index: usize) -> (usize, usize, usize) {
        let cells = self.grid.cells();
        (index / cells, index % cells / self.grid.nx, index % self.grid.nx)
    }

    /// Bilinear interpolation of a variable to a point of the plane: (index in the state, weight); `None` outside of the domain.
    pub fn interpolation(&self, variable: usize, x_m: f64, y_m: f64) -> Option<Vec<(usize, f64)>> {
        let (grid, location) = (&self.grid, self.variables[variable].location);
        let entries = grid.stencil(location, x_m, y_m)?.entries.into_iter();
        Some(entries.map(|(index, weight)| (variable * grid.cells() + index, weight)).collect())
    }

    /// The value at `index` in words, for messages: `u at row 3, column 7`.
    pub fn describe(&self, index: usize) -> String {
        let (variable, row, column) = self.place(index);
        let name = self.variables[variable].name;
        // The second level of a two-level scheme has the same variables.
        let level = if self.variable(name) == Some(variable) { "" } else { " one time step earlier" };
        format!("{name}{level} at row {row}, column {column}")
    }
}

/// A model state x(t).
///
/// It may know its valid time t, and keeps it: whatever goes on from a state goes on from its time. That of an autonomous
/// model need not know it; a model with a forcing refuses to forecast from one that does not. A state made from values knows
/// none before [`State::valid_at`].
///
/// It is serialised with its layout, a few hundred bytes: a stored state is checked by comparing its layout with that of
/// the model. One whose number of values is not that of its layout cannot be deserialised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StoredState")]
pub struct State {
    layout: Arc<Layout>,
    values: Vec<f64>,
    time: Option<Time>,
}

/// A state as it is read, not yet checked.
#[derive(Deserialize)]
struct StoredState {
    layout: Arc<Layout>,
    values: Vec<f64>,
    time: Option<Time>,
}

/// Values on a layout as they are read, not yet checked.
#[derive(Deserialize)]
pub(crate) struct Values {
    layout: Arc<Layout>,
    values: Vec<f64>,
}

impl Values {
    /// The layout and the values.
    ///
    /// # Errors
    /// In words, if the number of values is not that of the layout.
    pub fn checked(self) -> Result<(Arc<Layout>, Vec<f64>), String> {
        let Grid { nx, ny, .. } = self.layout.grid;
        let expected = nx.checked_mul(ny).and_then(|cells| cells.checked_mul(self.layout.variables.len()));
        if expected != Some(self.values.len()) {
            let (values, variables) = (self.values.len(), self.layout.variables.len());
            return Err(format!("{values} values for {variables} variables on {nx} x {ny} cells"));
        }
        Ok((self.layout, self.values))
    }
}

impl TryFrom<StoredState> for State {
    type Error = String;
    fn try_from(StoredState { layout, values, time }: StoredState) -> Result<Self, String> {
        let (layout, values) = Values { layout, values }.checked()?;
        Ok(Self { layout, values, time })
    }
}

impl State {
    /// The state whose values are all zero.
    pub fn zeros(layout: &Arc<Layout>) -> Self {
        Self::from_values(layout, vec![0.0; layout.len()])
    }

    /// A state of the given values, `[variable, y, x]`.
    ///
    /// # Panics
    /// If the number of values is not that of the layout.
    pub fn from_values(layout: &Arc<Layout>, values: Vec<f64>) -> Self {
        assert_eq!(values.len(), layout.len(), "a state needs one value per variable and cell");
        Self { layout: Arc::clone(layout), values, time: None }
    }

    /// The same values, valid at a time, or at none that is known.
    pub fn valid_at(self, time: impl Into<Option<Time>>) -> Self {
        Self { time: time.into(), ..self }
    }

    /// The valid time, if it is known.
    pub fn time(&self) -> Option<Time> {
        self.time
    }

    /// The valid time.
    ///
    /// # Errors
    /// [`ModelError::NoTime`] if it is not known.
    pub fn require_time(&self) -> Result<Time, ModelError> {
        self.time.ok_or(ModelError::NoTime)
    }

    /// Moves the valid time on, if it is known. The values stay as they are: this is a part of what a model does in a step.
    pub fn advance(&mut self, span: Duration) {
        self.time = self.time.map(|time| time + span);
    }

    /// The meaning of the values.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// All values, `[variable, y, x]`.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// All values, `[variable, y, x]`.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// The field of one variable, `[y, x]`.
    pub fn field(&self, variable: usize) -> ArrayView2<'_, f64> {
        field(&self.layout, &self.values, variable)
    }

    /// The root mean square of a variable about its mean over the domain, in the variable's unit.
    pub fn variability(&self, variable: usize) -> f64 {
        let field = self.field(variable);
        let (sum, count) = (field.iter().sum::<f64>(), field.len() as f64);
        (field.iter().map(|value| (value - sum / count).powi(2)).sum::<f64>() / count).sqrt()
    }

    /// The values of one variable's field, row by row.
    pub fn field_mut(&mut self, variable: usize) -> &mut [f64] {
        let cells = self.layout.grid.cells();
        &mut self.values[variable * cells..(variable + 1) * cells]
    }

    /// Index of the first value that is not finite.
    pub fn first_non_finite(&self) -> Option<usize> {
        // Block by block without leaving early, which is several values at once.
        const BLOCK: usize = 1024;
        let finite = |block: &[f64]| block.iter().fold(true, |all, value| all & value.is_finite());
        let block = self.values.chunks(BLOCK).position(|block| !finite(block))?;
        self.values[block * BLOCK..].iter().position(|value| !value.is_finite()).map(|index| block * BLOCK + index)
    }
}

/// One variable's field `[y, x]` of an array `[variable, y, x]`.
pub(crate) fn field<'a>(layout: &Layout, values: &'a [f64], variable: usize) -> ArrayView2<'a, f64> {
    let (cells, shape) = (layout.grid.cells(), (layout.grid.ny, layout.grid.nx));
    ArrayView2::from_shape(shape, &values[variable * cells..(variable + 1) * cells])
        .expect("a field has ny × nx contiguous values")
}

impl AddAssign<&Increment> for State {
    fn add_assign(&mut self, increment: &Increment) {
        vector::add(&mut self.values, increment.values());
    }
}

impl Sub for &State {
    type Output = Increment;
    fn sub(self, other: &State) -> Increment {
        Increment::from_values(&self.layout, vector::difference(&self.values, &other.values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_that_is_read_has_a_value_for_each_variable_and_cell() {
        let grid = Grid { nx: 3, ny: 2, dx_m: 1.0, dy_m: 2.0, boundary: Boundary::Channel };
        let state = State::from_values(&crate::shallow_water::layout(grid), (0..18).map(f64::from).collect());
        let bytes = postcard::to_stdvec(&state).unwrap();
        assert_eq!(postcard::from_bytes::<State>(&bytes).unwrap(), state);
        let short = postcard::to_stdvec(&(state.layout(), &state.values()[1..], state.time())).unwrap();
        assert!(postcard::from_bytes::<State>(&short).is_err());
        let timed = state.valid_at(Time::from_seconds(7));
        assert_eq!(postcard::from_bytes::<State>(&postcard::to_stdvec(&timed).unwrap()).unwrap(), timed);
    }
}
