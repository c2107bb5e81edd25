//! `[initialise]`: where the first calibration comes from.

use crate::kinds::methods::Method;
use crate::reader::{Limits, Read, Section};
use crate::text::{clean, listed};
use indexmap::IndexMap;
use isobar_assim::high_pass::HighPassSettings;

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

/// Reads `[initialise]`; `cycles` are those of the run.
pub(super) fn read(root: &Section<'_>, methods: &IndexMap<String, Method>, cycles: usize) -> Read<Option<Initialise>> {
    let Some(field) = root.optional("initialise") else { return Ok(None) };
    let section = field.section(&["method", "cycles", "box_km", "covariance_scale", "methods"])?;
    section.required("method")?.choice(&[("high-pass", ())])?;
    let cycles_field = section.required("cycles")?;
    let batch = cycles_field.whole(2, 1_000_000)?;
    if batch > cycles {
        let message = format!("an initialisation from {batch} cycles is longer than the run of {cycles}");
        return Err(cycles_field.invalid(message, &format!("must be from 2 to {cycles}, that is cycle.count")));
    }
    let box_m = 1e3 * section.number("box_km", Limits::Between(0.001, 1e6))?;
    let covariance_scale = section.number_or("covariance_scale", 2.0, Limits::NonNegative)?;
    let able: Vec<&str> =
        methods.iter().filter(|(_, method)| method.can_be_initialised()).map(|(name, _)| name.as_str()).collect();
    let chosen: Vec<String> = match section.optional("methods") {
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
    let high_pass = HighPassSettings { cycles: batch, box_m, covariance_scale };
    Ok(Some(Initialise { high_pass, methods: chosen }))
}
