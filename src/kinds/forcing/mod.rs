//! `[[forcing]]`: known sources of the model, and of the truth.

mod time_function;

use super::initial::layout;
use super::pattern::{PATTERN, Pattern};
use super::{Domain, form, read as read_kind};
use crate::reader::{Absent, AnyKey, Described, Field, Form, Key, Limits, Read, Section};
use isobar_model::{Boundary, Forcing, Location, Source, Time, TimeFunction};
use std::sync::Arc;
pub(crate) use time_function::FUNCTIONS;

const VARIABLE: Key<Described> =
    Key::required("variable", "", Described("a variable of the model", Form::text), "the variable that it changes");

const AMPLITUDE_PER_DAY: Key<Limits> = Key::required(
    "amplitude_per_day",
    "of the variable per day",
    Limits::Any,
    "what it would add in a day where pattern and function of time are 1; 0 for nothing",
);

const TIME: Key<Described> = Key::absent(
    "time",
    "",
    Described("a table whose `kind` says what it is", || form(FUNCTIONS)),
    Absent::Explained("the same at all times"),
    "how it depends on time",
);

/// The keys of a source.
const KEYS: &[&dyn AnyKey] = &[&VARIABLE, &AMPLITUDE_PER_DAY, &PATTERN, &TIME];

/// The most sources.
const MOST: usize = 100;

const SECONDS_PER_DAY: f64 = 86_400.0;

/// The form of the list.
pub(crate) fn form_of_list() -> Form {
    Form::list(Form::Table(KEYS))
}

/// Reads the list of this name in a section: the sources of a model; `None` if it is absent.
pub(crate) fn read(section: &Section<'_>, name: &str, domain: &Domain) -> Read<Option<Arc<Forcing>>> {
    let Some(field) = section.optional(name) else { return Ok(None) };
    let sources = field.elements(MOST)?.iter().map(|element| source(element, domain)).collect::<Read<Vec<_>>>()?;
    Ok(Some(Arc::new(Forcing { sources })))
}

fn source(element: &Field<'_>, domain: &Domain) -> Read<Source> {
    let section = element.section_with(KEYS)?;
    let variable = domain.variable(&section.required(VARIABLE.name)?)?;
    let amplitude_per_s = section.get(&AMPLITUDE_PER_DAY)? / SECONDS_PER_DAY;
    let field = section.optional(PATTERN.name);
    let pattern = field.as_ref().map_or(Ok(Pattern::Uniform), |field| Pattern::read(field, domain))?;
    let location = layout(domain).variables[variable].location;
    let mut values = pattern.values(&domain.grid, location);
    if domain.grid.boundary == Boundary::Channel && location == Location::YFace {
        // Nothing flows through the southern wall.
        let at_wall = &mut values[..domain.grid.nx];
        if let (Pattern::Given(_), Some(field)) = (&pattern, &field)
            && let Some(column) = at_wall.iter().position(|value| *value != 0.0)
        {
            let message = format!(
                "the pattern is {} in row {} of the numbers, at the southern wall",
                at_wall[column],
                column + 1
            );
            return Err(field.invalid(message, "must be 0 in the first nx rows"));
        }
        at_wall.fill(0.0);
    }
    values.iter_mut().for_each(|value| *value *= amplitude_per_s);
    let function = section.optional(TIME.name);
    let function = function.map_or(Ok(TimeFunction::Constant), |field| Ok(*read_kind(&field, FUNCTIONS, domain)?))?;
    Ok(Source { variable, pattern: values, function })
}

/// The first source that is not known from one time to another: its number, and from when to when it is.
pub(crate) fn unknown_between(forcing: &Forcing, from: Time, to: Time) -> Option<(usize, (Time, Time))> {
    let mut spans = forcing.sources.iter().enumerate().filter_map(|(number, own)| Some((number, own.function.span()?)));
    spans.find(|(_, span)| from < span.0 || span.1 < to)
}
