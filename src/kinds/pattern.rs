//! Patterns in space: what a forcing, or a factor of errors, is like from place to place.

use super::initial::{HILL, WAVE, hill, wave};
use super::{Domain, Kind, Kinds, form, read};
use crate::reader::{Absent, Described, Field, Form, Key, Read, fields};
use isobar_model::initial::{CosineWave, GaussianHill, cosine_wave, gaussian_hills};
use isobar_model::{Grid, Layout, Location, State, Variable};
use std::sync::Arc;

/// A pattern without a unit.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Pattern {
    /// 1.
    Uniform,
    /// A wave of amplitude 1.
    Wave(CosineWave),
    /// A hill of height 1.
    Hill(GaussianHill),
    /// The values of a file, `[y, x]`.
    Given(Vec<f64>),
}

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described(
        "a CSV file with one column and a row for each cell, row by row from the south, each from the west",
        Form::text,
    ),
    "the values",
);

/// All kinds of patterns.
pub(crate) const PATTERNS: &Kinds<Pattern, Domain> = &[
    &Kind::new("uniform", "The same everywhere", &[], |_, _| Ok(Box::new(Pattern::Uniform))),
    &Kind::new("cosine_wave", "A mean, and a cosine wave of amplitude 1", &[WAVE], |section, _| {
        Ok(Box::new(Pattern::Wave(wave(section, 1.0)?)))
    }),
    &Kind::new("gaussian_hill", "A Gaussian hill of height 1", &[HILL], |section, domain| {
        Ok(Box::new(Pattern::Hill(hill(section, &domain.grid, 1.0)?)))
    }),
    &Kind::new("file", "The values of a file", &[&[&FILE]], |section, domain| {
        let mut fields = fields::read(&section.required(FILE.name)?, &domain.grid, 1)?;
        Ok(Box::new(Pattern::Given(fields.columns.swap_remove(0))))
    }),
];

/// The key of a pattern.
pub(crate) const PATTERN: Key<Described> = Key::absent(
    "pattern",
    "",
    Described("a table whose `kind` says what it is", || form(PATTERNS)),
    Absent::Explained("the same everywhere"),
    "how it depends on place",
);

impl Pattern {
    /// Reads a pattern.
    pub fn read(field: &Field<'_>, domain: &Domain) -> Read<Self> {
        Ok(*read(field, PATTERNS, domain)?)
    }

    /// Its values at the points of a grid at these places in the cells, `[y, x]`.
    pub fn values(&self, grid: &Grid, location: Location) -> Vec<f64> {
        let variable = Variable { name: "pattern", long_name: "pattern", standard_name: None, unit: "1", location };
        let layout = Arc::new(Layout { grid: grid.clone(), variables: vec![variable] });
        let values = |state: State| state.values().to_vec();
        match self {
            Pattern::Uniform => vec![1.0; grid.cells()],
            Pattern::Wave(wave) => values(cosine_wave(&layout, wave).expect("the reader refuses what is not finite")),
            Pattern::Hill(hill) => {
                values(gaussian_hills(&layout, 0.0, &[*hill]).expect("the reader refuses a hill without a width"))
            }
            Pattern::Given(values) => values.clone(),
        }
    }
}
