//! The lists of kinds, by the names that forms and `isobar list` give them.

use super::{covariances, forms, initial, instruments, methods, models};
use crate::reader::KindForm;

/// The kinds of the list of this name.
pub(crate) fn list(name: &str) -> Vec<KindForm> {
    match name {
        "methods" => forms(methods::METHODS),
        "instruments" => forms(instruments::INSTRUMENTS),
        "models" => forms(models::MODELS),
        "initial" => forms(initial::INITIAL),
        "covariances" => forms(covariances::COVARIANCES),
        other => unreachable!("there is no list {other}"),
    }
}
