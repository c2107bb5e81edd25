//! The factors of a time volume: patterns of errors of observations or of the model.

use crate::kinds::initial::layout;
use crate::kinds::pattern::{PATTERN, Pattern};
use crate::kinds::{Domain, Kind, Kinds, choose};
use crate::reader::{Absent, AnyKey, Described, Field, Form, Key, Limits, Read, Section, Whole, fields};
use crate::text::clean;
use isobar_assim::Error;
use isobar_assim::time_volume::{AmplitudeEvolution, Factor, Target, TimeShape};
use isobar_model::{Duration, Location};
use isobar_obs::Calibration;

/// The most factors of a method, and the most amplitudes of a factor.
pub(super) const MOST: usize = 100;

/// A factor, before the biases that it acts on have numbers.
#[derive(Debug)]
pub(super) struct FactorSettings {
    name: String,
    acts_on: ActsOn,
    shape: TimeShape,
    /// How it depends on place: fields `[y, x]`; empty if it is the same everywhere.
    patterns: Vec<Vec<f64>>,
    evolution: AmplitudeEvolution,
}

#[derive(Debug)]
enum ActsOn {
    /// The biases with these names, or whose names begin with them up to a `/`.
    Biases(Vec<String>),
    /// The forecast of the variable of this number.
    Variable(usize),
}

const NAME: Key<Described> = Key::required("name", "", Described("a text", Form::text), "what the factor is called");

const BIASES: Key<Described> = Key::absent(
    "biases",
    "",
    Described("a list of names", Form::texts),
    Absent::Explained("it must be given for a factor of observations"),
    "the biases on which it acts, by their names or what these begin with up to a `/`",
);

const VARIABLE: Key<Described> = Key::absent(
    "variable",
    "",
    Described("a variable of the model", Form::text),
    Absent::Explained("it must be given for a factor of the model"),
    "the variable on whose forecast it acts",
);

const PATTERNS_FILE: Key<Described> = Key::absent(
    "patterns_file",
    "",
    Described("a CSV file with a column for each pattern and a row for each cell", Form::text),
    Absent::Explained("`pattern`"),
    "how it depends on place, with an amplitude for each pattern",
);

const SIGMA: Key<Limits> = Key::absent(
    "sigma",
    "of what it acts on",
    Limits::Positive,
    Absent::Explained("no prior"),
    "standard deviation of the amplitudes at the start",
);

const DRIFT: Key<Limits> = Key::absent(
    "drift_per_sqrt_day",
    "of what it acts on",
    Limits::NonNegative,
    Absent::Explained("no random walk"),
    "standard deviation over one day of the amplitudes' random walk",
);

const CORRELATION_HOURS: Key<Limits> = Key::absent(
    "correlation_hours",
    "hours",
    HOURS,
    Absent::Explained("no AR(1) process"),
    "correlation time of amplitudes that are an AR(1) process",
);

const HOURS: Limits = Limits::Between(0.01, 1e6);

const PERIOD_HOURS: Key<Limits> =
    Key::required("period_hours", "hours", HOURS, "period of a sinusoid, a square wave or hats");

const COUNT: Key<Whole> = Key::required("count", "", Whole(2, MOST), "number of hat functions in a period");

/// The keys of factors of every shape.
const COMMON: &[&dyn AnyKey] =
    &[&NAME, &BIASES, &VARIABLE, &PATTERN, &PATTERNS_FILE, &SIGMA, &DRIFT, &CORRELATION_HOURS];

/// How a factor depends on time.
pub(super) const SHAPES: &Kinds<TimeShape, Domain> = &[
    &Kind::new("constant", "The same at all times", &[COMMON], |_, _| Ok(Box::new(TimeShape::Constant))),
    &Kind::new("sinusoid", "Sine and cosine of a period", &[COMMON, &[&PERIOD_HOURS]], |section, _| {
        Ok(Box::new(TimeShape::Sinusoid { period: period(section)? }))
    }),
    &Kind::new(
        "square_wave",
        "One value in the first half of a period, another in the second",
        &[COMMON, &[&PERIOD_HOURS]],
        |section, _| Ok(Box::new(TimeShape::SquareWave { period: period(section)? })),
    ),
    &Kind::new(
        "hats",
        "Hat functions, equally spaced in a period",
        &[COMMON, &[&PERIOD_HOURS, &COUNT]],
        |section, _| Ok(Box::new(TimeShape::Hats { period: period(section)?, count: section.get(&COUNT)? })),
    ),
];

fn period(section: &Section<'_>) -> Read<Duration> {
    Ok(Duration::from_seconds((section.get(&PERIOD_HOURS)? * 3600.0).round() as i64))
}

/// Reads a factor: of the model if `of_model`, else of observations.
pub(super) fn read(field: &Field<'_>, of_model: bool, domain: &Domain) -> Read<FactorSettings> {
    let (kind, section) = choose(field, SHAPES, domain)?;
    let name = section.required(NAME.name)?.text()?;
    let (own, other) = if of_model { (&VARIABLE, &BIASES) } else { (&BIASES, &VARIABLE) };
    if let Some(misplaced) = section.optional(other.name) {
        let message = format!("`{}` does not belong to this factor", misplaced.title());
        return Err(misplaced.misplaced(message, &format!("it acts on `{}`", own.name)));
    }
    let target = section.required(own.name)?;
    let acts_on = if of_model { ActsOn::Variable(domain.variable(&target)?) } else { ActsOn::Biases(biases(&target)?) };
    let shape = *(kind.read)(&section, domain)?;
    let patterns = patterns(&section, &acts_on, domain)?;
    Ok(FactorSettings { name, acts_on, shape, patterns, evolution: evolution(&section)? })
}

