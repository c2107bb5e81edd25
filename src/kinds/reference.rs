//! The reference of kinds and keys, from what the reader checks.

use super::{Kinds, covariances, forecast, initial, instruments, methods, models};
use crate::reader::AnyKey;
use std::fmt::Write;

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
    pub meaning: &'static str,
}

/// All lists of kinds.
pub fn all() -> Vec<Reference> {
    let reference = |option, title, place, kinds| Reference { option, title, place, kinds };
    vec![
        reference("methods", "Methods", "`[methods.NAME]`", kinds(methods::METHODS)),
        reference("instruments", "Instruments", "`[networks.NAME]`", kinds(instruments::INSTRUMENTS)),
        reference("models", "Models", "`[model]`", kinds(models::MODELS)),
        reference("initial", "Initial states", "`[initial]` or `[truth.initial]`", kinds(initial::INITIAL)),
        reference(
            "covariances",
            "Covariances",
            "an element of `components` in `[background_error]` or `[model_error]`",
            kinds(covariances::COVARIANCES),
        ),
    ]
}

fn kinds<T: ?Sized, C: ?Sized>(kinds: &Kinds<T, C>) -> Vec<KindReference> {
    let kind = |kind: &&'static super::Kind<T, C>| KindReference {
        name: kind.name,
        about: kind.about,
        keys: kind.keys().flat_map(|key| keys("", key)).collect(),
    };
    kinds.iter().map(kind).collect()
}

/// The tables that are of one kind only, with what they say.
fn sections() -> Vec<(&'static str, &'static str, &'static [&'static dyn AnyKey])> {
    vec![(
        "`[forecast]`",
        "Forecasts ahead of the analyses of all methods, and their scores by lead time",
        forecast::KEYS,
    )]
}

/// A key, and after it those of a value that is a table.
fn keys(before: &str, key: &dyn AnyKey) -> Vec<KeyReference> {
    let name = format!("{before}{}", key.name());
    let inner = key.inner().iter().flat_map(|&inner| keys(&format!("{name}."), inner)).collect::<Vec<_>>();
    let default = key.default().unwrap_or_else(|| "must be given".into());
    let own = KeyReference { name, unit: key.unit(), allowed: key.allowed(), default, meaning: key.meaning() };
    std::iter::once(own).chain(inner).collect()
}

/// The whole reference, as `scenarios/KEYS.md` holds it.
pub fn markdown() -> String {
    let mut text = String::from(
        "# Kinds and their keys\n\nWritten from the program by `ISOBAR_WRITE=1 cargo test --release -p isobar --test all keys`; \
         `isobar list --methods letkf` and the like show the same.\n",
    );
    for reference in all() {
        write!(text, "\n## {}\n\n`kind` of {}.\n", reference.title, reference.place).expect("a String takes any text");
        for kind in reference.kinds {
            write!(text, "\n### `{}`\n\n{}.\n", kind.name, kind.about).expect("a String takes any text");
            text.push_str(&rows(kind.keys));
        }
    }
    text.push_str("\n## Tables without a kind\n");
    for (name, about, of_section) in sections() {
        write!(text, "\n### {name}\n\n{about}.\n").expect("a String takes any text");
        text.push_str(&rows(of_section.iter().flat_map(|&key| keys("", key)).collect()));
    }
    text
}

/// Keys as a table.
fn rows(keys: Vec<KeyReference>) -> String {
    let mut text = String::new();
    if !keys.is_empty() {
        text.push_str("\n| key | unit | value | default | meaning |\n|---|---|---|---|---|\n");
    }
    for KeyReference { name, unit, allowed, default, meaning } in keys {
        writeln!(text, "| `{name}` | {unit} | {allowed} | {default} | {meaning} |").expect("a String takes any text");
    }
    text
}
