//! `[[networks.NAME.bias]]`: the biases of an observing system.

use super::model::{ModelSettings, variable};
use crate::reader::{Field, Kind, Limits, Read, Section};

/// A bias, or one for each group or station.
#[derive(Clone, Debug, PartialEq)]
pub struct Bias<Pattern> {
    /// What it does to which observations.
    pub pattern: Pattern,
    /// Its true value at the start.
    pub initial: InitialBias,
    /// How its true value changes.
    pub evolution: BiasEvolution,
    /// Whether the bias is known, and so taken out of the data before any method sees them.
    pub known: bool,
    /// Standard deviation of the prior that methods assume; `None`: that of the truth, or the size of the given value.
    pub assumed_sigma: Option<f64>,
    /// Standard deviation over one day of the random walk that methods assume; `None`: that of the truth.
    pub assumed_drift_per_sqrt_day: Option<f64>,
}

/// The true value of a bias at the start, in the observed variable's unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitialBias {
    /// Drawn from N(0, σ²).
    Sigma(f64),
    /// Given.
    Value(f64),
}

/// How the true value of a bias changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BiasEvolution {
    /// Not at all.
    Constant,
    /// As a random walk.
    RandomWalk {
        /// Standard deviation of the change over one day, in the observed variable's unit.
        sigma_per_sqrt_day: f64,
    },
    /// By a jump at one time.
    Jump {
        /// Hours since the start.
        at_hours: f64,
        /// Size, in the observed variable's unit.
        size: f64,
    },
    /// As a sinusoid about its value at the start.
    Sinusoid {
        /// Amplitude, in the observed variable's unit.
        amplitude: f64,
        /// Period in hours.
        period_hours: f64,
        /// Hour of the largest value: of the day, in UTC, if the period is one.
        peak_hours: f64,
    },
}

/// Which radiosondes share a bias.
#[derive(Clone, Debug, PartialEq)]
pub struct RadiosondeBias {
    /// Whose reports have one value of the bias in common.
    pub per: BiasOwner,
    /// The biased variable.
    pub variable: String,
}

/// Who has a bias of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasOwner {
    /// Each group (country, sonde type).
    Group,
    /// Each station.
    Station,
}

/// The factor of a satellite bias, a function of the scan position s from −1 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanTerm {
    /// 1.
    Offset,
    /// s.
    Linear,
    /// A parabola in s.
    Quadratic,
}

/// What a satellite bias depends on.
#[derive(Clone, Debug, PartialEq)]
pub enum SatelliteBias {
    /// The scan position.
    Scan(ScanTerm),
    /// The state where the satellite looks.
    AirMass {
        /// The variable.
        variable: String,
        /// What is subtracted from it, in its unit.
        mean: f64,
        /// What it is then divided by, in its unit.
        scale: f64,
    },
}

const COMMON: [&str; 6] = ["sigma", "value", "evolution", "known", "assumed_sigma", "assumed_drift_per_sqrt_day"];

/// The biases of radiosondes that observe `observed`.
pub(super) fn read_radiosonde(field: Option<Field<'_>>, observed: &[String]) -> Read<Vec<Bias<RadiosondeBias>>> {
    let keys: Vec<&str> = ["per", "variable"].into_iter().chain(COMMON).collect();
    read(field, "per", |element| {
        let section = element.section(&keys)?;
        let names: Vec<(&str, &str)> = observed.iter().map(|name| (name.as_str(), name.as_str())).collect();
        let bias = RadiosondeBias {
            per: section.required("per")?.choice(&[("group", BiasOwner::Group), ("station", BiasOwner::Station)])?,
            variable: section.required("variable")?.choice(&names)?.to_string(),
        };
        Ok((bias, section))
    })
}

/// The biases of a satellite.
pub(super) fn read_satellite(field: Option<Field<'_>>, model: &ModelSettings) -> Read<Vec<Bias<SatelliteBias>>> {
    const AIR_MASS: [&str; 9] = {
        let [a, b, c, d, e, f] = COMMON;
        ["variable", "mean", "scale", a, b, c, d, e, f]
    };
    const TERMS: &[Kind<Option<ScanTerm>>] = &[
        ("offset", Some(ScanTerm::Offset), &COMMON),
        ("scan_linear", Some(ScanTerm::Linear), &COMMON),
        ("scan_quadratic", Some(ScanTerm::Quadratic), &COMMON),
        ("air_mass", None, &AIR_MASS),
    ];
    read(field, "term", |element| {
        let (term, section) = element.section_by("term", TERMS)?;
        let bias = match term {
            Some(term) => SatelliteBias::Scan(term),
            None => SatelliteBias::AirMass {
                variable: variable(&section.required("variable")?, model)?,
                mean: section.number("mean", Limits::Any)?,
                scale: section.number("scale", Limits::Positive)?,
            },
        };
        Ok((bias, section))
    })
}

