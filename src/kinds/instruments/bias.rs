//! `[[networks.NAME.bias]]`: how a bias truly behaves, and what methods may assume of it.

use crate::kinds::{Kind, Kinds, form, read as read_kind};
use crate::reader::{Absent, AnyKey, Described, Key, Limits, Read, Section, YesNo};
use isobar_obs::{AssumedDrift, BiasProcess, Evolution, InitialBias};

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
    Described("a table of kind \"constant\", \"random_walk\", \"ar1\", \"jump\" or \"sinusoid\"", || form(EVOLUTIONS)),
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

const ASSUMED_CORRELATION: Key<Limits> = Key::absent(
    "assumed_correlation_hours",
    "hours",
    HOURS,
    Absent::Explained("that of an AR(1) process, else none is assumed"),
    "correlation time of the AR(1) process that methods assume, whose standard deviation is that of the prior",
);

const HOURS: Limits = Limits::Between(0.01, 1e6);

/// The keys of every bias.
pub(super) const KEYS: &[&dyn AnyKey] =
    &[&SIGMA, &VALUE, &EVOLUTION, &KNOWN, &ASSUMED_SIGMA, &ASSUMED_DRIFT, &ASSUMED_CORRELATION];

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
        assumed_drift: assumed_drift(section)?,
        known,
    })
}

fn assumed_drift(section: &Section<'_>) -> Read<Option<AssumedDrift>> {
    match (section.find(&ASSUMED_DRIFT)?, section.find(&ASSUMED_CORRELATION)?) {
        (None, None) => Ok(None),
        (Some(sigma_per_sqrt_day), None) => Ok(Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day })),
        (None, Some(correlation_hours)) => Ok(Some(AssumedDrift::FirstOrder { correlation_hours })),
        (Some(_), Some(_)) => {
            let hours = section.required(ASSUMED_CORRELATION.name)?;
            let message = format!("`{}` stands beside `{}`", hours.title(), ASSUMED_DRIFT.name);
            Err(hours.misplaced(message, "methods assume a random walk or an AR(1) process, not both"))
        }
    }
}

/// `sigma` of a bias of observations that were made elsewhere, of whose true value nothing is known.
pub(super) const RECORDED_SIGMA: Key<Limits> =
    Key::required("sigma", OBSERVED, Limits::Positive, "standard deviation of the prior of the bias");

/// `evolution` of such a bias.
pub(super) const RECORDED_EVOLUTION: Key<Described> = Key::absent(
    "evolution",
    "",
    Described("a table of kind \"constant\", \"random_walk\" or \"ar1\"", || form(ASSUMED_EVOLUTIONS)),
    Absent::Explained("it is constant"),
    "how methods take the bias to change",
);

/// Reads [`RECORDED_SIGMA`] and [`RECORDED_EVOLUTION`].
pub(super) fn read_recorded(section: &Section<'_>) -> Read<BiasProcess> {
    let evolution = section.optional(RECORDED_EVOLUTION.name);
    let evolution = evolution.map(|field| read_kind(&field, ASSUMED_EVOLUTIONS, &()));
    Ok(BiasProcess {
        evolution: evolution.transpose()?.map_or(Evolution::Constant, |evolution| *evolution),
        ..BiasProcess::constant(section.get(&RECORDED_SIGMA)?)
    })
}

const SIGMA_PER_SQRT_DAY: Key<Limits> =
    Key::required("sigma_per_sqrt_day", OBSERVED, Limits::Positive, "standard deviation of its steps over one day");

const CORRELATION_HOURS: Key<Limits> =
    Key::required("correlation_hours", "hours", HOURS, "time in which the correlation falls by a factor e");

const AT_HOURS: Key<Limits> =
    Key::required("at_hours", "h", Limits::Between(0.0, 1e9), "time of the jump, from the start of the scenario");

const SIZE: Key<Limits> = Key::required("size", OBSERVED, Limits::Any, "height of the jump");

const AMPLITUDE: Key<Limits> = Key::required("amplitude", OBSERVED, Limits::Any, "amplitude");

const PERIOD_HOURS: Key<Limits> = Key::required("period_hours", "h", Limits::Between(0.01, 1e6), "period");

const PEAK_HOURS: Key<Limits> =
    Key::absent("peak_hours", "h", Limits::Between(0.0, 1e6), Absent::Means(0.0), "time of a maximum, from the start");

const CONSTANT: Kind<Evolution, ()> =
    Kind::new("constant", "It stays as it is", &[], |_, ()| Ok(Box::new(Evolution::Constant)));

const RANDOM_WALK: Kind<Evolution, ()> =
    Kind::new("random_walk", "A random walk", &[&[&SIGMA_PER_SQRT_DAY]], |section, ()| {
        Ok(Box::new(Evolution::RandomWalk { sigma_per_sqrt_day: section.get(&SIGMA_PER_SQRT_DAY)? }))
    });

const FIRST_ORDER: Kind<Evolution, ()> = Kind::new(
    "ar1",
    "An AR(1) process with the standard deviation `sigma`, which goes back to zero",
    &[&[&CORRELATION_HOURS]],
    |section, ()| Ok(Box::new(Evolution::FirstOrder { correlation_hours: section.get(&CORRELATION_HOURS)? })),
);

/// The evolutions that methods can take into account.
const ASSUMED_EVOLUTIONS: &Kinds<Evolution, ()> = &[&CONSTANT, &RANDOM_WALK, &FIRST_ORDER];

const EVOLUTIONS: &Kinds<Evolution, ()> = &[
    &CONSTANT,
    &RANDOM_WALK,
    &FIRST_ORDER,
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
