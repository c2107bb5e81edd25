//! `[expected]`: the scores that a run of the scenario had when they were last accepted.

use crate::kinds::methods::Method;
use crate::kinds::models::Model;
use crate::reader::{Absent, Form, Key, Limits, Read, Section};
use crate::scores::expected::TOLERANCE_KEY;
use crate::scores::{Expected, SCORES, ScoreKind, Values};
use indexmap::IndexMap;

/// The tolerance of a scenario that gives none.
const DEFAULT_TOLERANCE: f64 = 1e-4;

const RELATIVE_TOLERANCE: Key<Limits> = Key::absent(
    TOLERANCE_KEY,
    "1",
    Limits::Between(1e-12, 1.0),
    Absent::Means(DEFAULT_TOLERANCE),
    "relative difference from an accepted score that is no change",
);

/// The form of `[expected]`: a table for each method, with the scores that `isobar regress` compares.
pub(super) fn form() -> Form {
    let number = || Form::Number(Limits::NonNegative);
    let score =
        |kind: &ScoreKind| (kind.name, if kind.per_variable { Form::Named(&[], Box::new(number())) } else { number() });
    let scores = SCORES.iter().filter(|kind| kind.regressed).map(score).collect();
    Form::Named(&[&RELATIVE_TOLERANCE], Box::new(Form::Entries(scores)))
}

/// Reads `[expected]`.
pub(super) fn read(root: &Section<'_>, methods: &IndexMap<String, Method>, model: &Model) -> Read<Expected> {
    let mut expected = Expected { relative_tolerance: DEFAULT_TOLERANCE, methods: IndexMap::new() };
    let Some(field) = root.optional("expected") else { return Ok(expected) };
    let keys: Vec<&str> = std::iter::once(TOLERANCE_KEY).chain(methods.keys().map(String::as_str)).collect();
    let section = field.section(&keys)?;
    let variables: Vec<&str> = model.variables().iter().map(|variable| variable.0).collect();
    let kinds = || SCORES.iter().filter(|kind| kind.regressed);
    let names: Vec<&str> = kinds().map(|kind| kind.name).collect();
    for (method, field) in section.fields() {
        if method == TOLERANCE_KEY {
            expected.relative_tolerance = field.number(RELATIVE_TOLERANCE.allowed)?;
            continue;
        }
        let section = field.section(&names)?;
        let mut values = Values::new();
        for kind in kinds() {
            let Some(field) = section.optional(kind.name) else { continue };
            if kind.per_variable {
                for (variable, field) in field.section(&variables)?.fields() {
                    values.insert(kind.key(variable), field.number(Limits::NonNegative)?);
                }
            } else {
                values.insert(kind.key(""), field.number(Limits::NonNegative)?);
            }
        }
        expected.methods.insert(method.to_string(), values);
    }
    Ok(expected)
}
