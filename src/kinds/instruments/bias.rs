//! `[[networks.NAME.bias]]`: how a bias truly behaves, and what methods may assume of it.

use crate::kinds::{Kind, Kinds, form, read as read_kind};
use crate::reader::{Absent, AnyKey, Described, Key, Limits, Read, Section, YesNo};
use isobar_obs::{BiasProcess, Evolution, InitialBias};

/// The unit of what is observed.
const OBSERVED: &str = "of the variable";

const SIGMA: Key<Limits> = Key::absent(
    "sigma",
    OBSERVED,
    Limits::Positive,
    Absent::Explained("`value` is given"),
    "standard deviation from which the bias is drawn",
);

const VALUE: Key<Limits> =
    Key::absent("value", OBSERVED, Limits::Any, Absent::Explained("`sigma` is given"), "the bias at the start");

const EVOLUTION: Key<Described> = Key::absent(
    "evolution",
    "",
    Described("a table of kind \"constant\", \"random_walk\", \"jump\" or \"sinusoid\"", || form(EVOLUTIONS)),
    Absent::Explained("it is constant"),
    "how the bias truly changes",
);

const KNOWN: Key<YesNo> =
    Key::absent("known", "", YesNo, Absent::Means(false), "whether methods know the bias, and do not estimate it");

const ASSUMED_SIGMA: Key<Limits> = Key::absent(
    "assumed_sigma",
    OBSERVED,
    Limits::Positive,
    Absent::Explained("`sigma`, or the size of `value`"),
    "standard deviation of the prior that methods assume",
);

const ASSUMED_DRIFT: Key<Limits> = Key::absent(
    "assumed_drift_per_sqrt_day",
    OBSERVED,
    Limits::NonNegative,
    Absent::Explained("that of a random walk, else 0"),
    "standard deviation over one day of the random walk that methods assume",
);

/// The keys of every bias.
pub(super) const KEYS: &[&dyn AnyKey] = &[&SIGMA, &VALUE, &EVOLUTION, &KNOWN, &ASSUMED_SIGMA, &ASSUMED_DRIFT];

/// The most biases of a network.
pub(super) const MOST_BIASES: usize = 100;

/// Reads [`KEYS`].
pub(super) fn read(section: &Section<'_>) -> Read<BiasProcess> {
    let known = section.get(&KNOWN)?;
    let assumed_sigma_prior = section.find(&ASSUMED_SIGMA)?;
    let initial = match (section.optional(SIGMA.name), section.optional(VALUE.name)) {
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
    let evolution = section.optional(EVOLUTION.name);
    Ok(BiasProcess {
        initial,
        evolution: evolution.map_or(Ok(Evolution::Constant), |field| Ok(*read_kind(&field, EVOLUTIONS, &())?))?,
        assumed_sigma_prior,
        assumed_sigma_drift_per_sqrt_day: section.find(&ASSUMED_DRIFT)?,
        known,
    })
}

const SIGMA_PER_SQRT_DAY: Key<Limits> =
    Key::required("sigma_per_sqrt_day", OBSERVED, Limits::Positive, "standard deviation of its steps over one day");

const AT_HOURS: Key<Limits> =
    Key::required("at_hours", "h", Limits::Between(0.0, 1e9), "time of the jump, from the start of the scenario");

const SIZE: Key<Limits> = Key::required("size", OBSERVED, Limits::Any, "height of the jump");

const AMPLITUDE: Key<Limits> = Key::required("amplitude", OBSERVED, Limits::Any, "amplitude");

const PERIOD_HOURS: Key<Limits> = Key::required("period_hours", "h", Limits::Between(0.01, 1e6), "period");

const PEAK_HOURS: Key<Limits> =
    Key::absent("peak_hours", "h", Limits::Between(0.0, 1e6), Absent::Means(0.0), "time of a maximum, from the start");

const EVOLUTIONS: &Kinds<Evolution, ()> = &[
    &Kind::new("constant", "It stays as it is", &[], |_, ()| Ok(Box::new(Evolution::Constant))),
    &Kind::new("random_walk", "A random walk", &[&[&SIGMA_PER_SQRT_DAY]], |section, ()| {
        Ok(Box::new(Evolution::RandomWalk { sigma_per_sqrt_day: section.get(&SIGMA_PER_SQRT_DAY)? }))
    }),
    &Kind::new("jump", "A jump at one time", &[&[&AT_HOURS, &SIZE]], |section, ()| {
        Ok(Box::new(Evolution::Jump { at_hours: section.get(&AT_HOURS)?, size: section.get(&SIZE)? }))
    }),
    &Kind::new("sinusoid", "A sinusoid", &[&[&AMPLITUDE, &PERIOD_HOURS, &PEAK_HOURS]], |section, ()| {
        Ok(Box::new(Evolution::Sinusoid {
            amplitude: section.get(&AMPLITUDE)?,
            period_hours: section.get(&PERIOD_HOURS)?,
            peak_hours: section.get(&PEAK_HOURS)?,
        }))
    }),
];
