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

use super::{KIND, Kind, Kinds, choose};
use crate::reader::{Field, Read, Section};
use crate::text::listed;
use given::GivenModel;
use integration::TIME_STEP_S;
use isobar_model::{Adjoint, Duration, Forcing, Grid, ModelError};
use std::sync::Arc;
use toml::de::{DeTable, DeValue};

/// The kinds of models of shallow water.
const OF_WATER: &Kinds<dyn Equations, Grid> = &[&shallow_water::KIND, &linear_shallow_water::KIND];

/// The kinds of models of a tracer.
const OF_TRACER: &Kinds<dyn Equations, Grid> = &[&advection::KIND, &exact_shift::KIND];

/// All kinds of models.
pub(crate) const MODELS: &Kinds<dyn Equations, Grid> = &[OF_WATER[0], OF_WATER[1], OF_TRACER[0], OF_TRACER[1]];

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

    /// By how much a parameter that an assimilation may correct is greater than in another model of the same kind, at each cell,
    /// `[y, x]`; `None` if they are of different kinds, or have no such parameter.
    pub(crate) fn difference(&self, other: &Self, grid: &Grid, parameter: &str) -> Option<Vec<f64>> {
        let of = |model: &Self| model.equations.parameter_field(grid, parameter);
        let (own, others) = (of(self)?, of(other)?);
        (self.kind == other.kind).then(|| own.iter().zip(others).map(|(own, other)| own - other).collect())
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

/// The truth's model: `[model]` with single keys replaced by those of `overrides`. Where these have a `kind`, it is of that kind,
/// and inherits the keys that both kinds have; the variables must be the same. With a time scheme of its own it does not inherit
/// what belongs to that of `[model]`.
pub(crate) fn read_with_overrides(model: &Field<'_>, overrides: &Field<'_>, grid: &Grid) -> Read<Model> {
    let section = overrides.any_section()?;
    let (DeValue::Table(table), DeValue::Table(changes)) = (model.value.get_ref(), overrides.value.get_ref()) else {
        return read(model, grid);
    };
    let kind = section.optional(KIND).map(|kind| kind_of_truth(model, &kind)).transpose()?;
    let is_inherited = |name: &str| {
        kind.is_none_or(|kind| kind.keys().any(|key| key.name() == name))
            && !integration::of_scheme(name).is_some_and(|scheme| changes.contains_key(scheme))
    };
    let inherited = table.iter().filter(|(key, _)| is_inherited(key.get_ref()));
    let mut merged: DeTable<'_> = inherited.map(|(key, value)| (key.clone(), value.clone())).collect();
    for (key, value) in changes {
        // The key is removed first, so that messages point at the overriding one.
        merged.remove(key.get_ref().as_ref());
        merged.insert(key.clone(), value.clone());
    }
    let value = toml::Spanned::new(overrides.value.span(), DeValue::Table(merged));
    read(&Field { value: &value, ..overrides.clone() }, grid)
}

/// The kind that the truth's model is given, which must have the variables of `[model]`.
fn kind_of_truth(model: &Field<'_>, kind: &Field<'_>) -> Read<&'static Kind<dyn Equations, Grid>> {
    let of_truth = kind.choice(&MODELS.iter().map(|&kind| (kind.name, kind)).collect::<Vec<_>>())?;
    let of_methods = model.any_section()?.required(KIND)?.text()?;
    let holds = |kinds: &Kinds<dyn Equations, Grid>, name: &str| kinds.iter().any(|kind| kind.name == name);
    let same = if holds(OF_WATER, &of_methods) { OF_WATER } else { OF_TRACER };
    if holds(same, of_truth.name) {
        return Ok(of_truth);
    }
    let message = format!("a truth of kind {} has other variables than [model], of kind {of_methods}", of_truth.name);
    Err(kind.invalid(message, &format!("must be one of {}", listed(same.iter().map(|kind| kind.name)))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reader::{self, SourceFile};
    use isobar_model::Boundary;
    use std::path::Path;

    #[test]
    fn kinds_of_water_and_of_a_tracer_have_the_variables_that_their_lists_say() {
        let keys = "kind = \"KIND\"\ntime_step_s = 60\n";
        let model = |kind: &str, rest: &str| {
            let text = format!("[model]\n{}{rest}", keys.replace("KIND", kind));
            let file = SourceFile::new(Path::new("s.toml"), &text);
            let tree = reader::parse(&file, &text).unwrap();
            let field = Section::root(&file, &tree).required("model").unwrap();
            let grid = Grid { nx: 8, ny: 8, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
            read(&field, &grid).unwrap().variables().to_vec()
        };
        let rest = |kind: &str| match kind {
            "shallow_water" => "coriolis_per_s = 1e-4",
            "linear_shallow_water" => "coriolis_per_s = 1e-4\nmean_depth_m = 1000",
            "advection" => "wind = { kind = \"uniform\", u_m_per_s = 1 }",
            "exact_shift" => "columns_per_step = 1",
            other => panic!("{other} has no keys here"),
        };
        for (kinds, variables) in [(OF_WATER, water::VARIABLES), (OF_TRACER, advection::VARIABLES)] {
            for kind in kinds {
                assert_eq!(model(kind.name, rest(kind.name)), variables, "{}", kind.name);
            }
        }
    }
}
