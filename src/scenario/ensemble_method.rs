//! The settings of ensemble methods.

use crate::reader::{Limits, Read, Section};
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, Inflation, InitialMembers, LocalSettings, ModelErrorTreatment,
};
use toml::de::DeValue;

macro_rules! keys {
    ($($more:literal),*) => {
        [
            "bias",
            "members",
            "initial_members",
            "model_error_treatment",
            "inflation",
            "adaptive_inflation_sigma",
            "relaxation_to_prior_spread",
            "relaxation_to_prior_perturbations",
            "ensemble_seed",
            "memory_limit_gb",
            $($more),*
        ]
    };
}

/// Those with a smoother.
pub(super) const SMOOTHED_KEYS: [&str; 11] = keys!["smoother_lag_cycles"];

/// Those with a taper in observation space.
pub(super) const TAPERED_KEYS: [&str; 11] = keys!["localization_radius_km"];

/// Those with local analyses.
pub(super) const LOCAL_KEYS: [&str; 12] = keys!["localization_radius_km", "analysis_spacing_cells"];

/// Those of the hybrid.
pub(super) const HYBRID_KEYS: [&str; 16] = keys![
    "localization_radius_km",
    "analysis_spacing_cells",
    "ensemble_weight",
    "covariance_scale",
    "max_iterations",
    "tolerance"
];

/// What all of them have in common.
pub(super) fn read(section: &Section<'_>) -> Read<EnsembleSettings> {
    const INITIAL: &[(&str, InitialMembers)] =
        &[("random", InitialMembers::Random), ("second_order_exact", InitialMembers::SecondOrderExact)];
    const MODEL_ERROR: &[(&str, ModelErrorTreatment)] =
        &[("random", ModelErrorTreatment::Random), ("square_root", ModelErrorTreatment::SquareRoot)];
    let relaxation = |key| section.number_or(key, 0.0, Limits::Fraction);
    Ok(EnsembleSettings {
        members: section.required("members")?.whole(2, 100_000)?,
        initial_members: section
            .optional("initial_members")
            .map_or(Ok(InitialMembers::Random), |field| field.choice(INITIAL))?,
        model_error: section
            .optional("model_error_treatment")
            .map_or(Ok(ModelErrorTreatment::Random), |field| field.choice(MODEL_ERROR))?,
        inflation: Inflation {
            background: background_inflation(section)?,
            relaxation_to_prior_spread: relaxation("relaxation_to_prior_spread")?,
            relaxation_to_prior_perturbations: relaxation("relaxation_to_prior_perturbations")?,
        },
        seed: section.whole_or("ensemble_seed", 0, 0, u32::MAX as usize)? as u64,
    })
}

/// A factor, or `"adaptive"`.
fn background_inflation(section: &Section<'_>) -> Read<BackgroundInflation> {
    let sigma = section.number_or("adaptive_inflation_sigma", 0.04, Limits::Between(1e-6, 10.0))?;
    let field = section.optional("inflation");
    let adaptive = match &field {
        Some(field) if matches!(field.value.get_ref(), DeValue::String(_)) => {
            Some(field.choice(&[("adaptive", BackgroundInflation::Adaptive { sigma })])?)
        }
        _ => None,
    };
    if let (Some(sigma), None) = (section.optional("adaptive_inflation_sigma"), adaptive) {
        let help = "it needs inflation = \"adaptive\"";
        return Err(sigma.misplaced("`adaptive_inflation_sigma` without adaptive inflation".into(), help));
    }
    match (adaptive, field) {
        (Some(adaptive), _) => Ok(adaptive),
        (None, Some(field)) => Ok(BackgroundInflation::Factor(field.number(Limits::Between(0.5, 10.0))?)),
        (None, None) => Ok(BackgroundInflation::Factor(1.0)),
    }
}

/// The localisation of a local analysis.
pub(super) fn local(section: &Section<'_>) -> Read<LocalSettings> {
    Ok(LocalSettings {
        localization_radius_m: section.number("localization_radius_km", RADIUS_KM)? * 1e3,
        analysis_spacing_cells: section.whole_or("analysis_spacing_cells", 1, 1, 1000)?,
    })
}

/// The radius of a method that can do without localisation \[m\].
pub(super) fn optional_radius_m(section: &Section<'_>) -> Read<f64> {
    Ok(section.number_or("localization_radius_km", f64::INFINITY, RADIUS_KM)? * 1e3)
}

const RADIUS_KM: Limits = Limits::Between(1e-3, 1e9);
