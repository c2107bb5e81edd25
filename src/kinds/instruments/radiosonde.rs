//! `kind = "radiosonde"`: stations that stay where they are.

use super::common::{COMMON, MOST_GROUPS, WITHHOLD, at_file, texts};
use super::{bias, correlation};
use crate::kinds::{Domain, Kind, Kinds, choose_by, forms};
use crate::reader::{Absent, AnyKey, Described, Field, Form, Key, Limits, Read, Section, Whole, files};
use isobar_obs::{
    BiasScope, InstrumentSettings, ObservedVariable, RadiosondeSettings, StationBias, StationFile, StationSource,
};

/// The most columns and rows of regular stations.
const MOST_COLUMNS: usize = 300;

/// The most random stations.
const MOST_STATIONS: usize = 100_000;

const STATIONS: Key<Described> = Key::required(
    "stations",
    "",
    Described("`{ file = \"…\" }`, `{ regular = [columns, rows] }` or `{ random = count }`", || Form::Table(PLACES)),
    "where the stations are",
);

const PLACES: &[&dyn AnyKey] = &[&FILE, &REGULAR, &RANDOM];

const OTHERWISE: &str = "the stations are given otherwise";

const FILE: Key<Described> =
    Key::absent("file", "", Described("a CSV file", Form::text), Absent::Explained(OTHERWISE), "a table of stations");

const REGULAR: Key<Described> = Key::absent(
    "regular",
    "1",
    Described("[columns, rows]", || Form::list(Form::Whole(1, MOST_COLUMNS as i64))),
    Absent::Explained(OTHERWISE),
    "numbers of columns and rows of stations at equal distances",
);

const RANDOM: Key<Whole> = Key::absent(
    "random",
    "1",
    Whole(1, MOST_STATIONS),
    Absent::Explained(OTHERWISE),
    "number of stations at random places",
);

const GROUP_BY: Key<Described> = Key::absent(
    "group_by",
    "",
    Described("a column of the station file", Form::text),
    Absent::Explained("all stations form one group, `all`"),
    "the column by which the stations of a file form groups",
);

const GROUPS: Key<Described> = Key::absent(
    "groups",
    "",
    Described("a list of names", Form::texts),
    Absent::Explained("all groups of a station file; of other stations one group, `all`"),
    "of a station file, the groups whose stations report; of other stations, the groups to which they belong in turn",
);

const REFERENCE_GROUPS: Key<Described> = Key::absent(
    "reference_groups",
    "",
    Described("a list of groups", Form::texts),
    Absent::Explained("none"),
    "groups without bias",
);

const EDGE_MARGIN_KM: Key<Limits> = Key::absent(
    "edge_margin_km",
    "km",
    Limits::Between(0.0, 1e5),
    Absent::Means(0.0),
    "stations nearer than this to the edges of the domain are left out",
);

const SIGMA_HEIGHT_M: Key<Limits> = Key::absent(
    "sigma_height_m",
    "m",
    Limits::Positive,
    Absent::Explained("no heights"),
    "standard deviation of the random error of heights `h`, which are observed",
);

const SIGMA_WIND_M_PER_S: Key<Limits> = Key::absent(
    "sigma_wind_m_per_s",
    "m/s",
    Limits::Positive,
    Absent::Explained("no winds"),
    "standard deviation of the random error of winds `u` and `v`, which are observed",
);

const OBSERVE: Key<Described> = Key::absent(
    "observe",
    "",
    Described("a table such as `{ tracer = 0.1 }`", Form::named_numbers),
    Absent::Explained("heights and winds only"),
    "standard deviation of the random error of any variables, in their units",
);

const BIAS: Key<Described> = Key::absent(
    "bias",
    "",
    Described("a list of tables", || Form::list(Form::Kinds(PER, forms(SCOPES)))),
    Absent::Explained("no biases"),
    "biases, one for each group or station",
);

/// The key of a bias that says of what it is one.
const PER: &str = "per";

const VARIABLE: Key<Described> = Key::required(
    "variable",
    "",
    Described("an observed variable", Form::text),
    "the variable whose observations are biased",
);

const SCOPES: &Kinds<BiasScope, ()> = &[
    &Kind::new("group", "One bias for all stations of a group", &[&[&VARIABLE], bias::KEYS], |_, ()| {
        Ok(Box::new(BiasScope::EachGroup))
    }),
    &Kind::new("station", "One bias for each station", &[&[&VARIABLE], bias::KEYS], |_, ()| {
        Ok(Box::new(BiasScope::EachStation))
    }),
];

