//! `kind = "netcdf"`.

use super::state::{InitialState, Values, check_values, layout};
use crate::calendar::utc;
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, Described, Form, Key, Read, Section, StateFile};
use isobar_model::Layout;
use std::collections::BTreeMap;
use std::sync::Arc;

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described(
        "a netCDF file, of version 3 or 4, with a field on the grid for each of the model's variables",
        Form::text,
    ),
    "the state",
);

const TIME: Key<Described> = Key::absent(
    "time",
    "",
    Described("a time such as \"2026-01-15T00:00:00Z\"", || Form::Time),
    Absent::Explained("the only time of the file"),
    "the time of the state in the file",
);

/// The same key of a truth that is a series of states.
pub(crate) const TRUE_VARIABLES: Key<Described> = VARIABLES;

const VARIABLES: Key<Described> = Key::absent(
    "variables",
    "",
    Described("a table such as `{ h = \"z500\" }`", || Form::Named(&[], Box::new(Form::Text))),
    Absent::Explained("those of the same names, or of the same standard names by the CF conventions"),
    "names of the variables in the file by those of the model",
);

pub(super) const KIND: Kind<dyn InitialState, Domain> =
    Kind::new("netcdf", "The state of a netCDF file at a time", &[&[&FILE, &TIME, &VARIABLES]], |section, domain| {
        Ok(Box::new(Values(values(section, domain)?)))
    });

fn values(section: &Section<'_>, domain: &Domain) -> Read<Vec<f64>> {
    let field = section.required(FILE.name)?;
    let file = state_file(section, domain, layout(domain))?;
    let time_field = section.optional(TIME.name);
    let time = match (&time_field, file.times()) {
        (None, None | Some([_])) => None,
        (None, Some(times)) => {
            let message = format!(
                "the file has states at {} times, from {} to {}",
                times.len(),
                utc(times[0]),
                utc(times[times.len() - 1])
            );
            return Err(field.invalid(message, "give one of them by `time`"));
        }
        (Some(time), None) => {
            return Err(time.misplaced("the file does not say of what time its state is".into(), "leave out this key"));
        }
        (Some(time), Some(_)) => Some(time.time()?),
    };
    let place = time_field.as_ref().unwrap_or(&field);
    let fault = |problem: String| place.invalid(format!("`{}`: {problem}", place.title()), "cannot be used");
    let values = file.values(time).map_err(fault)?;
    check_values(&values, domain).map_err(|(message, allowed)| field.invalid(message, allowed))?;
    Ok(values)
}

/// The file that a section names, with the names of its variables.
pub(crate) fn state_file(section: &Section<'_>, domain: &Domain, layout: Arc<Layout>) -> Read<StateFile> {
    StateFile::open(&section.required(FILE.name)?, layout, &names(section, domain)?)
}

/// The names that variables have in the file.
fn names(section: &Section<'_>, domain: &Domain) -> Read<BTreeMap<String, String>> {
    let Some(field) = section.optional(VARIABLES.name) else { return Ok(BTreeMap::new()) };
    let own: Vec<&str> = domain.model.variables().iter().map(|variable| variable.0).collect();
    field.section(&own)?.fields().map(|(name, field)| Ok((name.to_string(), field.text()?))).collect()
}
