//! `factors`: how many common factors a Fast Kalman Filter has.

use super::Surroundings;
use crate::kinds::covariances;
use crate::reader::{Absent, Key, Limits, OrTable, OrWord, Read, Section, Whole};
use isobar_assim::covariance::middle_deviations;
use isobar_assim::fast_kalman::Precision;
use toml::de::DeValue;

pub(super) const FACTORS: Key<OrTable<OrWord<Whole>>> = Key::absent(
    "factors",
    "",
    OrTable(OrWord("auto", Whole(0, MOST_FACTORS)), &[&RETAINED, &AT_MOST]),
    Absent::Explained(
        "\"auto\"; 0 with blocks larger than a cell, an exact forecast of the blocks, bias_coupling = \"drop\" or local factors",
    ),
    "number of common factors, which hold what blocks have in common; \"auto\" for as many as the spectra of B and Q ask for, \
     or in fkf for local factors where these are fewer",
);

/// The most common factors.
const MOST_FACTORS: usize = 100_000;

const RETAINED: Key<Limits> =
    Key::required("retained", "", Limits::Between(0.01, 1.0), "share of their energy that is kept");

const AT_MOST: Key<Whole> = Key::required("at_most", "", Whole(1, MOST_FACTORS), "the most factors");

/// B and Q ask for as many factors as hold this share of their energy, the white part left out.
const HELD: f64 = 1.0 - 1e-5;

/// How many times as many there may be: a model that stretches and folds errors makes more directions of them.
const ALLOWANCE: usize = 2;

/// The share of their energy for which a forecast keeps factors.
const RETAINED_ENERGY: f64 = 0.999;

/// How many common factors there are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CommonFactors {
    /// The most of them.
    pub at_most: usize,
    /// The share of their energy for which a forecast keeps the leading ones; 1 for as many as there may be.
    pub retained_energy: f64,
    /// The number that B and Q ask for, if the scenario leaves it to them.
    pub asked_for: Option<usize>,
}

/// Reads a number of factors, the most of them with the share of their energy that is kept, or `"auto"`. Without the key there
/// are as many as B and Q ask for, or none at all if that is the default.
pub(super) fn read(section: &Section<'_>, surroundings: &Surroundings, none_by_default: bool) -> Read<CommonFactors> {
    let fixed = |at_most| CommonFactors { at_most, retained_energy: 1.0, asked_for: None };
    let field = section.optional(FACTORS.name);
    if let Some(field) = field.as_ref().filter(|field| matches!(field.value.get_ref(), DeValue::Table(_))) {
        let section = field.section(&[RETAINED.name, AT_MOST.name])?;
        let retained_energy = section.get(&RETAINED)?;
        return Ok(CommonFactors { retained_energy, ..fixed(section.get(&AT_MOST)?) });
    }
    let number = match &field {
        Some(field) => FACTORS.allowed.read_plain(field)?,
        None => none_by_default.then_some(0),
    };
    if let Some(number) = number {
        return Ok(fixed(number));
    }
    if let Some(number) = number_asked_for(surroundings) {
        return Ok(CommonFactors::asked_for(number, surroundings));
    }
    let field = match field {
        Some(field) => field,
        None => section.required(FACTORS.name)?,
    };
    let message = "neither spectra nor correlation lengths of B and Q say how many factors there should be";
    Err(field.invalid(message.into(), "must be a number for these errors"))
}

impl CommonFactors {
    /// Those that B and Q ask for.
    fn asked_for(number: usize, surroundings: &Surroundings) -> Self {
        let values = surroundings.domain.grid.cells() * surroundings.domain.model.variables().len();
        Self {
            at_most: (ALLOWANCE * number).min(values),
            retained_energy: if number > 0 { RETAINED_ENERGY } else { 1.0 },
            asked_for: Some(number),
        }
    }
}

/// How factors are stored and propagated, in words, where it is not as usual.
pub(super) fn storage(precision: Precision, factor_grid: usize) -> String {
    let precision = if precision == Precision::Single { " in single precision" } else { "" };
    match factor_grid {
        1 => precision.into(),
        cells => format!("{precision} on a grid {cells} times as wide"),
    }
}

/// How many factors B and Q ask for; `None` if neither spectra nor lengths say it.
fn number_asked_for(surroundings: &Surroundings) -> Option<usize> {
    by_spectra(surroundings).or_else(|| by_length(surroundings))
}

/// As many leading directions as hold [`HELD`] of the energy of B, or of that of Q if these are more, but for what is white: the
/// blocks hold that. Each variable is divided by its standard deviation in B, as it is when factors are compressed. `None` if
/// a spectrum is not known without all of the matrix. See [`Spectrum::holding`](isobar_assim::covariance::Spectrum::holding).
fn by_spectra(surroundings: &Surroundings) -> Option<usize> {
    let Surroundings { domain, cycle, background_error, model_error, .. } = surroundings;
    // What cannot be built is refused by the run, in its own words.
    let model = domain.model.build(&domain.grid, *cycle).ok()?;
    let layout = model.layout();
    let background_error = covariances::build(background_error, layout).ok()?;
    let model_error = covariances::build(model_error, layout).ok()?;
    let scales = middle_deviations(&*background_error, layout);
    let numbers = [background_error, model_error].map(|covariance| Some(covariance.spectrum(&scales)?.holding(HELD)));
    Some(numbers[0]?.max(numbers[1]?).min(layout.len()))
}

/// `2 area / L²`, L the shortest correlation length of Q, or of B if there is no Q: for a Gaussian correlation as many as
/// hold all but 5 · 10⁻⁵ of the energy of the winds.
fn by_length(surroundings: &Surroundings) -> Option<usize> {
    let Surroundings { domain, error_length_m, .. } = surroundings;
    let length_m = (*error_length_m)?;
    let area_m2 = domain.grid.width_m() * domain.grid.height_m();
    let most = domain.grid.cells() * domain.model.variables().len();
    Some(((2.0 * area_m2 / (length_m * length_m)).ceil() as usize).clamp(1, most))
}
