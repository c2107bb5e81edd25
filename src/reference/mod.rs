//! The reference of everything that a scenario may say, from what the reader checks: as a document, one key at a time, and
//! as a JSON schema.

mod find;
mod markdown;
mod schema;

pub use find::{Explanation, Unknown, explain, sections};
pub use markdown::markdown;
pub use schema::schema;

use crate::kinds::{KIND, list};
use crate::reader::{AnyKey, Form, KindForm};
use crate::scenario::keys;
use crate::text::listed;
use serde::Serialize;

/// A list of kinds, as the reference shows it.
pub struct Reference {
    /// The option of `isobar list` that shows it.
    pub option: &'static str,
    /// What its kinds are.
    pub title: &'static str,
    /// Where a scenario chooses one.
    pub place: &'static str,
    /// The kinds.
    pub kinds: Vec<KindReference>,
}

/// A kind, as the reference shows it.
pub struct KindReference {
    /// What a scenario calls it.
    pub name: &'static str,
    /// What it is, in a line.
    pub about: &'static str,
    /// Its keys.
    pub keys: Vec<KeyReference>,
}

/// A key, as the reference shows it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KeyReference {
    /// Its name; of a key in a table, after that of the table and a point.
    pub name: String,
    /// The unit of its value; empty if it has none.
    pub unit: &'static str,
    /// What its value may be.
    pub allowed: String,
    /// What holds without it.
    pub default: String,
    /// What it means.
    pub meaning: String,
}

/// The lists of kinds: option, title and place.
const LISTS: [(&str, &str, &str); 5] = [
    ("methods", "Methods", "`[methods.NAME]`"),
    ("instruments", "Instruments", "`[networks.NAME]`"),
    ("models", "Models", "`[model]`"),
    ("initial", "Initial states", "`[initial]` or `[truth.initial]`"),
    ("covariances", "Covariances", "an element of `components` in `[background_error]` or `[model_error]`"),
];

/// All lists of kinds.
pub fn all() -> Vec<Reference> {
    let kind = |kind: KindForm| KindReference {
        name: kind.name,
        about: kind.about,
        keys: kind.keys.into_iter().flat_map(|key| rows("", key)).collect(),
    };
    let reference = |(option, title, place)| Reference {
        option,
        title,
        place,
        kinds: list(option).into_iter().map(kind).collect(),
    };
    LISTS.map(reference).into()
}

/// A key, and after it those of a value that is a table.
fn rows(before: &str, key: &dyn AnyKey) -> Vec<KeyReference> {
    let own = row(format!("{before}{}", key.name()), key);
    let inner = inner(&format!("{}.", own.name), &key.form());
    std::iter::once(own).chain(inner).collect()
}

/// A key under this name.
fn row(name: String, key: &dyn AnyKey) -> KeyReference {
    let default = key.default().unwrap_or_else(|| "must be given".into());
    KeyReference { name, unit: key.unit(), allowed: key.allowed(), default, meaning: key.meaning().into() }
}

/// The keys of a value of this form. Those of kinds in a list stand there.
fn inner(before: &str, form: &Form) -> Vec<KeyReference> {
    match form {
        Form::List(of) => inner(before, of),
        Form::Any(forms) => forms.iter().flat_map(|form| inner(before, form)).collect(),
        Form::Table(keys) => keys.iter().flat_map(|&key| rows(before, key)).collect(),
        Form::Kinds(by, kinds) => of_kinds(before, by, kinds),
        Form::Named(keys, other) => {
            let fixed = keys.iter().flat_map(|&key| rows(before, key));
            fixed.chain(inner(&format!("{before}NAME."), other)).collect()
        }
        _ => Vec::new(),
    }
}

/// The key that says which kind a table is of, and those of all kinds: each says to which it belongs, unless it belongs to
/// all.
fn of_kinds(before: &str, by: &str, kinds: &[KindForm]) -> Vec<KeyReference> {
    let names = listed(kinds.iter().map(|kind| kind.name));
    let about: Vec<String> = kinds.iter().map(|kind| format!("{}: {}", kind.name, lower(kind.about))).collect();
    let mut all = vec![KeyReference {
        name: format!("{before}{by}"),
        unit: "",
        allowed: format!("one of {names}"),
        default: "must be given".into(),
        meaning: about.join("; "),
    }];
    for (key, of) in grouped(kinds.iter().flat_map(|kind| kind.keys.iter().map(|&key| (key, kind.name)))) {
        let mut rows = rows(before, key);
        if of.len() < kinds.len() {
            rows[0].meaning += &format!(" ({by} {})", of.join(", "));
        }
        all.extend(rows);
    }
    all
}

/// Keys with the kinds to which they belong: the same key of several kinds once.
fn grouped(
    keys: impl Iterator<Item = (&'static dyn AnyKey, &'static str)>,
) -> Vec<(&'static dyn AnyKey, Vec<&'static str>)> {
    let mut groups: Vec<(&'static dyn AnyKey, Vec<&'static str>)> = Vec::new();
    for (key, kind) in keys {
        let is_same = |other: &dyn AnyKey| row(String::new(), other) == row(String::new(), key);
        match groups.iter_mut().find(|(other, _)| other.name() == key.name() && is_same(*other)) {
            Some((_, kinds)) => kinds.push(kind),
            None => groups.push((key, vec![kind])),
        }
    }
    groups
}

/// A phrase within a sentence.
fn lower(phrase: &str) -> String {
    let mut letters = phrase.chars();
    // Not of abbreviations.
    let is_word = phrase.chars().nth(1).is_none_or(|second| second.is_lowercase() || second == ' ');
    letters.next().filter(|_| is_word).map_or(phrase.into(), |first| first.to_lowercase().chain(letters).collect())
}
