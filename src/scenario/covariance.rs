//! `[background_error]` and `[model_error]`: covariances as sums of components.

use super::fields;
use super::model::ModelSettings;
use super::reader::{Field, Kind, Limits, Read};
use isobar_assim::covariance::CorrelationFunction;
use isobar_model::Grid;

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
    /// One variable with a correlation that is a function of the shortest distance.
    ByDistance {
        /// Name of the variable.
        variable: String,
        /// The function.
        correlation: CorrelationFunction,
        /// Standard deviation, in the variable's unit.
        sigma: f64,
        /// Correlation length \[m\].
        length_m: f64,
        /// Fraction of the variance that is not correlated from point to point.
        uncorrelated_fraction: f64,
    },
    /// The covariance of the members of an ensemble, of one variable.
    Members {
        /// Name of the variable.
        variable: String,
        /// A field `[y, x]` for each member.
        members: Vec<Vec<f64>>,
        /// Where the taper of correlations ends, if they are tapered \[m\].
        localization_radius_m: Option<f64>,
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
    ByDistance,
    Members,
    White,
}

const KINDS: &[Kind<Part>] = &[
    ("balanced", Part::Balanced, &["sigma_height_m", "length_km"]),
    ("univariate", Part::Univariate, &["variable", "sigma", "length_km"]),
    ("by_distance", Part::ByDistance, &["variable", "correlation", "sigma", "length_km", "uncorrelated_fraction"]),
    ("members", Part::Members, &["variable", "file", "localization_radius_km"]),
    ("white", Part::White, &["variable", "sigma"]),
];

const CORRELATIONS: &[(&str, CorrelationFunction)] = &[
    ("gaussian", CorrelationFunction::Gaussian),
    ("exponential", CorrelationFunction::Exponential),
    ("second_order_autoregressive", CorrelationFunction::SecondOrderAutoregressive),
    ("third_order_autoregressive", CorrelationFunction::ThirdOrderAutoregressive),
    ("gaspari_cohn", CorrelationFunction::GaspariCohn),
];

/// The most members in a file.
const MOST_MEMBERS: usize = 1000;

/// Reads a table of components.
pub(super) fn read(field: &Field<'_>, model: &ModelSettings, grid: &Grid) -> Read<Vec<CovarianceComponent>> {
    let components = field.section(&["components"])?.required("components")?;
    components.elements(20)?.iter().map(|element| component(element, model, grid)).collect()
}

fn component(field: &Field<'_>, model: &ModelSettings, grid: &Grid) -> Read<CovarianceComponent> {
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
        Part::ByDistance => Ok(CovarianceComponent::ByDistance {
            variable: variable()?,
            correlation: section.required("correlation")?.choice(CORRELATIONS)?,
            sigma: sigma()?,
            length_m: length_m()?,
            uncorrelated_fraction: section.number_or("uncorrelated_fraction", 0.0, Limits::Fraction)?,
        }),
        Part::Members => {
            let file = section.required("file")?;
            let members = fields::read(&file, grid, MOST_MEMBERS)?.columns;
            if members.len() < 2 {
                return Err(file.invalid("one member has no covariance".into(), "needs two columns or more"));
            }
            let radius = section.optional("localization_radius_km");
            let radius_km = radius.map(|field| field.number(Limits::Between(1e-3, 1e6))).transpose()?;
            let localization_radius_m = radius_km.map(|km| km * 1e3);
            Ok(CovarianceComponent::Members { variable: variable()?, members, localization_radius_m })
        }
        Part::White => Ok(CovarianceComponent::White { variable: variable()?, sigma: sigma()? }),
    }
}

/// The name of one of the model's variables.
pub(super) fn variable(field: &Field<'_>, model: &ModelSettings) -> Read<String> {
    let names: Vec<(&str, &str)> = model.variables().iter().map(|&(name, _)| (name, name)).collect();
    Ok(field.choice(&names)?.to_string())
}
