//! `[[warnings]]`: values beyond a threshold, of which forecasts ahead warn.

use super::{Domain, distinct_name, plain_name};
use crate::lead_times::LeadTimes;
use crate::reader::{Absent, AnyKey, Described, Field, Form, Key, Limits, Read, Section};
use crate::threshold_warning::{Area, Side, ThresholdWarning};
use toml::de::DeValue;

const NAME: Key<Described> = Key::required(
    "name",
    "",
    Described("1 to 40 letters, digits, underscores and hyphens", Form::text),
    "the name of the warning, in tables and files",
);

const VARIABLE: Key<Described> =
    Key::required("variable", "", Described("a variable of the model", Form::text), "the variable");

const ABOVE: Key<Limits> = Key::absent(
    "above",
    "of the variable",
    Limits::Any,
    Absent::Explained("`below` is given"),
    "the threshold above which the event lies",
);

const BELOW: Key<Limits> = Key::absent(
    "below",
    "of the variable",
    Limits::Any,
    Absent::Explained("`above` is given"),
    "the threshold below which the event lies",
);

const AT: Key<Described> = Key::absent(
    "at",
    "",
    Described(
        "\"anywhere\", a station as in \"sondes/02963\", or a table with `x_km` and `y_km`, two numbers for a place, two pairs \
         for a box",
        at_form,
    ),
    Absent::Explained("anywhere"),
    "where: the grid point nearest to a place, or any grid point of an area",
);

const PROBABILITY: Key<Limits> = Key::required(
    "probability",
    "1",
    Limits::Between(0.001, 0.999),
    "the probability of the event from which on the warning is issued",
);

const ANYWHERE: &str = "anywhere";

/// All keys.
pub(crate) const KEYS: &[&dyn AnyKey] = &[&NAME, &VARIABLE, &ABOVE, &BELOW, &AT, &PROBABILITY];

/// The most warnings of a scenario.
const MOST_WARNINGS: usize = 50;

/// The form of the list.
pub(crate) fn form() -> Form {
    Form::list(Form::Table(KEYS))
}

fn at_form() -> Form {
    let side = || Form::Any(vec![Form::Number(Limits::Any), Form::numbers()]);
    Form::Any(vec![Form::Text, Form::Entries(vec![("x_km", side()), ("y_km", side())])])
}

/// Reads `[[warnings]]`; none if it is absent.
pub(crate) fn read(root: &Section<'_>, domain: &Domain, forecast: Option<&LeadTimes>) -> Read<Vec<ThresholdWarning>> {
    let Some(field) = root.optional("warnings") else { return Ok(Vec::new()) };
    let mut warnings: Vec<ThresholdWarning> = Vec::new();
    for element in field.elements(MOST_WARNINGS)? {
        let section = element.section_with(KEYS)?;
        let name_field = section.required(NAME.name)?;
        let name = name_field.text()?;
        let others = warnings.iter().map(|other| other.name.as_str());
        plain_name(&name, "warning")
            .and_then(|()| distinct_name(&name, others, "warning"))
            .map_err(|(message, help)| name_field.invalid(message, help))?;
        let variable = domain.variable(&section.required(VARIABLE.name)?)?;
        let (side, threshold) = match (section.optional(ABOVE.name), section.optional(BELOW.name)) {
            (Some(above), None) => (Side::Above, above.number(Limits::Any)?),
            (None, Some(below)) => (Side::Below, below.number(Limits::Any)?),
            (Some(_), Some(below)) => {
                let message = format!("`{}` stands beside `above`", below.title());
                return Err(below.misplaced(message, "make two warnings, one above and one below"));
            }
            (None, None) => {
                let message = format!("a warning needs `above` or `below`, and [{}] has neither", section.title());
                return Err(section.file.error(section.span.clone(), message, "`above` must be given here", None));
            }
        };
        let at = section.optional(AT.name).map_or(Ok(Area::Anywhere), |field| area(&field, domain))?;
        let issued_from = section.get(&PROBABILITY)?;
        warnings.push(ThresholdWarning { name, variable, side, threshold, at, issued_from });
    }
    if forecast.is_none() && !warnings.is_empty() {
        let named = &warnings[0].name;
        let message = format!("there is no [forecast] that could warn of `{named}`: warnings are of forecasts ahead");
        return Err(field.misplaced(message, "add [forecast] with lead_hours, or leave out the warnings"));
    }
    Ok(warnings)
}

fn area(field: &Field<'_>, domain: &Domain) -> Read<Area> {
    if let DeValue::String(_) = field.value.get_ref() {
        let text = field.text()?;
        return match text.as_str() {
            ANYWHERE => Ok(Area::Anywhere),
            station if station.contains('/') => Ok(Area::Station(text)),
            _ => {
                let message = format!("`{}` cannot be \"{}\"", field.title(), crate::text::clean(&text));
                Err(field.invalid(message, &format!("must be {}", AT.allowed.0)))
            }
        };
    }
    let section = field.section(&["x_km", "y_km"])?;
    let (x, y) = (section.required("x_km")?, section.required("y_km")?);
    let grid = &domain.grid;
    let extents = [(&x, grid.width_m()), (&y, grid.height_m())];
    if [&x, &y].iter().all(|side| !matches!(side.value.get_ref(), DeValue::Array(_))) {
        let [x_m, y_m] = extents.map(|(side, extent_m)| inside(side, extent_m, false));
        return Ok(Area::Place { x_m: x_m?, y_m: y_m? });
    }
    let [x_m, y_m] = extents.map(|(side, extent_m)| ends(side, extent_m));
    Ok(Area::Box { x_m: x_m?, y_m: y_m? })
}

/// The ends of a side of a box \[m\].
fn ends(side: &Field<'_>, extent_m: f64) -> Read<[f64; 2]> {
    let wanted = "two numbers, the lesser first";
    let elements = side.elements(2)?;
    let [from, to] = &elements[..] else {
        return Err(
            side.invalid(format!("`{}` has {} numbers", side.title(), elements.len()), &format!("must be {wanted}"))
        );
    };
    let (from_m, to_m) = (inside(from, extent_m, true)?, inside(to, extent_m, true)?);
    if from_m >= to_m {
        let message = format!("`{}` goes from {} to {}", side.title(), from_m / 1e3, to_m / 1e3);
        return Err(side.invalid(message, &format!("must be {wanted}")));
    }
    Ok([from_m, to_m])
}

/// A coordinate \[m\] within the domain, whose end counts or not.
fn inside(field: &Field<'_>, extent_m: f64, with_end: bool) -> Read<f64> {
    let km = field.number(Limits::Any)?;
    let m = km * 1e3;
    let is_inside = (0.0..extent_m).contains(&m) || with_end && m == extent_m;
    if !is_inside {
        let extent_km = extent_m / 1e3;
        let message = format!("`{}` is {km}, outside of the domain, which is {extent_km} km long there", field.title());
        return Err(field.invalid(message, &format!("must be from 0 to {extent_km}")));
    }
    Ok(m)
}
