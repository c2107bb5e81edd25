//! The keys of a scenario file, from the top.

use super::{comparisons, cycle, expected, grid, initialise, quality, sensors, sweep, truth};
use crate::kinds::{covariances, forcing, forecast, warnings};
use crate::reader::{Absent, AnyKey, Described, Form, Integer, Key, Table, YesNo};

const TITLE: Key<Described> = Key::required("title", "", TEXT, "title, in one line");

const PHENOMENON: Key<Described> = Key::required("phenomenon", "", TEXT, "the phenomenon that the experiment shows");

const SOURCE: Key<Described> = Key::required("source", "", TEXT, "the paper or other origin");

const TEXT: Described = Described("1 to 500 printable characters", Form::text);

const SEED: Key<Integer> = Key::required(
    "seed",
    "",
    Integer(0, i64::MAX),
    "seed of all random numbers: another seed, another truth and other observation errors",
);

const START: Key<Described> = Key::required(
    "start",
    "",
    Described("a time such as \"2026-01-15T00:00:00Z\", in whole seconds, from 1900 to 2200", || Form::Time),
    "valid time of the initial state",
);

pub(super) const REGRESSION: Key<YesNo> = Key::absent(
    "regression",
    "",
    YesNo,
    Absent::Means(true),
    "whether `isobar regress` runs it without being asked by name",
);

const fn table(name: &'static str, keys: &'static [&'static dyn AnyKey], meaning: &'static str) -> Key<Table> {
    Key::required(name, "", Table(keys), meaning)
}

const fn optional(
    name: &'static str,
    keys: &'static [&'static dyn AnyKey],
    absent: &'static str,
    meaning: &'static str,
) -> Key<Table> {
    Key::absent(name, "", Table(keys), Absent::Explained(absent), meaning)
}

/// A table of the kinds in one of the lists.
const fn of_kind(name: &'static str, form: fn() -> Form, meaning: &'static str) -> Key<Described> {
    Key::required(name, "", Described("a table whose `kind` says what it is", form), meaning)
}

/// Tables of the kinds in one of the lists, each with a name.
const NAMED: &str = "a table for each, under a name; its `kind` says what it is";

/// All keys.
pub(crate) const ALL: &[&dyn AnyKey] = &[
    &TITLE,
    &PHENOMENON,
    &SOURCE,
    &SEED,
    &START,
    &table("grid", grid::KEYS, "the plane and its cells"),
    &of_kind("model", || Form::Listed("models"), "the equations and their time step"),
    &Key::absent(
        "forcing",
        "",
        Described("a list of tables", forcing::form_of_list),
        Absent::Explained("no sources"),
        "known sources of the model: what is added to its variables whatever its state, such as heating or a tide",
    ),
    &of_kind("initial", || Form::Listed("initial"), "the state from which all methods start"),
    &table("background_error", covariances::KEYS, "how far the truth is from that state: covariance B"),
    &optional(
        "model_error",
        covariances::KEYS,
        "the model is perfect",
        "what the model does wrong in one cycle: covariance Q",
    ),
    &optional(
        "truth",
        truth::KEYS,
        "it is as the methods assume",
        "how the true world differs from what methods assume",
    ),
    &table("cycle", cycle::KEYS, "forecast and analysis, again and again"),
    &optional(
        "forecast",
        forecast::KEYS,
        "no forecasts ahead",
        "forecasts ahead of the analyses of all methods, and their scores by lead time",
    ),
    &Key::absent(
        "warnings",
        "",
        Described("a list of tables", warnings::form),
        Absent::Explained("no warnings"),
        "values beyond a threshold, of which forecasts ahead warn",
    ),
    &optional(
        "quality_control",
        quality::KEYS,
        "no check, unless a network has faults",
        "how the values of observations are checked",
    ),
    &Key::absent(
        "networks",
        "",
        Described(NAMED, || Form::Named(&[], Box::new(Form::Listed("instruments")))),
        Absent::Explained("there are no observations"),
        "the observing systems",
    ),
    &Key::required(
        "methods",
        "",
        Described(NAMED, || Form::Named(&[], Box::new(Form::Listed("methods")))),
        "the methods that run side by side",
    ),
    &optional(
        "initialise",
        initialise::KEYS,
        "methods start from the biases' priors",
        "the first calibration from the first observations",
    ),
    &optional("diagnostics", cycle::DIAGNOSTICS_KEYS, "it is not computed", "what each type of observations is worth"),
    &optional("sweep", sweep::KEYS, "nothing varies", "the settings that `isobar sweep` runs"),
    &optional(
        "sensors",
        sensors::KEYS,
        "no database",
        "a database of sensors and their calibrations, kept from run to run",
    ),
    &Key::absent(
        "comparisons",
        "",
        Described("a list of tables", comparisons::form),
        Absent::Explained("no comparisons"),
        "comparisons of sensors and test points within the run, which tell methods of the biases",
    ),
    &optional("stability", sensors::STABILITY_KEYS, "biases are never frozen", "when a bias counts as determined"),
    &Key::absent(
        "output",
        "",
        Described("a table of outputs, each true or false", cycle::output_form),
        Absent::Explained("all are written"),
        "what is written beside the summary and the scores",
    ),
    &REGRESSION,
    &Key::absent(
        "expected",
        "",
        Described("a table for each method, written by `isobar regress --accept`", expected::form),
        Absent::Explained("no scores were accepted"),
        "the scores that a run of the scenario must have",
    ),
];
