//! The settings that ensemble methods share.

use super::{BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MEMORY_LIMIT_GB, SMOOTHER_LAG_CYCLES, Surroundings};
use crate::reader::{Absent, AnyKey, Choice, Key, Limits, OrWord, Read, Section, Whole};
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, Inflation, InitialMembers, LocalSettings, ModelErrorTreatment,
};

/// Why ensembles have no fixed gain.
pub(super) const RANDOM_GAIN: &str = "the gain of an ensemble is random";

const MEMBERS: Key<Whole> = Key::required("members", "", Whole(2, 100_000), "number of members");

const INITIAL_MEMBERS: Key<Choice<InitialMembers>> = Key::absent(
    "initial_members",
    "",
    Choice(&[("random", InitialMembers::Random), ("second_order_exact", InitialMembers::SecondOrderExact)]),
    Absent::Means(InitialMembers::Random),
    "how the first members are drawn",
);

const MODEL_ERROR_TREATMENT: Key<Choice<ModelErrorTreatment>> = Key::absent(
    "model_error_treatment",
    "",
    Choice(&[("random", ModelErrorTreatment::Random), ("square_root", ModelErrorTreatment::SquareRoot)]),
    Absent::Means(ModelErrorTreatment::Random),
    "how model error is added; a smoother needs random",
);

const INFLATION: Key<OrWord<Limits>> = Key::absent(
    "inflation",
    "",
    OrWord("adaptive", Limits::Between(0.5, 10.0)),
    Absent::Means(Some(1.0)),
    "factor on the background's perturbations, or found from the innovations",
);

const ADAPTIVE_INFLATION_SIGMA: Key<Limits> = Key::absent(
    "adaptive_inflation_sigma",
    "",
    Limits::Between(1e-6, 10.0),
    Absent::Means(0.04),
    "standard deviation of the prior of an adaptive inflation",
);

const RELAXATION_TO_SPREAD: Key<Limits> =
    relaxation("relaxation_to_prior_spread", "share of the background's spread that is given back (RTPS)");

const RELAXATION_TO_PERTURBATIONS: Key<Limits> = relaxation(
    "relaxation_to_prior_perturbations",
    "share of the background's perturbations that is given back (RTPP)",
);

const fn relaxation(name: &'static str, meaning: &'static str) -> Key<Limits> {
    Key::absent(name, "", Limits::Fraction, Absent::Means(0.0), meaning)
}

const ENSEMBLE_SEED: Key<Whole> = Key::absent(
    "ensemble_seed",
    "",
    Whole(0, u32::MAX as usize),
    Absent::Means(0),
    "seed of the method's random numbers",
);

const RADIUS: Limits = Limits::Between(1e-3, 1e9);

const RADIUS_KM: Key<Limits> =
    Key::required("localization_radius_km", "km", RADIUS, "distance from which observations have no effect");

const ANALYSIS_SPACING_CELLS: Key<Whole> = Key::absent(
    "analysis_spacing_cells",
    "cells",
    Whole(1, 1000),
    Absent::Means(1),
    "distance of the points for which weights are computed; between them they are interpolated",
);

/// The radius of a method that can do without localisation.
pub(super) const OPTIONAL_RADIUS_KM: Key<Limits> = Key::absent(
    "localization_radius_km",
    "km",
    RADIUS,
    Absent::Explained("no localisation"),
    "distance at which the taper of the covariances ends",
);

/// The keys of all ensembles.
pub(super) const KEYS: &[&dyn AnyKey] = &[
    &BIAS,
    &ERROR_CORRELATION,
    &FIRST_GUESS,
    &COMPARISONS,
    &MEMBERS,
    &INITIAL_MEMBERS,
    &MODEL_ERROR_TREATMENT,
    &INFLATION,
    &ADAPTIVE_INFLATION_SIGMA,
    &RELAXATION_TO_SPREAD,
    &RELAXATION_TO_PERTURBATIONS,
    &ENSEMBLE_SEED,
    &MEMORY_LIMIT_GB,
];

/// The keys of local analyses.
pub(super) const LOCAL_KEYS: &[&dyn AnyKey] = &[&RADIUS_KM, &ANALYSIS_SPACING_CELLS];

/// Reads what all ensembles share.
pub(super) fn read(section: &Section<'_>) -> Read<EnsembleSettings> {
    Ok(EnsembleSettings {
        members: section.get(&MEMBERS)?,
        initial_members: section.get(&INITIAL_MEMBERS)?,
        model_error: section.get(&MODEL_ERROR_TREATMENT)?,
        inflation: Inflation {
            background: background_inflation(section)?,
            relaxation_to_prior_spread: section.get(&RELAXATION_TO_SPREAD)?,
            relaxation_to_prior_perturbations: section.get(&RELAXATION_TO_PERTURBATIONS)?,
        },
        seed: section.get(&ENSEMBLE_SEED)? as u64,
    })
}

/// The same for a method that may have a smoother, which needs members that go on from the earlier ones.
pub(super) fn read_with_smoother(section: &Section<'_>, surroundings: &Surroundings) -> Read<EnsembleSettings> {
    let settings = read(section)?;
    let smooths = section.optional(SMOOTHER_LAG_CYCLES.name).is_some() && surroundings.has_model_error;
    if let (Some(field), true, ModelErrorTreatment::SquareRoot) =
        (section.optional(MODEL_ERROR_TREATMENT.name), smooths, settings.model_error)
    {
        let message = format!("`{}` recombines the members, which a smoother cannot follow", field.title());
        return Err(field.misplaced(message, "must be \"random\", or leave out `smoother_lag_cycles`"));
    }
    Ok(settings)
}

/// A factor, or `"adaptive"`.
fn background_inflation(section: &Section<'_>) -> Read<BackgroundInflation> {
    let sigma = section.get(&ADAPTIVE_INFLATION_SIGMA)?;
    match (section.get(&INFLATION)?, section.optional(ADAPTIVE_INFLATION_SIGMA.name)) {
        (None, _) => Ok(BackgroundInflation::Adaptive { sigma }),
        (Some(factor), None) => Ok(BackgroundInflation::Factor(factor)),
        (Some(_), Some(field)) => {
            let help = "it needs inflation = \"adaptive\"";
            Err(field.misplaced("`adaptive_inflation_sigma` without adaptive inflation".into(), help))
        }
    }
}

/// Reads the localisation of local analyses.
pub(super) fn read_local(section: &Section<'_>) -> Read<LocalSettings> {
    Ok(LocalSettings {
        localization_radius_m: section.get(&RADIUS_KM)? * 1e3,
        analysis_spacing_cells: section.get(&ANALYSIS_SPACING_CELLS)?,
    })
}

/// An ensemble's settings in words.
pub(super) fn describe(settings: &EnsembleSettings) -> String {
    let mut words = format!("{} members", settings.members);
    if settings.initial_members == InitialMembers::SecondOrderExact {
        words.push_str(" drawn second-order exact");
    }
    if settings.model_error == ModelErrorTreatment::SquareRoot {
        words.push_str(", model error by square root");
    }
    let inflation = &settings.inflation;
    match inflation.background {
        BackgroundInflation::Factor(1.0) => {}
        BackgroundInflation::Factor(factor) => words.push_str(&format!(", inflation {factor}")),
        BackgroundInflation::Adaptive { .. } => words.push_str(", adaptive inflation"),
    }
    for (name, value) in
        [("RTPS", inflation.relaxation_to_prior_spread), ("RTPP", inflation.relaxation_to_prior_perturbations)]
    {
        if value > 0.0 {
            words.push_str(&format!(", {name} {value}"));
        }
    }
    words
}
