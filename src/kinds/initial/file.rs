//! `kind = "file"`.

use super::state::{InitialState, Values, check_values};
use crate::kinds::{Domain, Kind};
use crate::reader::{Described, Field, Form, Key, Read, fields};
use crate::text::clean;

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

/// The state of a file that has a column for each of the model's variables.
fn values(field: &Field<'_>, domain: &Domain) -> Read<Vec<f64>> {
    let Domain { grid, model, .. } = domain;
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
    check_values(&values, domain).map_err(|(message, allowed)| field.invalid(message, allowed))?;
    Ok(values)
}
