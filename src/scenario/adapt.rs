//! `adapt = { … }` of a method: which errors it estimates from its innovations.

use super::reader::{Read, Section};

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

/// Reads it; nothing without the key.
pub(super) fn read(section: &Section<'_>, of: StateError, has_model_error: bool) -> Read<Option<Adapt>> {
    let Some(field) = section.optional("adapt") else { return Ok(None) };
    let state_key = match of {
        StateError::Model => "model_error",
        StateError::Background => "background_error",
    };
    let own = field.section(&["observation_error", state_key, "memory_cycles"])?;
    let adapt = Adapt {
        observation_error: own.yes_or_no_or("observation_error", false)?,
        state_error: own.yes_or_no_or(state_key, false)?,
        memory_cycles: own.whole_or("memory_cycles", 20, 1, 1_000_000)?,
    };
    if !(adapt.observation_error || adapt.state_error) {
        let message = format!("`{}` adapts nothing", field.title());
        return Err(field.invalid(message, &format!("needs `observation_error = true` or `{state_key} = true`")));
    }
    if adapt.state_error && of == StateError::Model && !has_model_error {
        let message = "there is no model error that could be adapted".to_string();
        return Err(field.invalid(message, "needs components in [model_error]"));
    }
    Ok(Some(adapt))
}
