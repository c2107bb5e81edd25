//! `kind = "file"`: observations made elsewhere.

use super::common::at_file;
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, AnyKey, Described, Key, Limits, Read, Section, files};
use isobar_obs::{InstrumentSettings, ObservationFile, RecordedSettings};

pub(super) struct FileKind;

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described("a CSV file with a line for each observation: its time, place, variable, value and error"),
    "the observations",
);

const VARIABLE: Key<Described> = Key::absent(
    "variable",
    "",
    Described("a variable of the model"),
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

impl Kind<dyn InstrumentSettings, Domain> for FileKind {
    fn name(&self) -> &'static str {
        "file"
    }

    fn about(&self) -> &'static str {
        "Observations of a file, each in the cycle at whose end it is valid"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        vec![&FILE, &VARIABLE, &SIGMA]
    }

    fn read(&self, section: &Section<'_>, domain: &Domain) -> Read<Box<dyn InstrumentSettings>> {
        let file = section.required(FILE.name)?;
        let text = files::read(&file, "file of observations")?;
        let observations = ObservationFile::parse(&text, &file.text()?).map_err(|error| at_file(&file, &error))?;
        let names = domain.model.variables();
        let only = if names.len() == 1 { Some(0) } else { None };
        let given = section.optional(VARIABLE.name).map(|field| domain.variable(&field)).transpose()?;
        let variable = given.or(only).map(|number| names[number].0.to_string());
        Ok(Box::new(RecordedSettings { observations, variable, sigma: section.find(&SIGMA)? }))
    }
}
