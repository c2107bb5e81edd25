//! `[model]`: the equations and their time step.

mod advection;
mod equations;
mod exact_shift;
mod given;
mod integration;
mod linear_shallow_water;
mod parameter;
mod shallow_water;
mod water;

pub use equations::Equations;
pub use parameter::{BasicState, Parameter};
pub use water::Water;

use super::{Kinds, choose};
use crate::reader::{Field, Read, Section};
use given::GivenModel;
use integration::TIME_STEP_S;
use isobar_model::{Adjoint, Duration, Forcing, Grid, ModelError};
use std::sync::Arc;
use toml::de::{DeTable, DeValue};

/// All kinds of models.
pub(crate) const MODELS: &Kinds<dyn Equations, Grid> =
    &[&shallow_water::KIND, &linear_shallow_water::KIND, &advection::KIND, &exact_shift::KIND];

/// The forecast model.
#[derive(Clone, Debug)]
pub struct Model {
    /// What the scenario calls its kind.
    pub kind: &'static str,
    /// The time step.
    pub time_step: Duration,
    /// The equations.
    pub equations: Arc<dyn Equations>,
    /// Known sources beside them.
    pub forcing: Arc<Forcing>,
}

impl Model {
    /// A model that is made by code.
    pub(crate) fn given(model: Arc<dyn Adjoint>) -> Self {
        let (time_step, equations) = (model.time_step(), Arc::new(GivenModel::new(model)));
        Self { kind: "given by code", time_step, equations, forcing: Arc::default() }
    }

    /// The prognostic variables: name and unit, in the order in which a state holds them.
    pub fn variables(&self) -> &[(&'static str, &'static str)] {
        self.equations.variables()
    }

    /// Whether the model has a height that winds can balance.
    pub fn is_shallow_water(&self) -> bool {
        self.equations.water().is_some()
    }

    /// Whether there is a Coriolis force, without which nothing is in balance.
    pub fn is_rotating(&self) -> bool {
        self.equations.water().is_some_and(|water| water.parameters.coriolis_per_s != 0.0)
    }

    /// The model on a grid, for cycles of this length.
    ///
    /// # Errors
    /// If the grid, the parameters, the time step or the forcing do not fit.
    pub fn build(&self, grid: &Grid, cycle: Duration) -> Result<Arc<dyn Adjoint>, ModelError> {
        self.equations.build(grid, self.time_step, cycle, &self.forcing)
    }

    /// The same model with other parameters: each name with what is added to its value.
    pub fn corrected(&self, grid: &Grid, changes: &[(&str, f64)]) -> Self {
        let mut equations = self.equations.boxed_clone();
        for (parameter, value) in equations.parameters(grid) {
            *value += changes.iter().filter(|(name, _)| *name == parameter.name).map(|(_, change)| change).sum::<f64>();
        }
        Self { equations: equations.into(), ..self.clone() }
    }

    /// The model on a grid with cells `factor` times as wide, with the longest time step that divides the cycle and is not
    /// longer in proportion. It takes increments along the states of the finer one, and has no forcing of its own.
    ///
    /// # Errors
    /// Why there is no such model.
    pub fn build_coarser(&self, grid: &Grid, cycle: Duration, factor: usize) -> Result<Arc<dyn Adjoint>, String> {
        if !self.equations.has_other_resolutions() {
            return Err("an exact shift by whole cells, and a model that is given by code, have no coarser grid".into());
        }
        let Grid { nx, ny, dx_m, dy_m, boundary } = *grid;
        let width = factor as f64;
        let coarse = Grid { nx: nx / factor, ny: ny / factor, dx_m: width * dx_m, dy_m: width * dy_m, boundary };
        let (seconds, most) = (cycle.seconds(), cycle.seconds() / self.time_step.seconds());
        let steps = (most.div_euclid(factor as i64).max(1)..=most)
            .find(|&steps| steps * factor as i64 >= most && seconds % steps == 0)
            .expect("the cycle holds whole steps of the model");
        let time_step = Duration::from_seconds(seconds / steps);
        self.equations.build(&coarse, time_step, cycle, &Arc::default()).map_err(|error| error.to_string())
    }
}

/// Whether the file chooses the only model that needs no neighbours and may have a ring of points for its grid. This is
/// asked before the grid is read, and so before the model can be.
pub(crate) fn needs_neighbours(root: &Section<'_>) -> bool {
    let kind = root.optional("model").and_then(|field| field.any_section().ok()?.optional("kind"));
    kind.is_none_or(|kind| kind.value.get_ref().as_str() != Some(exact_shift::KIND.name))
}

/// Reads `[model]`.
pub(crate) fn read(field: &Field<'_>, grid: &Grid) -> Read<Model> {
    let (kind, section) = choose(field, MODELS, grid)?;
    let time_step = Duration::from_seconds(section.get(&TIME_STEP_S)?);
    Ok(Model { kind: kind.name, time_step, equations: (kind.read)(&section, grid)?.into(), forcing: Arc::default() })
}

/// The truth's model: `[model]` with single keys replaced by those of `overrides`.
pub(crate) fn read_with_overrides(model: &Field<'_>, overrides: &Field<'_>, grid: &Grid) -> Read<Model> {
    let (DeValue::Table(table), DeValue::Table(changes)) = (model.value.get_ref(), overrides.value.get_ref()) else {
        overrides.any_section()?;
        return read(model, grid);
    };
    if let Some(kind) = overrides.any_section()?.optional("kind") {
        let help = "truth.model replaces single keys of [model]; leave `kind` out";
        return Err(kind.misplaced("the truth must be of the model's kind".into(), help));
    }
    let mut merged: DeTable<'_> = table.clone();
    for (key, value) in changes {
        // The key is removed first, so that messages point at the overriding one.
        merged.remove(key.get_ref().as_ref());
        merged.insert(key.clone(), value.clone());
    }
    let value = toml::Spanned::new(overrides.value.span(), DeValue::Table(merged));
    read(&Field { value: &value, ..overrides.clone() }, grid)
}
