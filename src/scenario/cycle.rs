//! `[cycle]`, `[truth]`, `[diagnostics]` and `[output]`: how long the run is, how the truth differs from the model, what is
//! found out and written.

use crate::kinds::initial::{INITIAL, InitialState};
use crate::kinds::models::{self, Model};
use crate::kinds::{self, Domain};
use crate::output::{OUTPUTS, Outputs};
use crate::reader::{Absent, AnyKey, Choice, Described, Field, Form, Key, Limits, Read, Section, Whole};
use isobar_model::{Duration, Time};
use isobar_obs::Network;
use std::sync::Arc;

/// The cycles of forecast and analysis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleSettings {
    /// Number of cycles.
    pub count: usize,
    /// Length of a cycle: a whole multiple of the time steps of model and truth.
    pub window: Duration,
    /// First cycle, from 1, that counts for the scores.
    pub score_from_cycle: usize,
}

/// How the true world differs from what the methods assume.
#[derive(Clone, Debug)]
pub struct TruthSettings {
    /// The model of the truth.
    pub model: Model,
    /// Where it starts; `None`: at a draw of the background error from the first background.
    pub initial: Option<Arc<dyn InitialState>>,
    /// Factor on the variance of the model error that is really added each cycle; 0 for a perfect model.
    pub model_error_scale: f64,
    /// Factor on the variance of the truth's deviation from the first background; 0 for a perfect start.
    pub background_error_scale: f64,
}

/// The last time a run may reach: the year 9000.
const LAST_SECONDS: i64 = 221_845_392_000;

/// The most cycles.
const MOST_CYCLES: usize = 1_000_000;

const COUNT: Key<Whole> = Key::required("count", "cycles", Whole(1, MOST_CYCLES), "number of cycles");

const WINDOW_HOURS: Key<Limits> = Key::required(
    "window_hours",
    "h",
    Limits::Between(1.0 / 3600.0, 8760.0),
    "length of a cycle: whole seconds, and a whole multiple of the time step",
);

const SCORE_FROM_CYCLE: Key<Described> = Key::absent(
    "score_from_cycle",
    "",
    Described("a whole number from 1 to `count`", || Form::Whole(1, MOST_CYCLES as i64)),
    Absent::Means("1"),
    "the first cycle that counts for the scores",
);

/// The keys of `[cycle]`.
pub(super) const KEYS: &[&dyn AnyKey] = &[&COUNT, &WINDOW_HOURS, &SCORE_FROM_CYCLE];

const NO_TRUTH: Key<Choice<()>> = Key::absent(
    "kind",
    "",
    Choice(&[("none", ())]),
    Absent::Explained("there is a truth, unless all networks are files and there is no `[truth]`"),
    "\"none\" if there is no truth, but only observations from files",
);

const TRUE_MODEL: Key<Described> = Key::absent(
    "model",
    "",
    Described("a table with keys of `[model]`, without `kind`", || Form::PartOf("models")),
    Absent::Explained("the truth has the methods' model"),
    "keys of the model that have another value in the truth",
);

const TRUE_INITIAL: Key<Described> = Key::absent(
    "initial",
    "",
    Described("a table as `[initial]`", || Form::Listed("initial")),
    Absent::Explained("a draw of the background error from `[initial]`"),
    "where the truth starts",
);

const MODEL_ERROR_SCALE: Key<Limits> = Key::absent(
    "model_error_scale",
    "1",
    Limits::NonNegative,
    Absent::Means(1.0),
    "factor on the variance of the model error that the truth really has; 0 for a perfect model",
);

const BACKGROUND_ERROR_SCALE: Key<Limits> = Key::absent(
    "background_error_scale",
    "1",
    Limits::NonNegative,
    Absent::Means(1.0),
    "factor on the variance of the truth's deviation from the first background; 0 for a perfect start",
);

/// The keys of `[truth]`.
pub(super) const TRUTH_KEYS: &[&dyn AnyKey] =
    &[&NO_TRUTH, &TRUE_MODEL, &TRUE_INITIAL, &MODEL_ERROR_SCALE, &BACKGROUND_ERROR_SCALE];

const INFLUENCE: Key<Whole> = Key::required(
    "influence_every_cycles",
    "cycles",
    Whole(1, 1_000_000),
    "how often it is found out what each type of observations is worth; each time costs additional analyses, one more than \
     there are types",
);

/// The keys of `[diagnostics]`.
pub(super) const DIAGNOSTICS_KEYS: &[&dyn AnyKey] = &[&INFLUENCE];

/// The form of `[output]`: whether each output is written.
pub(super) fn output_form() -> Form {
    Form::Entries(OUTPUTS.iter().filter(|output| output.by_default).map(|output| (output.name, Form::YesNo)).collect())
}

