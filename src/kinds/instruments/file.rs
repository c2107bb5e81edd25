//! `kind = "file"`: observations made elsewhere.

use super::common::{ASSIMILATE, at_file};
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, Choice, Described, Form, Key, Limits, Read, files};
use isobar_model::Duration;
use isobar_obs::{InstrumentSettings, ObservationFile, RecordedSettings, WindAxes};

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described("a CSV file with a line for each observation: its time, place, variable, value and error", Form::text),
    "the observations",
);

const VARIABLE: Key<Described> = Key::absent(
    "variable",
    "",
    Described("a variable of the model", Form::text),
    Absent::Explained("as the file says, or the model's only variable"),
    "the observed variable, for a file without a column `variable`",
);

const SIGMA: Key<Limits> = Key::absent(
    "sigma",
    "of the variable",
    Limits::Positive,
    Absent::Explained("as the file says"),
    "standard deviation of the random error, for a file without a column `sigma`",
);

const MISSING: Key<Described> = Key::absent(
    "missing",
    "of the variable",
    Described("a list of numbers, such as [-9999]", Form::numbers),
    Absent::Explained("values that usually mark a missing one are refused"),
    "values that mark a missing one; rows with them are counted, and not used",
);

const TIME_TOLERANCE: Key<Limits> = Key::absent(
    "time_tolerance_minutes",
    "min",
    Limits::Between(0.0, 1e6),
    Absent::Means(0.0),
    "how long before or after the end of a cycle an observation may be valid that is used there",
);

const WINDS: Key<Choice<WindAxes>> = Key::absent(
    "winds",
    "",
    Choice(&[("earth", WindAxes::Earth), ("grid", WindAxes::Grid)]),
    Absent::Explained("`earth` for places in latitude and longitude, else `grid`"),
    "axes of the components u and v: east and north, or x and y of the plane",
);

pub(super) const KIND: Kind<dyn InstrumentSettings, Domain> = Kind::new(
    "file",
    "Observations of a file, each in the cycle at whose end it is valid",
    &[&[&FILE, &ASSIMILATE, &VARIABLE, &SIGMA, &MISSING, &TIME_TOLERANCE, &WINDS]],
    |section, domain| {
        let file = section.required(FILE.name)?;
        let text = files::read(&file, "file of observations")?;
        let missing = section.optional(MISSING.name).map(|field| {
            field.elements(1000)?.iter().map(|marker| marker.number(Limits::Any)).collect::<Read<Vec<f64>>>()
        });
        let missing = missing.transpose()?;
        let observations =
            ObservationFile::parse(&text, &file.text()?, missing.as_deref()).map_err(|error| at_file(&file, &error))?;
        let names = domain.model.variables();
        let only = if names.len() == 1 { Some(0) } else { None };
        let given = section.optional(VARIABLE.name).map(|field| domain.variable(&field)).transpose()?;
        let variable = given.or(only).map(|number| names[number].0.to_string());
        Ok(Box::new(RecordedSettings {
            observations,
            variable,
            sigma: section.find(&SIGMA)?,
            time_tolerance: Duration::from_seconds((section.get(&TIME_TOLERANCE)? * 60.0).round() as i64),
            winds: section.find(&WINDS)?,
        }))
    },
);
