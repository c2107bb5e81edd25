//! `kind = "file"`: observations made elsewhere.

use super::common::{ASSIMILATE, MOST_GROUPS, WITHHOLD, at_file, texts};
use super::{bias, correlation};
use crate::kinds::{Domain, Kind, Kinds, choose_by, forms};
use crate::reader::{
    Absent, AnyKey, Choice, Described, Field, Form, Key, Limits, Plane, Read, Section, Value, files, observations,
};
use isobar_model::Duration;
use isobar_obs::{
    ColumnPredictor, FurtherColumns, InstrumentSettings, ObservationFile, RecordedBias, RecordedScope,
    RecordedSettings, RecordedTimes, WindAxes,
};
use std::path::Path;

/// The most stations that a list may name.
const MOST_STATIONS: usize = 10_000;

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described(
        "a CSV file with a line for each observation: its time, place, variable, value and error; or, with a name that ends in \
         .nc, a netCDF file of version 3 or 4 with a variable for each such column, as `observations.nc` of a run",
        Form::text,
    ),
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

const ONLY_NETWORK: Key<Described> = Key::absent(
    "only_network",
    "",
    Described("a name in the column `network` of the file", Form::text),
    Absent::Explained("all observations of the file"),
    "the network whose observations are read, of a file that has those of several, as `observations.nc` of a run",
);

const TIME_TOLERANCE: Key<Limits> = Key::absent(
    "time_tolerance_minutes",
    "min",
    Limits::Between(0.0, 1e6),
    Absent::Means(0.0),
    "how long before or after the end of a cycle an observation may be valid that is used there",
);

/// When observations of a file are used.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Times {
    Analysis,
    Window,
}

const OBSERVATION_TIMES: Key<Choice<Times>> = Key::absent(
    "observation_times",
    "",
    Choice(&[("analysis", Times::Analysis), ("window", Times::Window)]),
    Absent::Means(Times::Analysis),
    "which observations are used: those that are valid at the end of a cycle, or all, at their times within it, after its start \
     and not after its end",
);

const WINDS: Key<Choice<WindAxes>> = Key::absent(
    "winds",
    "",
    Choice(&[("earth", WindAxes::Earth), ("grid", WindAxes::Grid)]),
    Absent::Explained("`earth` for places in latitude and longitude, else `grid`"),
    "axes of the components u and v: east and north, or x and y of the plane",
);

const GROUP_BY: Key<Described> = Key::absent(
    "group_by",
    "",
    Described("a column of the file", Form::text),
    Absent::Explained("`group`, where biases or `reference_groups` need it"),
    "the column by which stations form groups",
);

const REFERENCE_GROUPS: Key<Described> = Key::absent(
    "reference_groups",
    "",
    Described("a list of groups", Form::texts),
    Absent::Explained("none"),
    "groups without bias",
);

const REFERENCE_STATIONS: Key<Described> = Key::absent(
    "reference_stations",
    "",
    Described("a list of stations, by their `id`", Form::texts),
    Absent::Explained("none"),
    "stations without bias",
);

const BIAS: Key<Described> = Key::absent(
    "bias",
    "",
    Described("a list of tables", || Form::list(Form::Any(vec![Form::Kinds(TERM, forms(TERMS)), Form::Table(OFFSET)]))),
    Absent::Explained("no biases"),
    "biases to estimate, one for each station, each group or all, constant or proportional to the number in a column",
);

pub(super) const KIND: Kind<dyn InstrumentSettings, Domain> = Kind::new(
    "file",
    "Observations of a file, each in the cycle at whose end, or within which, it is valid",
    &[&[
        &FILE,
        &ASSIMILATE,
        &WITHHOLD,
        &VARIABLE,
        &SIGMA,
        &ONLY_NETWORK,
        &MISSING,
        &OBSERVATION_TIMES,
        &TIME_TOLERANCE,
        &WINDS,
        &GROUP_BY,
        &REFERENCE_GROUPS,
        &REFERENCE_STATIONS,
        &BIAS,
        &correlation::FILE,
    ]],
    |section, domain| {
        let file = section.required(FILE.name)?;
        let missing = section.optional(MISSING.name).map(|field| {
            field.elements(1000)?.iter().map(|marker| marker.number(Limits::Any)).collect::<Read<Vec<f64>>>()
        });
        let missing = missing.transpose()?;
        let biases = biases(section, domain)?;
        let reference_groups = texts(section, REFERENCE_GROUPS.name, MOST_GROUPS)?;
        let further = further_columns(section, &biases, &reference_groups)?;
        let names = domain.model.variables();
        let only = if names.len() == 1 { Some(0) } else { None };
        let given = section.optional(VARIABLE.name).map(|field| domain.variable(&field)).transpose()?;
        let variable = given.or(only).map(|number| names[number].0.to_string());
        let observations = if is_netcdf(&file.text()?) {
            let (projection, only) = (domain.projection.as_ref(), variable.as_deref());
            observations(&file, &Plane { projection, variables: names, only }, missing.as_deref(), further)?
        } else {
            let text = files::read(&file, "file of observations")?;
            ObservationFile::parse_with(&text, &file.text()?, missing.as_deref(), further)
                .map_err(|error| at_file(&file, &error))?
        };
        Ok(Box::new(RecordedSettings {
            observations,
            variable,
            sigma: section.find(&SIGMA)?,
            times: times(section)?,
            winds: section.find(&WINDS)?,
            reference_groups,
            reference_stations: texts(section, REFERENCE_STATIONS.name, MOST_STATIONS)?,
            biases,
        }))
    },
);

