//! `adapt = { … }` of a method: which errors it estimates from its innovations.

use crate::reader::{Absent, Key, Read, Section, Whole, YesNo};

/// What a method adapts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Adapt {
    /// Whether there is a factor on R for each type of observations.
    pub observation_error: bool,
    /// Whether there is a factor on Q; for a method with a static covariance, on B.
    pub state_error: bool,
    /// How many cycles are remembered.
    pub memory_cycles: usize,
}

/// Whose error a method has a covariance of: the key in `adapt`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StateError {
    Model,
    Background,
}

const OBSERVATION_ERROR: Key<YesNo> = Key::absent(
    "observation_error",
    "",
    YesNo,
    Absent::Means(false),
    "whether there is a factor on R for each type of observations",
);

const MODEL_ERROR: Key<YesNo> =
    Key::absent("model_error", "", YesNo, Absent::Means(false), "whether there is a factor on Q");

const BACKGROUND_ERROR: Key<YesNo> =
    Key::absent("background_error", "", YesNo, Absent::Means(false), "whether there is a factor on B");

const MEMORY_CYCLES: Key<Whole> = Key::absent(
    "memory_cycles",
    "",
    Whole(1, 1_000_000),
    Absent::Means(20),
    "memory of the estimates in cycles: older ones fade",
);

/// Reads it; nothing without the key.
pub(super) fn read(section: &Section<'_>, of: StateError, has_model_error: bool) -> Read<Option<Adapt>> {
    let Some(field) = section.optional("adapt") else { return Ok(None) };
    let state_key = match of {
        StateError::Model => &MODEL_ERROR,
        StateError::Background => &BACKGROUND_ERROR,
    };
    let section = field.section(&[OBSERVATION_ERROR.name, state_key.name, MEMORY_CYCLES.name])?;
    let adapt = Adapt {
        observation_error: section.get(&OBSERVATION_ERROR)?,
        state_error: section.get(state_key)?,
        memory_cycles: section.get(&MEMORY_CYCLES)?,
    };
    if !(adapt.observation_error || adapt.state_error) {
        let message = format!("`{}` adapts nothing", field.title());
        return Err(field.invalid(message, &format!("needs `observation_error = true` or `{} = true`", state_key.name)));
    }
    if adapt.state_error && of == StateError::Model && !has_model_error {
        let message = "there is no model error that could be adapted".to_string();
        return Err(field.invalid(message, "needs components in [model_error]"));
    }
    Ok(Some(adapt))
}
