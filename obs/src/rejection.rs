//! Why observations fail quality control.

use serde::{Deserialize, Serialize};

/// Why an observation is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Rejection {
    /// Its value or its error is not finite.
    NotFinite = 1,
    /// It lies outside of the domain.
    Outside = 2,
    /// It is not valid at the time of the analysis.
    Late = 3,
    /// There is one of the same platform and variable already.
    Duplicate = 4,
    /// No state could have such a value.
    Absurd = 5,
    /// It contradicts its neighbours.
    GrossError = 6,
    /// The value of a predictor of its bias is missing.
    NoPredictor = 7,
}

impl Rejection {
    /// All reasons, in the order of their codes from 1.
    pub const ALL: [Rejection; 7] = [
        Rejection::NotFinite,
        Rejection::Outside,
        Rejection::Late,
        Rejection::Duplicate,
        Rejection::Absurd,
        Rejection::GrossError,
        Rejection::NoPredictor,
    ];

    /// Its code, from 1; 0 is the code of an observation that is used.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// Its name, in one word: `not_finite`.
    pub fn name(self) -> &'static str {
        match self {
            Rejection::NotFinite => "not_finite",
            Rejection::Outside => "outside",
            Rejection::Late => "late",
            Rejection::Duplicate => "duplicate",
            Rejection::Absurd => "absurd",
            Rejection::GrossError => "gross_error",
            Rejection::NoPredictor => "no_predictor",
        }
    }
}
