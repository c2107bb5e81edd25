//! `[[comparisons]]`: comparisons of sensors and test points within a run.

use crate::calendar::utc;
use crate::reader::{Absent, AnyKey, Described, Form, Key, Limits, Read, Section};
use crate::text::clean;
use isobar_model::{Duration, Time};

/// A comparison of two sensors, or a test point of one.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparisonSettings {
    /// The sensor: the name of a bias.
    pub sensor: String,
    /// That with which it is compared; `None`: a reference without bias.
    pub with: Option<String>,
    /// When. It counts in the analysis at the end of the cycle in which that is.
    pub time: Time,
    /// The difference that was found; `None`: the true one with a random error.
    pub value: Option<f64>,
    /// Standard deviation of its error, in the unit of the bias.
    pub sigma: f64,
}

const SENSOR: Key<Described> = Key::required(
    "sensor",
    "",
    Described("the name of a bias that methods estimate, as in \"sondes/h/A\"", Form::text),
    "the sensor",
);

const WITH: Key<Described> = Key::absent(
    "with",
    "",
    Described("the name of another bias", Form::text),
    Absent::Explained("a reference without bias: a test point"),
    "the sensor with which it is compared",
);

const TIME: Key<Described> = Key::required(
    "time",
    "",
    Described("a time such as \"2026-01-15T00:00:00Z\" within the run", || Form::Time),
    "when; it counts in the analysis at the end of that cycle",
);

const VALUE: Key<Limits> = Key::absent(
    "value",
    "of the bias",
    Limits::Any,
    Absent::Explained("the true difference with a random error, where the true biases are known"),
    "the bias of the sensor minus that of the other, as found",
);

const SIGMA: Key<Limits> =
    Key::required("sigma", "of the bias", Limits::Positive, "standard deviation of the error of that");

/// All keys.
pub(super) const KEYS: &[&dyn AnyKey] = &[&SENSOR, &WITH, &TIME, &VALUE, &SIGMA];

/// The most of a scenario.
const MOST: usize = 10_000;

/// The form of the list.
pub(super) fn form() -> Form {
    Form::list(Form::Table(KEYS))
}

/// Reads `[[comparisons]]` of a run from `start`; none if it is absent.
pub(super) fn read(
    root: &Section<'_>,
    start: Time,
    window: Duration,
    cycles: usize,
    has_truth: bool,
) -> Read<Vec<ComparisonSettings>> {
    let Some(field) = root.optional("comparisons") else { return Ok(Vec::new()) };
    let mut comparisons = Vec::new();
    for element in field.elements(MOST)? {
        let section = element.section_with(KEYS)?;
        let sensor = section.required(SENSOR.name)?.text()?;
        let with = section.optional(WITH.name).map(|field| Ok((field.text()?, field))).transpose()?;
        if let Some((other, field)) = with.as_ref().filter(|(other, _)| *other == sensor) {
            let message = format!("`{}` is \"{}\", the sensor itself", field.title(), clean(other));
            return Err(
                field.invalid(message, "another sensor; without this key it is a test point against a reference")
            );
        }
        let time_field = section.required(TIME.name)?;
        let (time, end) = (time_field.time()?, start + window * cycles);
        if time <= start || time > end {
            let [from, to] = [start, end].map(utc);
            let message = format!("`{}` is {}, outside of the run", time_field.title(), utc(time));
            return Err(time_field.invalid(message, &format!("after {from}, until {to}")));
        }
        let value = section.find(&VALUE)?;
        if value.is_none() && !has_truth {
            let message = format!(
                "`value` must be given in [{}]: there is no truth from which it could be made",
                section.title()
            );
            return Err(section.file.error(section.span.clone(), message, "`value` must be given here", None));
        }
        let sigma = section.get(&SIGMA)?;
        comparisons.push(ComparisonSettings { sensor, with: with.map(|(other, _)| other), time, value, sigma });
    }
    Ok(comparisons)
}
