//! `[truth]`: a model run that differs from what methods assume, the states of a file, or none.

use crate::kinds::initial::{INITIAL, InitialState, TRUE_VARIABLES, state_file};
use crate::kinds::models::{self, Model};
use crate::kinds::{self, Domain, forcing};
use crate::reader::{Absent, AnyKey, Choice, Described, Field, Form, Key, Limits, Read, Section, StateFile};
use crate::text::clean;
use isobar_model::{Layout, State, Time};
use isobar_obs::Network;
use std::sync::Arc;

/// The true world.
#[derive(Clone, Debug)]
pub enum TruthSettings {
    /// A model run, with which the experiment is one of twins.
    Twin(TwinSettings),
    /// The states of a file.
    Series(TruthSeries),
}

/// How a true world that is a model run differs from what the methods assume.
#[derive(Clone, Debug)]
pub struct TwinSettings {
    /// The model of the truth.
    pub model: Model,
    /// Where it starts; `None`: at a draw of the background error from the first background.
    pub initial: Option<Arc<dyn InitialState>>,
    /// Factor on the variance of the model error that is really added each cycle; 0 for a perfect model.
    pub model_error_scale: f64,
    /// Factor on the variance of the truth's deviation from the first background; 0 for a perfect start.
    pub background_error_scale: f64,
}

/// True states of a file, at the times that it has. They need not be states that the methods' model can have.
#[derive(Clone, Debug)]
pub struct TruthSeries {
    name: String,
    file: Arc<StateFile>,
}

impl TruthSeries {
    /// The name of the file, as the scenario gives it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The true state at a time.
    ///
    /// # Errors
    /// In words: the file has no state at this time, or a value is missing.
    pub fn state(&self, time: Time) -> Result<State, String> {
        let values = self.file.values(Some(time)).map_err(|problem| format!("{}: {problem}", self.name))?;
        Ok(State::from_values(self.file.layout(), values).valid_at(time))
    }
}

/// What the truth is, where `truth.kind` says it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum TruthKind {
    None,
    Series,
}

const TRUTH_KIND: Key<Choice<TruthKind>> = Key::absent(
    "kind",
    "",
    Choice(&[("none", TruthKind::None), ("series", TruthKind::Series)]),
    Absent::Explained(
        "a model run, as the keys below say; no truth if all networks are files and there is no `[truth]`",
    ),
    "\"series\" for the states of a file; \"none\" if there is no truth, but only observations from files",
);

const TRUE_FILE: Key<Described> = Key::absent(
    "file",
    "",
    Described(
        "a netCDF file, of version 3 or 4, with a field on the grid for each of the model's variables, at the start of the \
         run and the end of every cycle",
        Form::text,
    ),
    Absent::Explained("must be given with `kind = \"series\"`, and goes with no other"),
    "the true states",
);

const TRUE_MODEL: Key<Described> = Key::absent(
    "model",
    "",
    Described("a table with keys of `[model]`; `kind` only where it is another one", || Form::PartOf("models")),
    Absent::Explained("the truth has the methods' model"),
    "keys of the model that have another value in the truth; with another `kind`, which must have the same variables, the keys \
     that both kinds have are those of `[model]` unless they are given here",
);