/// How a factor depends on place: at the points of the variable on which it acts, or at the centres of cells.
fn patterns(section: &Section<'_>, acts_on: &ActsOn, domain: &Domain) -> Read<Vec<Vec<f64>>> {
    let location = match acts_on {
        ActsOn::Variable(number) => layout(domain).variables[*number].location,
        ActsOn::Biases(_) => Location::Center,
    };
    match (section.optional(PATTERN.name), section.optional(PATTERNS_FILE.name)) {
        (None, None) => Ok(Vec::new()),
        (Some(field), None) => Ok(vec![Pattern::read(&field, domain)?.values(&domain.grid, location)]),
        (None, Some(field)) => Ok(fields::read(&field, &domain.grid, MOST)?.columns),
        (Some(_), Some(field)) => {
            let message = format!("`{}` stands beside `pattern`", field.title());
            Err(field.misplaced(message, "make two factors, or put all patterns into the file"))
        }
    }
}

fn biases(field: &Field<'_>) -> Read<Vec<String>> {
    let names = field.texts(MOST)?;
    if names.is_empty() {
        return Err(field.invalid(format!("`{}` is empty", field.title()), "must name a bias at least"));
    }
    Ok(names)
}

fn evolution(section: &Section<'_>) -> Read<AmplitudeEvolution> {
    let sigma = section.find(&SIGMA)?;
    let needs_sigma = |key: &Key<Limits>| match sigma {
        Some(sigma) => Ok(sigma),
        None => {
            let field = section.required(key.name)?;
            let message = format!("amplitudes with `{}` need a prior", field.title());
            Err(field.misplaced(message, "give `sigma`, their standard deviation at the start, as well"))
        }
    };
    match (section.find(&DRIFT)?, section.find(&CORRELATION_HOURS)?) {
        (None, None) => Ok(AmplitudeEvolution::Constant { sigma_prior: sigma }),
        (Some(sigma_per_sqrt_day), None) => {
            Ok(AmplitudeEvolution::RandomWalk { sigma_prior: needs_sigma(&DRIFT)?, sigma_per_sqrt_day })
        }
        (None, Some(hours)) => {
            let correlation_time = Duration::from_seconds((3600.0 * hours).round() as i64);
            Ok(AmplitudeEvolution::FirstOrder { sigma: needs_sigma(&CORRELATION_HOURS)?, correlation_time })
        }
        (Some(_), Some(_)) => {
            let hours = section.required(CORRELATION_HOURS.name)?;
            let message = format!("`{}` stands beside `drift_per_sqrt_day`", hours.title());
            Err(hours.misplaced(message, "amplitudes are a random walk or an AR(1) process, not both"))
        }
    }
}

/// Refuses a factor with the name of one before it.
pub(super) fn check_name(factor: &FactorSettings, before: &[FactorSettings], field: &Field<'_>) -> Read<()> {
    if before.iter().any(|other| other.name == factor.name) {
        let message = format!("there are two factors `{}`", clean(&factor.name));
        return Err(field.invalid(message, "each needs a name of its own"));
    }
    Ok(())
}

impl FactorSettings {
    /// Whether it is one of observations that depends on place.
    pub(super) fn has_patterns_of_observations(&self) -> bool {
        matches!(self.acts_on, ActsOn::Biases(_)) && !self.patterns.is_empty()
    }

    /// The factor, with the biases that it acts on by number.
    ///
    /// # Errors
    /// [`Error::Setting`] if there is no such bias.
    pub fn resolve(&self, calibration: &Calibration) -> Result<Factor, Error> {
        let target = match &self.acts_on {
            ActsOn::Variable(number) => Target::Forecast(*number),
            ActsOn::Biases(names) => {
                let numbers = names.iter().map(|name| numbers(name, calibration));
                let mut numbers = numbers.collect::<Result<Vec<_>, _>>()?.concat();
                numbers.sort_unstable();
                numbers.dedup();
                Target::Observations(numbers)
            }
        };
        Ok(Factor {
            name: self.name.clone(),
            target,
            shape: self.shape,
            patterns: self.patterns.clone(),
            evolution: self.evolution,
        })
    }
}

/// The numbers of the biases with a name, or whose names begin with it up to a `/`.
fn numbers(name: &str, calibration: &Calibration) -> Result<Vec<usize>, Error> {
    let is_meant = |bias: &str| bias.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
    let all = calibration.parameters.iter().enumerate();
    let found: Vec<usize> = all.filter(|(_, bias)| is_meant(&bias.name)).map(|(number, _)| number).collect();
    if found.is_empty() {
        let names: Vec<&str> = calibration.parameters.iter().take(20).map(|bias| bias.name.as_str()).collect();
        let known = if names.is_empty() { "none".to_string() } else { names.join(", ") };
        return Err(Error::Setting(format!("there is no bias `{name}` for a factor to act on; there are: {known}")));
    }
    Ok(found)
}