pub(super) fn read(root: &Section<'_>, start: Time, steps: &[(&str, Duration)]) -> Read<CycleSettings> {
    let section = root.required("cycle")?.section_with(KEYS)?;
    let (count_field, count) = (section.required(COUNT.name)?, section.get(&COUNT)?);
    let (window_field, hours) = (section.required(WINDOW_HOURS.name)?, section.get(&WINDOW_HOURS)?);
    let seconds = (hours * 3600.0).round();
    if (hours * 3600.0 - seconds).abs() > 1e-6 {
        let message = format!("a window of {hours} hours is not a whole number of seconds");
        return Err(window_field.invalid(message, "must be a whole number of seconds"));
    }
    let window = Duration::from_seconds(seconds as i64);
    for (key, step) in steps {
        if window.steps_of(*step).is_none() {
            let message = format!("a window of {hours} hours ({window}) is not a whole multiple of {key} = {step}");
            return Err(window_field.invalid(message, &format!("must be a whole multiple of {step}")));
        }
    }
    if start.seconds() + window.seconds() * count as i64 > LAST_SECONDS {
        let message = format!("{count} cycles of {hours} hours end after the year 9000");
        return Err(count_field.invalid(message, "too many"));
    }
    let score_from_cycle = section.whole_or(SCORE_FROM_CYCLE.name, 1, 1, count)?;
    Ok(CycleSettings { count, window, score_from_cycle })
}

/// Reads `[truth]`; there is no field of a model that is given by code. There is no truth where it says so, and where all observations are recorded and nothing is said.
pub(super) fn read_truth(
    root: &Section<'_>,
    model_field: Option<&Field<'_>>,
    domain: &Domain,
    networks: &[Network],
) -> Read<Option<TruthSettings>> {
    let observes_truth = networks.iter().find(|network| !network.instrument.is_recorded());
    let is_recorded = !networks.is_empty() && observes_truth.is_none();
    let mut truth = TruthSettings {
        model: domain.model.clone(),
        initial: None,
        model_error_scale: 1.0,
        background_error_scale: 1.0,
    };
    let Some(field) = root.optional("truth") else { return Ok((!is_recorded).then_some(truth)) };
    let section = field.section_with(TRUTH_KEYS)?;
    if let Some(kind) = section.optional(NO_TRUTH.name) {
        kind.choice(NO_TRUTH.allowed.0)?;
        if let Some(network) = observes_truth {
            let message = format!("there is no truth that network {} could observe", network.name);
            return Err(kind.misplaced(message, "leave out this key, or read all observations from files"));
        }
        if let Some(other) = TRUTH_KEYS[1..].iter().find_map(|key| section.optional(key.name())) {
            let message = format!("`{}` says something of a truth that is not there", other.title());
            return Err(other.misplaced(message, "leave out this key or truth.kind"));
        }
        return Ok(None);
    }
    if let Some(overrides) = section.optional(TRUE_MODEL.name) {
        let Some(model) = model_field else {
            return Err(overrides.misplaced("a model that is given by code has no keys".into(), "leave it out"));
        };
        truth.model = models::read_with_overrides(model, &overrides, &domain.grid)?;
    }
    if let Some(field) = section.optional(TRUE_INITIAL.name) {
        let domain = Domain { grid: domain.grid.clone(), model: truth.model.clone() };
        truth.initial = Some(kinds::read(&field, INITIAL, &domain)?.into());
        if let Some(scale) = section.optional(BACKGROUND_ERROR_SCALE.name) {
            let message =
                "a truth that starts at a given state does not start at a draw of the background error".into();
            return Err(scale.misplaced(message, "leave out this key or truth.initial"));
        }
    }
    truth.model_error_scale = section.get(&MODEL_ERROR_SCALE)?;
    truth.background_error_scale = section.get(&BACKGROUND_ERROR_SCALE)?;
    Ok(Some(truth))
}

/// Reads `[diagnostics]`: the number of cycles between two in which the influence of each type of observations is computed;
/// `None`: never.
pub(super) fn read_diagnostics(root: &Section<'_>) -> Read<Option<usize>> {
    let Some(field) = root.optional("diagnostics") else { return Ok(None) };
    Ok(Some(field.section_with(DIAGNOSTICS_KEYS)?.get(&INFLUENCE)?))
}

/// Reads `[output]`: which outputs are written beside the summary and the scores.
pub(super) fn read_output(root: &Section<'_>) -> Read<Outputs> {
    let mut outputs = Outputs::by_default();
    let Some(field) = root.optional("output") else { return Ok(outputs) };
    let keys: Vec<&str> = OUTPUTS.iter().filter(|output| output.by_default).map(|output| output.name).collect();
    let section = field.section(&keys)?;
    for key in keys {
        outputs.set(key, section.yes_or_no_or(key, true)?);
    }
    Ok(outputs)
}
