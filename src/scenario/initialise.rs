//! `[initialise]`: where the first calibration comes from.

use crate::kinds::methods::Method;
use crate::reader::{Absent, AnyKey, Choice, Described, Form, Key, Limits, Read, Section, Whole};
use crate::text::{clean, listed};
use indexmap::IndexMap;
use isobar_assim::high_pass::HighPassSettings;
use isobar_obs::Network;

/// What some methods start from instead of the biases' priors.
#[derive(Clone, Debug, PartialEq)]
pub struct Initialise {
    /// Lange's High-pass Filter.
    pub high_pass: HighPassSettings,
    /// The methods that start from it.
    pub methods: Vec<String>,
}

/// What a method needs to be initialised.
const NEEDED: &str = "it needs a method that carries the covariance of biases with the state, such as kf or fkf, with bias = \"estimate\"";

const METHOD: Key<Choice<()>> =
    Key::required("method", "", Choice(&[("high-pass", ())]), "how: Lange's High-pass Filter");

const CYCLES: Key<Whole> = Key::required(
    "cycles",
    "cycles",
    Whole(2, 1_000_000),
    "number of first cycles from whose observations the calibration is found; at most those of the run",
);

const BOX_KM: Key<Limits> = Key::required(
    "box_km",
    "km",
    Limits::Between(0.001, 1e6),
    "side of a box, over which the correction of the state is the same",
);

const COVARIANCE_SCALE: Key<Limits> = Key::absent(
    "covariance_scale",
    "1",
    Limits::NonNegative,
    Absent::Means(2.0),
    "factor on the covariance of what the correction of a box leaves over",
);

const METHODS: Key<Described> = Key::absent(
    "methods",
    "",
    Described("a list of names", Form::texts),
    Absent::Explained("all methods that can"),
    "the methods that start from it",
);

/// The keys.
pub(super) const KEYS: &[&dyn AnyKey] = &[&METHOD, &CYCLES, &BOX_KM, &COVARIANCE_SCALE, &METHODS];

/// Reads `[initialise]`; `cycles` are those of the run, and `correlated` a network with correlated errors.
pub(super) fn read(
    root: &Section<'_>,
    methods: &IndexMap<String, Method>,
    cycles: usize,
    correlated: Option<&Network>,
) -> Read<Option<Initialise>> {
    let Some(field) = root.optional("initialise") else { return Ok(None) };
    let section = field.section_with(KEYS)?;
    section.get(&METHOD)?;
    let (cycles_field, batch) = (section.required(CYCLES.name)?, section.get(&CYCLES)?);
    if batch > cycles {
        let message = format!("an initialisation from {batch} cycles is longer than the run of {cycles}");
        return Err(cycles_field.invalid(message, &format!("must be from 2 to {cycles}, that is cycle.count")));
    }
    let box_m = 1e3 * section.get(&BOX_KM)?;
    let covariance_scale = section.get(&COVARIANCE_SCALE)?;
    let able: Vec<&str> =
        methods.iter().filter(|(_, method)| method.can_be_initialised()).map(|(name, _)| name.as_str()).collect();
    let chosen: Vec<String> = match section.optional(METHODS.name) {
        None => able.iter().map(ToString::to_string).collect(),
        Some(list) => {
            for element in list.elements(methods.len())? {
                let name = element.text()?;
                if !able.contains(&name.as_str()) {
                    let message = format!("the method `{}` cannot be initialised", clean(&name));
                    let help = format!("{NEEDED}: {}", listed(able.iter().copied()));
                    return Err(element.invalid(message, &help));
                }
            }
            list.texts(methods.len())?
        }
    };
    if chosen.is_empty() {
        let message = "[initialise] has no method to initialise".to_string();
        return Err(field.misplaced(message, NEEDED));
    }
    let uses_correlation = |name: &&String| methods[*name].uses_error_correlation;
    if let (Some(name), Some(network)) = (chosen.iter().find(uses_correlation), correlated) {
        let message = format!(
            "the method `{name}` cannot be initialised: a high-pass filter takes errors as independent, and those of \
             network {} are correlated",
            network.name
        );
        return Err(
            field.misplaced(message, "give the method `error_correlation = \"ignore\"`, or leave out [initialise]")
        );
    }
    let high_pass = HighPassSettings { cycles: batch, box_m, covariance_scale };
    Ok(Some(Initialise { high_pass, methods: chosen }))
}