const TRUE_FORCING: Key<Described> = Key::absent(
    "forcing",
    "",
    Described("a list of tables as `[[forcing]]`; an empty one for none", forcing::form_of_list),
    Absent::Explained("that of the model"),
    "the sources that the truth has instead of the model's",
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

/// The keys of a series.
const SERIES_KEYS: [&dyn AnyKey; 2] = [&TRUE_FILE, &TRUE_VARIABLES];

/// The keys of a model run.
const TWIN_KEYS: [&dyn AnyKey; 5] =
    [&TRUE_MODEL, &TRUE_FORCING, &TRUE_INITIAL, &MODEL_ERROR_SCALE, &BACKGROUND_ERROR_SCALE];

/// The keys of `[truth]`.
pub(super) const KEYS: &[&dyn AnyKey] = &[
    &TRUTH_KIND,
    SERIES_KEYS[0],
    SERIES_KEYS[1],
    TWIN_KEYS[0],
    TWIN_KEYS[1],
    TWIN_KEYS[2],
    TWIN_KEYS[3],
    TWIN_KEYS[4],
];

/// Reads `[truth]`, whose states have a layout; there is no field of a model that is given by code. There is no truth where it
/// says so, and where all observations are recorded and nothing is said.
pub(super) fn read(
    root: &Section<'_>,
    model_field: Option<&Field<'_>>,
    domain: &Domain,
    layout: &Arc<Layout>,
    networks: &[Network],
) -> Read<Option<TruthSettings>> {
    let observes_truth = networks.iter().find(|network| !network.instrument.is_recorded());
    let is_recorded = !networks.is_empty() && observes_truth.is_none();
    let plain = TwinSettings {
        model: domain.model.clone(),
        initial: None,
        model_error_scale: 1.0,
        background_error_scale: 1.0,
    };
    let Some(field) = root.optional("truth") else {
        return Ok((!is_recorded).then_some(TruthSettings::Twin(plain)));
    };
    let section = field.section_with(KEYS)?;
    match section.find(&TRUTH_KIND)? {
        Some(TruthKind::None) => {
            if let Some(network) = observes_truth {
                let message = format!("there is no truth that network {} could observe", network.name);
                let kind = section.required(TRUTH_KIND.name)?;
                return Err(kind.misplaced(message, "leave out this key, or read all observations from files"));
            }
            refuse(&section, &KEYS[1..], "says something of a truth that is not there")?;
            Ok(None)
        }
        Some(TruthKind::Series) => {
            refuse(&section, &TWIN_KEYS, "is of a truth that is a model run, not the states of a file")?;
            let file = state_file(&section, domain, Arc::clone(layout))?;
            let field = section.required(TRUE_FILE.name)?;
            let name = clean(&field.text()?);
            if file.times().is_none() {
                let message = format!("{name} does not say of what times its states are");
                return Err(field.invalid(message, "needs a dimension of times"));
            }
            Ok(Some(TruthSettings::Series(TruthSeries { name, file: Arc::new(file) })))
        }
        None => {
            refuse(&section, &SERIES_KEYS, "goes with `kind = \"series\"` of the truth")?;
            Ok(Some(TruthSettings::Twin(read_twin(&section, model_field, domain, plain)?)))
        }
    }
}

/// Refuses keys that say nothing of this kind of truth, which `why` says.
fn refuse(section: &Section<'_>, keys: &[&dyn AnyKey], why: &str) -> Read<()> {
    let Some(other) = keys.iter().find_map(|key| section.optional(key.name())) else { return Ok(()) };
    let help = match section.optional(TRUTH_KIND.name) {
        Some(_) => "leave out this key or truth.kind",
        None => "leave out this key, or give truth.kind",
    };
    Err(other.misplaced(format!("`{}` {why}", other.title()), help))
}

fn read_twin(
    section: &Section<'_>,
    model_field: Option<&Field<'_>>,
    domain: &Domain,
    mut truth: TwinSettings,
) -> Read<TwinSettings> {
    if let Some(overrides) = section.optional(TRUE_MODEL.name) {
        let Some(model) = model_field else {
            return Err(overrides.misplaced("a model that is given by code has no keys".into(), "leave it out"));
        };
        let forcing = Arc::clone(&truth.model.forcing);
        truth.model = Model { forcing, ..models::read_with_overrides(model, &overrides, &domain.grid)? };
    }
    if let Some(forcing) = forcing::read(section, TRUE_FORCING.name, domain)? {
        truth.model.forcing = forcing;
    }
    if let Some(field) = section.optional(TRUE_INITIAL.name) {
        let domain = Domain { model: truth.model.clone(), ..domain.clone() };
        truth.initial = Some(kinds::read(&field, INITIAL, &domain)?.into());
        if let Some(scale) = section.optional(BACKGROUND_ERROR_SCALE.name) {
            let message =
                "a truth that starts at a given state does not start at a draw of the background error".into();
            return Err(scale.misplaced(message, "leave out this key or truth.initial"));
        }
    }
    truth.model_error_scale = section.get(&MODEL_ERROR_SCALE)?;
    truth.background_error_scale = section.get(&BACKGROUND_ERROR_SCALE)?;
    Ok(truth)
}
