//! What speaks against the update of a parameter.

use super::Expected;
use std::fmt;

/// Why a parameter has no stable update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Doubt {
    /// No observation has it.
    Unobserved,
    /// The share of its prior variance that it still has.
    Undetermined(f64),
    /// How far its innovations go together from cycle to cycle.
    Red(Expected),
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unobserved => f.write_str("no observation has it"),
            Self::Undetermined(ratio) => {
                write!(f, "the observations leave {:.0} % of its prior variance", 100.0 * ratio)
            }
            Self::Red(Expected { value, tolerance, .. }) => write!(
                f,
                "its innovations stay on one side (correlation {value:.2}, at most {tolerance:.2} by chance): it changes \
                 faster than is assumed"
            ),
        }
    }
}