/// Which observations are used, and when.
fn times(section: &Section<'_>) -> Read<RecordedTimes> {
    let tolerance = section.optional(TIME_TOLERANCE.name);
    match (section.get(&OBSERVATION_TIMES)?, tolerance) {
        (Times::Window, Some(field)) => {
            let message = format!("`{}` has no effect: all observations are used at their times", field.title());
            Err(field.misplaced(message, "leave it out, or `observation_times = \"window\"`"))
        }
        (Times::Window, None) => Ok(RecordedTimes::Window),
        (Times::Analysis, _) => {
            let seconds = (section.get(&TIME_TOLERANCE)? * 60.0).round() as i64;
            Ok(RecordedTimes::End(Duration::from_seconds(seconds)))
        }
    }
}

/// Whether a file is netCDF, by its name.
fn is_netcdf(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("nc"))
}

/// The columns that biases, references and correlated errors need.
fn further_columns(
    section: &Section<'_>,
    biases: &[RecordedBias],
    reference_groups: &[String],
) -> Read<FurtherColumns> {
    let needs_groups = !reference_groups.is_empty() || biases.iter().any(|it| it.scope == RecordedScope::EachGroup);
    let group_by = match section.optional(GROUP_BY.name) {
        Some(field) if !needs_groups => {
            let message = format!("`{}` has no effect", field.title());
            return Err(
                field.misplaced(message, "groups are of `reference_groups`, and of a bias with `per = \"group\"`")
            );
        }
        Some(field) => Some(field.text()?),
        None => needs_groups.then(|| "group".to_string()),
    };
    let mut predictors: Vec<String> = Vec::new();
    for column in biases.iter().filter_map(|bias| bias.predictor.as_ref()).map(|predictor| &predictor.column) {
        if !predictors.contains(column) {
            predictors.push(column.clone());
        }
    }
    let network = section.optional(ONLY_NETWORK.name).map(|field| field.text()).transpose()?;
    Ok(FurtherColumns { group_by, report_by: correlation::report_by(section)?, network, predictors })
}

fn biases(section: &Section<'_>, domain: &Domain) -> Read<Vec<RecordedBias>> {
    let elements = section.optional(BIAS.name).map_or(Ok(Vec::new()), |field| field.elements(bias::MOST_BIASES))?;
    elements.iter().map(|element| one_bias(element, domain)).collect()
}

/// The key of a bias that says what it depends on.
const TERM: &str = "term";

const PER: Key<Choice<RecordedScope>> = Key::absent(
    "per",
    "",
    Choice(&[
        ("station", RecordedScope::EachStation),
        ("group", RecordedScope::EachGroup),
        ("all", RecordedScope::All),
    ]),
    Absent::Explained("\"all\" with a column; else it must be given"),
    "what has a bias of its own",
);

const BIASED: Key<Described> = Key::required(
    "variable",
    "",
    Described("a variable of the model", Form::text),
    "the variable whose observations are biased",
);

const COLUMN: Key<Described> = Key::required(
    "column",
    "",
    Described("a column of the file", Form::text),
    "the column to whose numbers the bias is proportional",
);

const MEAN: Key<Limits> =
    Key::required("mean", "of the column", Limits::Any, "the number at which there is no such bias");

const SCALE: Key<Limits> = Key::required(
    "scale",
    "of the column",
    Limits::Positive,
    "the change of the number over which the bias changes by its coefficient",
);

/// The keys of a bias that depends on nothing.
const OFFSET: &[&dyn AnyKey] = &[&PER, &BIASED, &bias::RECORDED_SIGMA, &bias::RECORDED_EVOLUTION];

/// Whether a bias depends on a column.
const TERMS: &Kinds<bool, ()> = &[
    &Kind::new("offset", "The same for all observations", &[OFFSET], |_, ()| Ok(Box::new(false))),
    &Kind::new(
        "column",
        "Proportional to (number in a column − mean) / scale",
        &[OFFSET, &[&COLUMN, &MEAN, &SCALE]],
        |_, ()| Ok(Box::new(true)),
    ),
];

fn one_bias(element: &Field<'_>, domain: &Domain) -> Read<RecordedBias> {
    let (has_column, section) = if element.any_section()?.optional(TERM).is_some() {
        let (term, section) = choose_by(TERM, element, TERMS, &())?;
        (*(term.read)(&section, &())?, section)
    } else {
        (false, element.section_with(OFFSET)?)
    };
    let predictor = has_column.then(|| {
        Read::Ok(ColumnPredictor {
            column: section.required(COLUMN.name)?.text()?,
            mean: section.get(&MEAN)?,
            scale: section.get(&SCALE)?,
        })
    });
    let scope = if has_column {
        section.find(&PER)?.unwrap_or(RecordedScope::All)
    } else {
        PER.allowed.read(&section.required(PER.name)?)?
    };
    let variable = domain.variable(&section.required(BIASED.name)?)?;
    Ok(RecordedBias {
        variable: domain.model.variables()[variable].0.to_string(),
        scope,
        predictor: predictor.transpose()?,
        process: bias::read_recorded(&section)?,
    })
}
