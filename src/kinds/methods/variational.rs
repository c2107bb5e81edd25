//! The settings that variational methods share.

use super::COVARIANCE_SCALE;
use crate::reader::{Absent, AnyKey, Key, Limits, Read, Section, Whole};
use isobar_assim::variational::ThreeDVarSettings;

const MAX_ITERATIONS: Key<Whole> = Key::absent(
    "max_iterations",
    "",
    Whole(1, 100_000),
    Absent::Means(100),
    "most iterations of the conjugate gradients",
);

const TOLERANCE: Key<Limits> = Key::absent(
    "tolerance",
    "",
    Limits::Between(1e-15, 0.5),
    Absent::Means(1e-6),
    "share of its first norm to which the gradient is reduced",
);

/// The keys of the minimisation.
pub(super) const KEYS: &[&dyn AnyKey] = &[&COVARIANCE_SCALE, &MAX_ITERATIONS, &TOLERANCE];

/// Reads the minimisation.
pub(super) fn read(section: &Section<'_>) -> Read<ThreeDVarSettings> {
    Ok(ThreeDVarSettings {
        covariance_scale: section.get(&COVARIANCE_SCALE)?,
        max_iterations: section.get(&MAX_ITERATIONS)?,
        tolerance: section.get(&TOLERANCE)?,
    })
}