pub(super) const KIND: Kind<dyn InstrumentSettings, Domain> = Kind::new(
    "radiosonde",
    "Stations that report variables where they are",
    &[
        &[
            &STATIONS,
            &GROUP_BY,
            &GROUPS,
            &REFERENCE_GROUPS,
            &EDGE_MARGIN_KM,
            &SIGMA_HEIGHT_M,
            &SIGMA_WIND_M_PER_S,
            &OBSERVE,
            &BIAS,
            &correlation::STATIONS,
            &WITHHOLD,
        ],
        COMMON,
    ],
    |section, domain| {
        let variables = variables(section, domain)?;
        let (groups, reference_groups) =
            (texts(section, GROUPS.name, MOST_GROUPS)?, texts(section, REFERENCE_GROUPS.name, MOST_GROUPS)?);
        let group_by = section.optional(GROUP_BY.name);
        let stations = match stations(&section.required(STATIONS.name)?)? {
            Stations::File(stations) => {
                let group_by = group_by.as_ref().map(Field::text).transpose()?;
                StationSource::File { stations, group_by, groups: groups.clone() }
            }
            _ if group_by.is_some() => {
                let field = section.required(GROUP_BY.name)?;
                return Err(
                    field.misplaced("only a station file has columns to group by".into(), "use `groups` instead")
                );
            }
            Stations::Regular { columns, rows } => StationSource::Regular { columns, rows, groups: groups.clone() },
            Stations::Random { count } => StationSource::Random { count, groups: groups.clone() },
        };
        if let Some(field) = section.optional(REFERENCE_GROUPS.name).filter(|_| group_by.is_none()) {
            let all = ["all".to_string()];
            let groups = if groups.is_empty() { all.as_slice() } else { &groups };
            let choices: Vec<(&str, ())> = groups.iter().map(|group| (group.as_str(), ())).collect();
            for element in field.elements(MOST_GROUPS)? {
                element.choice(&choices)?;
            }
        }
        Ok(Box::new(RadiosondeSettings {
            stations,
            reference_groups,
            edge_margin_m: section.get(&EDGE_MARGIN_KM)? * 1e3,
            biases: biases(section, &variables)?,
            variables,
        }))
    },
);

/// What the stations observe: `sigma_height_m` and `sigma_wind_m_per_s`, or `observe`.
fn variables(section: &Section<'_>, domain: &Domain) -> Read<Vec<ObservedVariable>> {
    let mut observed: Vec<ObservedVariable> = Vec::new();
    for (key, variables) in [(&SIGMA_HEIGHT_M, &["h"][..]), (&SIGMA_WIND_M_PER_S, &["u", "v"])] {
        let (Some(sigma), Some(field)) = (section.find(key)?, section.optional(key.name)) else { continue };
        if !domain.model.is_shallow_water() {
            let message = format!("`{}` does not fit the model, which has neither height nor wind", field.title());
            return Err(field.misplaced(message, "use `observe = { tracer = 0.1 }`"));
        }
        observed.extend(variables.iter().map(|name| ObservedVariable::new(name, sigma)));
    }
    if let Some(field) = section.optional(OBSERVE.name) {
        let names: Vec<&str> = domain.model.variables().iter().map(|variable| variable.0).collect();
        for (name, sigma) in field.section(&names)?.fields() {
            if observed.iter().any(|other| other.name == name) {
                let message = format!("`{name}` has its standard deviation already");
                return Err(sigma.misplaced(message, "give it here or by sigma_height_m and sigma_wind_m_per_s"));
            }
            observed.push(ObservedVariable::new(name, sigma.number(Limits::Positive)?));
        }
    }
    if observed.is_empty() {
        let keys = if domain.model.is_shallow_water() {
            "`sigma_height_m`, `sigma_wind_m_per_s` or both must be given here"
        } else {
            "`observe = { tracer = 0.1 }` must be given here"
        };
        let message = format!("[{}] observes nothing", section.title());
        return Err(section.file.error(section.span.clone(), message, keys, None));
    }
    Ok(observed)
}

/// The stations without their groups.
enum Stations {
    File(StationFile),
    Regular { columns: usize, rows: usize },
    Random { count: usize },
}

fn stations(field: &Field<'_>) -> Read<Stations> {
    let section = field.section_with(PLACES)?;
    let given: Vec<(&str, Field<'_>)> = section.fields().collect();
    match given.as_slice() {
        [("file", file)] => {
            let text = files::read(file, "station file")?;
            let stations = StationFile::parse(&text, &file.text()?).map_err(|error| at_file(file, &error))?;
            Ok(Stations::File(stations))
        }
        [("regular", regular)] => {
            let numbers = regular.elements(2)?;
            let [columns, rows] = numbers.as_slice() else {
                let message = format!("`{}` needs two numbers", regular.title());
                return Err(regular.invalid(message, "must be [columns, rows]"));
            };
            Ok(Stations::Regular { columns: columns.whole(1, MOST_COLUMNS)?, rows: rows.whole(1, MOST_COLUMNS)? })
        }
        [("random", random)] => Ok(Stations::Random { count: random.whole(1, MOST_STATIONS)? }),
        _ => {
            let message = format!("`{}` must have exactly one of `file`, `regular` and `random`", field.title());
            Err(field.invalid(message, "{ file = \"…\" }, { regular = [columns, rows] } or { random = count }"))
        }
    }
}

fn biases(section: &Section<'_>, observed: &[ObservedVariable]) -> Read<Vec<StationBias>> {
    let names: Vec<(&str, &str)> = observed.iter().map(|it| (it.name.as_str(), it.name.as_str())).collect();
    let mut biases: Vec<StationBias> = Vec::new();
    for element in section.optional(BIAS.name).map_or(Ok(Vec::new()), |field| field.elements(bias::MOST_BIASES))? {
        let (scope, section) = choose_by(PER, &element, SCOPES, &())?;
        let scope = *(scope.read)(&section, &())?;
        let variable = section.required(VARIABLE.name)?.choice(&names)?.to_string();
        biases.push(StationBias { variable, scope, process: bias::read(&section)? });
    }
    Ok(biases)
}
