//! `kind = "file"`.

use super::state::InitialState;
use crate::kinds::{Domain, Kind};
use crate::reader::{Described, Field, Form, Key, Read, fields};
use crate::text::clean;
use isobar_model::{Boundary, ModelError, State, advection, shallow_water};

/// The most columns of a file of states.
const MOST_COLUMNS: usize = 100;

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described("a CSV file with a named column for each of the model's variables and a row for each cell", Form::text),
    "the state",
);

pub(super) const KIND: Kind<dyn InitialState, Domain> =
    Kind::new("file", "The values of a file", &[&[&FILE]], |section, domain| {
        Ok(Box::new(Values(values(&section.required(FILE.name)?, domain)?)))
    });

/// The values of a state, `[variable, y, x]`.
#[derive(Debug)]
struct Values(Vec<f64>);

impl InitialState for Values {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        let layout = if domain.model.is_shallow_water() { shallow_water::layout } else { advection::layout };
        Ok(State::from_values(&layout(domain.grid.clone()), self.0.clone()))
    }
}

/// The state of a file that has a column for each of the model's variables.
fn values(field: &Field<'_>, domain: &Domain) -> Read<Vec<f64>> {
    let Domain { grid, model } = domain;
    let variables = model.variables();
    let fields = fields::read(field, grid, MOST_COLUMNS)?;
    let names = fields.names.unwrap_or_default();
    let mut values = Vec::with_capacity(variables.len() * grid.cells());
    for &(name, _) in variables {
        let mut columns = names.iter().zip(&fields.columns).filter(|(column, _)| column.eq_ignore_ascii_case(name));
        match (columns.next(), columns.next()) {
            (Some((_, column)), None) => values.extend_from_slice(column),
            (found, _) => {
                let count = if found.is_some() { "two columns" } else { "no column" };
                let all: Vec<&str> = variables.iter().map(|variable| variable.0).collect();
                let message = format!("{} has {count} `{name}` in its header", clean(&field.text()?));
                return Err(field.invalid(message, &format!("needs the columns {}", all.join(", "))));
            }
        }
    }
    if model.is_shallow_water() {
        let (h, v) = (&values[..grid.cells()], &values[2 * grid.cells()..]);
        if let Some(cell) = h.iter().position(|depth| *depth <= 0.0) {
            let message = format!("the depth h is {} in row {} of the numbers", h[cell], cell + 1);
            return Err(field.invalid(message, "must be greater than 0 everywhere"));
        }
        if let (Boundary::Channel, Some(cell)) = (grid.boundary, v[..grid.nx].iter().position(|v| *v != 0.0)) {
            let message =
                format!("v is {} in row {} of the numbers, which lies on the southern wall", v[cell], cell + 1);
            return Err(field.invalid(message, "must be 0 in the first nx rows"));
        }
    }
    Ok(values)
}
