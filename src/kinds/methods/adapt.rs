//! `adapt = { … }` of a method: which errors it estimates from its innovations.

use crate::reader::{Absent, AnyKey, Key, Read, Section, Table, Whole, YesNo};
use isobar_assim::{AdaptedCovariance, Adaptive, AdaptiveSettings, Assimilator, Error, Problem};
use std::sync::Arc;

/// What a method adapts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Adapt {
    /// Whether there is a factor on R for each type of observations.
    pub observation_error: bool,
    /// Whether there is a factor on Q; for a method with a static covariance, on B.
    pub state_error: bool,
    /// Memory of the estimates in cycles.
    pub memory_cycles: usize,
}

/// The key of a method that forecasts its errors.
pub(super) const ADAPT: Key<Table> = adapt(&[&OBSERVATION_ERROR, &MODEL_ERROR, &MEMORY_CYCLES]);

/// The key of a method with a static covariance.
pub(super) const ADAPT_STATIC: Key<Table> = adapt(&[&OBSERVATION_ERROR, &BACKGROUND_ERROR, &MEMORY_CYCLES]);

const fn adapt(keys: &'static [&'static dyn AnyKey]) -> Key<Table> {
    Key::absent(
        "adapt",
        "",
        Table(keys),
        Absent::Explained("nothing is adapted"),
        "errors whose size is estimated from the innovations",
    )
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
    "cycles",
    Whole(1, 1_000_000),
    Absent::Means(20),
    "memory of the estimates: older innovations fade",
);

/// Reads the key, if it is given.
pub(super) fn read(section: &Section<'_>, is_static: bool, has_model_error: bool) -> Read<Option<Adapt>> {
    let Some(field) = section.optional(ADAPT.name) else { return Ok(None) };
    let state_key = if is_static { BACKGROUND_ERROR } else { MODEL_ERROR };
    let section = field.section(&[OBSERVATION_ERROR.name, state_key.name, MEMORY_CYCLES.name])?;
    let adapt = Adapt {
        observation_error: section.get(&OBSERVATION_ERROR)?,
        state_error: section.get(&state_key)?,
        memory_cycles: section.get(&MEMORY_CYCLES)?,
    };
    if !(adapt.observation_error || adapt.state_error) {
        let message = format!("`{}` adapts nothing", field.title());
        let allowed = format!("needs `observation_error = true` or `{} = true`", state_key.name);
        return Err(field.invalid(message, &allowed));
    }
    if adapt.state_error && !is_static && !has_model_error {
        let message = "there is no model error that could be adapted".to_string();
        return Err(field.invalid(message, "needs components in [model_error]"));
    }
    Ok(Some(adapt))
}

impl Adapt {
    /// The method, with factors on its errors' covariances.
    ///
    /// # Errors
    /// If the method has no such covariance.
    pub(super) fn around(
        &self,
        method: Box<dyn Assimilator>,
        ground: &Problem,
        static_covariance_scale: Option<f64>,
    ) -> Result<Box<dyn Assimilator>, Error> {
        let covariance = match static_covariance_scale {
            Some(scale) => {
                let covariance = Arc::clone(&ground.background_error);
                Some(AdaptedCovariance { name: BACKGROUND_ERROR.name, covariance, scale })
            }
            None => {
                let model_error = ground.model_error.clone();
                model_error.map(|covariance| AdaptedCovariance { name: MODEL_ERROR.name, covariance, scale: 1.0 })
            }
        };
        let settings = AdaptiveSettings {
            observation_error: self.observation_error,
            state_error: covariance.filter(|_| self.state_error),
            memory_cycles: self.memory_cycles,
        };
        Ok(Box::new(Adaptive::new(method, ground.background.layout().clone(), settings)?))
    }

    /// What is adapted, in words.
    pub(super) fn describe(&self, is_static: bool) -> String {
        let state = if is_static { "background" } else { "model" };
        let errors = match (self.observation_error, self.state_error) {
            (true, true) => format!("observation and {state} errors"),
            (true, false) => "observation errors".to_string(),
            (false, _) => format!("{state} errors"),
        };
        format!("{errors} adapted to the innovations of {} cycles", self.memory_cycles)
    }
}