/// Biases, of which two must not be the same in what `pattern` finds; `key` is where they say so.
fn read<'a, Pattern: PartialEq>(
    field: Option<Field<'a>>,
    key: &str,
    pattern: impl Fn(&Field<'a>) -> Read<(Pattern, Section<'a>)>,
) -> Read<Vec<Bias<Pattern>>> {
    let mut biases: Vec<Bias<Pattern>> = Vec::new();
    for element in field.map_or(Ok(Vec::new()), |field| field.elements(100))? {
        let (pattern, section) = pattern(&element)?;
        if biases.iter().any(|bias| bias.pattern == pattern) {
            let message = format!("[{}] is the same bias as one before it", section.title());
            return Err(section.required(key)?.invalid(message, "there is one such bias already"));
        }
        biases.push(bias(&section, pattern)?);
    }
    Ok(biases)
}

fn bias<Pattern>(section: &Section<'_>, pattern: Pattern) -> Read<Bias<Pattern>> {
    let known = section.yes_or_no_or("known", false)?;
    let assumed_sigma = section.optional("assumed_sigma").map(|field| field.number(Limits::Positive)).transpose()?;
    let initial = match (section.optional("sigma"), section.optional("value")) {
        (Some(sigma), None) => InitialBias::Sigma(sigma.number(Limits::Positive)?),
        (None, Some(value)) => {
            let number = value.number(Limits::Any)?;
            if number == 0.0 && !known && assumed_sigma.is_none() {
                let message = "methods cannot take their prior from a bias of 0".to_string();
                return Err(value.invalid(message, "give `assumed_sigma` as well"));
            }
            InitialBias::Value(number)
        }
        (Some(_), Some(value)) => {
            let message = format!("`{}` stands beside `sigma`", value.title());
            return Err(value.misplaced(message, "a bias is either drawn with `sigma` or given by `value`"));
        }
        (None, None) => {
            let message = format!("a bias needs `sigma` or `value`, and [{}] has neither", section.title());
            return Err(section.file.error(section.span.clone(), message, "`sigma` must be given here", None));
        }
    };
    Ok(Bias {
        pattern,
        initial,
        evolution: section.optional("evolution").map_or(Ok(BiasEvolution::Constant), |field| evolution(&field))?,
        known,
        assumed_sigma,
        assumed_drift_per_sqrt_day: section
            .optional("assumed_drift_per_sqrt_day")
            .map(|field| field.number(Limits::NonNegative))
            .transpose()?,
    })
}

#[derive(Clone, Copy)]
enum Change {
    None,
    Walk,
    Jump,
    Sinusoid,
}

fn evolution(field: &Field<'_>) -> Read<BiasEvolution> {
    const KINDS: &[Kind<Change>] = &[
        ("constant", Change::None, &[]),
        ("random_walk", Change::Walk, &["sigma_per_sqrt_day"]),
        ("jump", Change::Jump, &["at_hours", "size"]),
        ("sinusoid", Change::Sinusoid, &["amplitude", "period_hours", "peak_hours"]),
    ];
    let (kind, section) = field.section_of_kind(KINDS)?;
    Ok(match kind {
        Change::None => BiasEvolution::Constant,
        Change::Walk => {
            BiasEvolution::RandomWalk { sigma_per_sqrt_day: section.number("sigma_per_sqrt_day", Limits::Positive)? }
        }
        Change::Jump => BiasEvolution::Jump {
            at_hours: section.number("at_hours", Limits::Between(0.0, 1e9))?,
            size: section.number("size", Limits::Any)?,
        },
        Change::Sinusoid => BiasEvolution::Sinusoid {
            amplitude: section.number("amplitude", Limits::Any)?,
            period_hours: section.number("period_hours", Limits::Between(0.01, 1e6))?,
            peak_hours: section.number_or("peak_hours", 0.0, Limits::Between(0.0, 1e6))?,
        },
    })
}
