//! What a scenario chooses by name: each kind is a value, in a file of its own, that knows its name, its keys and how it
//! is read; what it reads is built into the libraries' objects.
//!
//! A new kind is a file, and a line in the list of its folder: the reader, its messages, `isobar list` and
//! `scenarios/KEYS.md` go over these lists.

pub mod covariances;
mod domain;
pub(crate) mod forcing;
pub(crate) mod forecast;
pub mod initial;
pub(crate) mod instruments;
mod kind;
mod lists;
pub mod methods;
pub mod models;
pub(crate) mod pattern;
pub(crate) mod warnings;

pub use domain::Domain;
pub(crate) use kind::{KIND, Kind, Kinds, check_name, choose, choose_by, distinct_name, form, forms, plain_name, read};
pub(crate) use lists::list;

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    fn check<T: ?Sized, C: ?Sized>(kinds: &Kinds<T, C>) {
        let names: HashSet<_> = kinds.iter().map(|kind| kind.name).collect();
        assert_eq!(names.len(), kinds.len(), "two kinds have one name");
        for kind in kinds {
            let keys: Vec<_> = kind.keys().collect();
            let names: HashSet<_> = keys.iter().map(|key| key.name()).collect();
            assert_eq!(names.len(), keys.len(), "{} has a key twice", kind.name);
            for words in keys.iter().map(|key| key.meaning()).chain([kind.about]) {
                assert!(!words.is_empty() && !words.ends_with('.'), "{}: {words:?} is not a phrase", kind.name);
            }
        }
    }

    #[test]
    fn kinds_and_keys_have_names_of_their_own_and_are_described() {
        check(methods::METHODS);
        check(models::MODELS);
        check(initial::INITIAL);
        check(covariances::COVARIANCES);
        check(instruments::INSTRUMENTS);
        check(pattern::PATTERNS);
        check(forcing::FUNCTIONS);
    }
}
