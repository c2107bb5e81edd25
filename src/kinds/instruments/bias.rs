//! `[[networks.NAME.bias]]`: how a bias truly behaves, and what methods may assume of it.

use crate::reader::{Field, Kind, Limits, Read, Section};
use isobar_obs::{AssumedDrift, BiasProcess, Evolution, InitialBias};

/// The keys of every bias, in the unit of the observed variable.
pub(super) const KEYS: [&str; 7] = [
    "sigma",
    "value",
    "evolution",
    "known",
    "assumed_sigma",
    "assumed_drift_per_sqrt_day",
    "assumed_correlation_hours",
];

/// The keys of a bias of observations that were made elsewhere, of whose true value nothing is known.
pub(super) const RECORDED_KEYS: [&str; 2] = ["sigma", "evolution"];

/// The most biases of a network.
pub(super) const MOST_BIASES: usize = 100;

/// Reads [`KEYS`].
pub(super) fn read(section: &Section<'_>) -> Read<BiasProcess> {
    let known = section.yes_or_no_or("known", false)?;
    let assumed_sigma_prior =
        section.optional("assumed_sigma").map(|field| field.number(Limits::Positive)).transpose()?;
    let initial = match (section.optional("sigma"), section.optional("value")) {
        (Some(sigma), None) => InitialBias::Drawn { sigma: sigma.number(Limits::Positive)? },
        (None, Some(value)) => {
            let number = value.number(Limits::Any)?;
            // What is no standard deviation that could be given.
            if number.abs() < 1e-18 && !known && assumed_sigma_prior.is_none() {
                let message = format!("methods cannot take their prior from a bias of {number:?}");
                return Err(value.invalid(message, "give `assumed_sigma` as well"));
            }
            InitialBias::Given { value: number }
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
    Ok(BiasProcess {
        initial,
        evolution: section
            .optional("evolution")
            .map_or(Ok(Evolution::Constant), |field| evolution_of(&field, EVOLUTIONS))?,
        assumed_sigma_prior,
        assumed_drift: assumed_drift(section)?,
        known,
    })
}

fn assumed_drift(section: &Section<'_>) -> Read<Option<AssumedDrift>> {
    let (walk, hours) = (section.optional("assumed_drift_per_sqrt_day"), section.optional("assumed_correlation_hours"));
    match (walk, hours) {
        (None, None) => Ok(None),
        (Some(field), None) => {
            Ok(Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day: field.number(Limits::NonNegative)? }))
        }
        (None, Some(field)) => Ok(Some(AssumedDrift::FirstOrder { correlation_hours: field.number(HOURS)? })),
        (Some(_), Some(hours)) => {
            let message = format!("`{}` stands beside `assumed_drift_per_sqrt_day`", hours.title());
            Err(hours.misplaced(message, "methods assume a random walk or an AR(1) process, not both"))
        }
    }
}

/// Correlation times.
const HOURS: Limits = Limits::Between(0.01, 1e6);

/// Reads [`RECORDED_KEYS`].
pub(super) fn read_recorded(section: &Section<'_>) -> Read<BiasProcess> {
    let evolution = section.optional("evolution").map(|field| evolution_of(&field, &EVOLUTIONS[..ASSUMED]));
    Ok(BiasProcess {
        evolution: evolution.transpose()?.unwrap_or(Evolution::Constant),
        ..BiasProcess::constant(section.number("sigma", Limits::Positive)?)
    })
}

type ReadEvolution = fn(&Section<'_>) -> Read<Evolution>;

/// How many of [`EVOLUTIONS`] methods may assume as well.
const ASSUMED: usize = 3;

const EVOLUTIONS: &[Kind<ReadEvolution>] = &[
    ("constant", |_| Ok(Evolution::Constant), &[]),
    (
        "random_walk",
        |section| {
            let sigma_per_sqrt_day = section.number("sigma_per_sqrt_day", Limits::Positive)?;
            Ok(Evolution::RandomWalk { sigma_per_sqrt_day })
        },
        &["sigma_per_sqrt_day"],
    ),
    (
        "ar1",
        |section| Ok(Evolution::FirstOrder { correlation_hours: section.number("correlation_hours", HOURS)? }),
        &["correlation_hours"],
    ),
    (
        "jump",
        |section| {
            let at_hours = section.number("at_hours", Limits::Between(0.0, 1e9))?;
            Ok(Evolution::Jump { at_hours, size: section.number("size", Limits::Any)? })
        },
        &["at_hours", "size"],
    ),
    (
        "sinusoid",
        |section| {
            Ok(Evolution::Sinusoid {
                amplitude: section.number("amplitude", Limits::Any)?,
                period_hours: section.number("period_hours", Limits::Between(0.01, 1e6))?,
                peak_hours: section.number_or("peak_hours", 0.0, Limits::Between(0.0, 1e6))?,
            })
        },
        &["amplitude", "period_hours", "peak_hours"],
    ),
];

fn evolution_of(field: &Field<'_>, kinds: &[Kind<ReadEvolution>]) -> Read<Evolution> {
    let (read, section) = field.section_of_kind(kinds)?;
    read(&section)
}
