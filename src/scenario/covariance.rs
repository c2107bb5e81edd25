//! `[background_error]` and `[model_error]`: covariances as sums of components.

use super::model::ModelSettings;
use super::reader::{Field, Kind, Limits, Read};

/// One of the independent parts whose covariances add up.
#[derive(Clone, Debug, PartialEq)]
pub enum CovarianceComponent {
    /// A Gaussian-correlated height with the wind in geostrophic balance with it.
    Balanced {
        /// Standard deviation of height \[m\].
        sigma_height_m: f64,
        /// Correlation length \[m\].
        length_m: f64,
    },
    /// One Gaussian-correlated variable alone.
    Univariate {
        /// Name of the variable.
        variable: String,
        /// Standard deviation, in the variable's unit.
        sigma: f64,
        /// Correlation length \[m\].
        length_m: f64,
    },
    /// One variable, uncorrelated from point to point.
    White {
        /// Name of the variable.
        variable: String,
        /// Standard deviation, in the variable's unit.
        sigma: f64,
    },
}

#[derive(Clone, Copy)]
enum Part {
    Balanced,
    Univariate,
    White,
}

const KINDS: &[Kind<Part>] = &[
    ("balanced", Part::Balanced, &["sigma_height_m", "length_km"]),
    ("univariate", Part::Univariate, &["variable", "sigma", "length_km"]),
    ("white", Part::White, &["variable", "sigma"]),
];

/// Reads a table of components.
pub(super) fn read(field: &Field<'_>, model: &ModelSettings) -> Read<Vec<CovarianceComponent>> {
    let components = field.section(&["components"])?.required("components")?;
    components.elements(20)?.iter().map(|element| component(element, model)).collect()
}

fn component(field: &Field<'_>, model: &ModelSettings) -> Read<CovarianceComponent> {
    let (part, section) = field.section_of_kind(KINDS)?;
    let length_m = || Ok(section.number("length_km", Limits::Between(1e-3, 1e5))? * 1e3);
    let variable = || variable(&section.required("variable")?, model);
    let sigma = || section.number("sigma", Limits::Positive);
    match part {
        Part::Balanced if !model.is_rotating() => {
            let kind = section.required("kind")?;
            let message = "a balanced covariance needs a shallow-water model with coriolis_per_s other than 0".into();
            Err(kind.invalid(message, "must be \"univariate\" or \"white\" for this model"))
        }
        Part::Balanced => Ok(CovarianceComponent::Balanced {
            sigma_height_m: section.number("sigma_height_m", Limits::Positive)?,
            length_m: length_m()?,
        }),
        Part::Univariate => {
            Ok(CovarianceComponent::Univariate { variable: variable()?, sigma: sigma()?, length_m: length_m()? })
        }
        Part::White => Ok(CovarianceComponent::White { variable: variable()?, sigma: sigma()? }),
    }
}

/// The name of one of the model's variables.
pub(super) fn variable(field: &Field<'_>, model: &ModelSettings) -> Read<String> {
    let names: Vec<(&str, &str)> = model.variables().iter().map(|&(name, _)| (name, name)).collect();
    Ok(field.choice(&names)?.to_string())
}
