//! `[model]`: the equations and their time step.

mod advection;
mod exact_shift;
mod integration;
mod linear_shallow_water;
mod shallow_water;

pub use shallow_water::Water;

use super::{Kind, Kinds, choose};
use crate::reader::{Absent, Field, Integer, Key, Limits, Read, Section};
use isobar_model::{Adjoint, Boundary, Duration, Grid, ModelError};
use std::fmt::Debug;
use std::sync::Arc;
use toml::de::{DeTable, DeValue};

/// All kinds of models.
pub(crate) const MODELS: &Kinds<dyn Equations, Grid> = &[
    &shallow_water::ShallowWaterKind,
    &linear_shallow_water::LinearShallowWaterKind,
    &advection::AdvectionKind,
    &exact_shift::ExactShiftKind,
];

/// The forecast model.
#[derive(Clone, Debug)]
pub struct Model {
    /// What the scenario calls its kind.
    pub kind: &'static str,
    /// The time step.
    pub time_step: Duration,
    /// The equations.
    pub equations: Arc<dyn Equations>,
}

/// The equations of a model, with their parameters.
pub trait Equations: Debug + Send + Sync {
    /// The prognostic variables: name and unit, in the order in which a state holds them.
    fn variables(&self) -> &'static [(&'static str, &'static str)];

    /// The model on a grid, for cycles of this length.
    ///
    /// # Errors
    /// If the grid, the parameters or the time step do not fit.
    fn build(&self, grid: &Grid, time_step: Duration, cycle: Duration) -> Result<Arc<dyn Adjoint>, ModelError>;

    /// The same equations with the same parameters.
    fn boxed_clone(&self) -> Box<dyn Equations>;

    /// Whether forecasts are linear in the state.
    fn is_linear(&self) -> bool;

    /// Whether the equations can be solved on another grid than the scenario's.
    fn has_other_resolutions(&self) -> bool {
        true
    }

    /// The shallow-water equations that initial states and covariances are in balance with; `None` for a tracer.
    fn water(&self) -> Option<&Water> {
        None
    }

    /// The state about which shallow water is linearised, if it is.
    fn basic_state(&self) -> Option<BasicState> {
        None
    }

    /// The parameters that an assimilation may correct, each with its place in the equations.
    fn parameters(&mut self, _: &Grid) -> Vec<(Parameter, &mut f64)> {
        Vec::new()
    }
}

/// A uniform state about which equations are linearised.
#[derive(Clone, Copy, Debug)]
pub struct BasicState {
    /// Depth \[m\].
    pub mean_depth_m: f64,
    /// Eastward flow \[m/s\].
    pub u_m_per_s: f64,
    /// Northward flow \[m/s\].
    pub v_m_per_s: f64,
}

/// A parameter of a model that an assimilation may correct.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Its name, with the unit.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// A change that is small for any atmosphere, and large against the rounding of a forecast.
    pub step: f64,
}

const ADVECTION_X: Parameter = Parameter { name: "advection_x_m_per_s", unit: "m s-1", step: 0.1 };
const ADVECTION_Y: Parameter = Parameter { name: "advection_y_m_per_s", unit: "m s-1", step: 0.1 };

/// The components of a uniform flow as parameters; walls admit no northward one.
fn flow<'a>(u_m_per_s: &'a mut f64, v_m_per_s: &'a mut f64, grid: &Grid) -> Vec<(Parameter, &'a mut f64)> {
    let mut parameters = vec![(ADVECTION_X, u_m_per_s)];
    if grid.boundary == Boundary::Periodic {
        parameters.push((ADVECTION_Y, v_m_per_s));
    }
    parameters
}

impl Model {
    /// The prognostic variables: name and unit, in the order in which a state holds them.
    pub fn variables(&self) -> &'static [(&'static str, &'static str)] {
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
    /// If the grid, the parameters or the time step do not fit.
    pub fn build(&self, grid: &Grid, cycle: Duration) -> Result<Arc<dyn Adjoint>, ModelError> {
        self.equations.build(grid, self.time_step, cycle)
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
    /// longer in proportion.
    ///
    /// # Errors
    /// Why there is no such model.
    pub fn build_coarser(&self, grid: &Grid, cycle: Duration, factor: usize) -> Result<Arc<dyn Adjoint>, String> {
        if !self.equations.has_other_resolutions() {
            return Err("an exact shift by whole cells has no coarser grid".into());
        }
        let Grid { nx, ny, dx_m, dy_m, boundary } = *grid;
        let width = factor as f64;
        let coarse = Grid { nx: nx / factor, ny: ny / factor, dx_m: width * dx_m, dy_m: width * dy_m, boundary };
        let (seconds, most) = (cycle.seconds(), cycle.seconds() / self.time_step.seconds());
        let steps = (most.div_euclid(factor as i64).max(1)..=most)
            .find(|&steps| steps * factor as i64 >= most && seconds % steps == 0)
            .expect("the cycle holds whole steps of the model");
        let time_step = Duration::from_seconds(seconds / steps);
        self.equations.build(&coarse, time_step, cycle).map_err(|error| error.to_string())
    }
}

const TIME_STEP_S: Key<Integer> = Key::required("time_step_s", "s", Integer(1, 86_400), "time step");

const SPEED: Limits = Limits::Between(-300.0, 300.0);

/// The name of one of the model's variables.
pub(crate) fn variable(field: &Field<'_>, model: &Model) -> Read<String> {
    let names: Vec<(&str, &str)> = model.variables().iter().map(|&(name, _)| (name, name)).collect();
    Ok(field.choice(&names)?.to_string())
}

/// Whether the file chooses the only model that needs no neighbours and may have a ring of points for its grid. This is
/// asked before the grid is read, and so before the model can be.
pub(crate) fn needs_neighbours(root: &Section<'_>) -> bool {
    let kind = root.optional("model").and_then(|field| field.any_section().ok()?.optional("kind"));
    kind.is_none_or(|kind| kind.value.get_ref().as_str() != Some(exact_shift::ExactShiftKind.name()))
}

/// Reads `[model]`.
pub(crate) fn read(field: &Field<'_>, grid: &Grid) -> Read<Model> {
    let (kind, section) = choose(field, MODELS, grid)?;
    let time_step = Duration::from_seconds(section.get(&TIME_STEP_S)?);
    Ok(Model { kind: kind.name(), time_step, equations: kind.read(&section, grid)?.into() })
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

/// A uniform northward flow \[m/s\], which must be 0 where walls stand in its way.
fn northward(section: &Section<'_>, key: &Key<Limits>, grid: &Grid) -> Read<f64> {
    let speed = section.get(key)?;
    if grid.boundary == Boundary::Channel && speed != 0.0 {
        let message = "a uniform wind cannot blow through the walls of a channel".to_string();
        return Err(section.required(key.name)?.invalid(message, "must be 0, or grid.boundary = \"periodic\""));
    }
    Ok(speed)
}

/// A speed \[m/s\] that is 0 if it is not given.
const fn speed_or_zero(name: &'static str, meaning: &'static str) -> Key<Limits> {
    Key::absent(name, "m/s", SPEED, Absent::Means(0.0), meaning)
}
