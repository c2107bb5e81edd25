//! A table of the file.

use super::{Absent, AnyKey, Field, Key, Limits, Read, ScenarioError, SourceFile, Value};
use crate::text::{clean, listed, nearest};
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table whose keys are all known.
#[derive(Clone)]
pub(crate) struct Section<'a> {
    pub file: &'a SourceFile,
    /// Dotted name, `networks.europe`; empty for the whole file.
    pub name: String,
    pub table: &'a DeTable<'a>,
    pub span: Range<usize>,
}

impl<'a> Section<'a> {
    /// The whole file.
    pub fn root(file: &'a SourceFile, root: &'a DeTable<'a>) -> Self {
        Section { file, name: String::new(), table: root, span: 0..0 }
    }

    /// Refuses any key that is not among `keys`; `elsewhere` lists the keys of other kinds of this table.
    pub(super) fn check_keys(&self, keys: &[&str], elsewhere: &[(&str, &[&str])]) -> Read<()> {
        self.unknown_keys(keys, elsewhere).next().map_or(Ok(()), |(_, fault)| Err(fault))
    }

    /// Refuses all keys that are not among these.
    pub fn check_names(&self, keys: &[&dyn AnyKey]) -> Read<()> {
        let names: Vec<&str> = keys.iter().map(|key| key.name()).collect();
        ScenarioError::of_all(self.unknown_keys(&names, &[]).map(|(_, fault)| fault)).map_or(Ok(()), Err)
    }

    /// A fault for each key that is not among `keys`, and the key that may be meant.
    pub(super) fn unknown_keys<'b>(
        &'b self,
        keys: &'b [&'b str],
        elsewhere: &'b [(&'b str, &'b [&'b str])],
    ) -> impl Iterator<Item = (Option<&'b str>, ScenarioError)> + 'b {
        let unknown = self.table.keys().filter(|key| !keys.contains(&key.get_ref().as_ref()));
        unknown.map(move |key| {
            let word: &str = key.get_ref();
            let place = if self.name.is_empty() { "at the top level".into() } else { format!("in [{}]", self.title()) };
            let message = format!("unknown key `{}` {place}", clean(word));
            let kinds: Vec<_> = elsewhere
                .iter()
                .filter(|(_, keys)| keys.contains(&word))
                .map(|(kind, _)| format!("\"{kind}\""))
                .collect();
            let near = nearest(word, keys.iter().copied());
            let mut help = match near {
                Some(near) => format!("did you mean `{near}`?\n"),
                None if !kinds.is_empty() => format!("`{}` belongs to kind {}\n", clean(word), kinds.join(", ")),
                None => String::new(),
            };
            match keys {
                [] => help.push_str("this table takes no keys"),
                _ => help.push_str(&format!("valid keys here: {}", listed(keys.iter().copied()))),
            }
            (near, self.file.error(key.span(), message, "not a key of this table", Some(help)))
        })
    }

    /// The name as messages show it.
    pub fn title(&self) -> String {
        clean(&self.name)
    }

    /// A key that may be absent.
    pub fn optional(&self, key: &str) -> Option<Field<'a>> {
        let (key_token, value) = self.table.iter().find(|(token, _)| token.get_ref() == key)?;
        Some(self.field(key_token, value))
    }

    /// A key that must be present.
    pub fn required(&self, key: &str) -> Read<Field<'a>> {
        match self.optional(key) {
            Some(field) => Ok(field),
            None => Err(self.missing(key)),
        }
    }

    /// The fault of a key that is not there.
    pub(super) fn missing(&self, key: &str) -> ScenarioError {
        if !self.name.is_empty() {
            let message = format!("`{key}` is missing in [{}]", self.title());
            let label = format!("`{key}` must be given here");
            return self.file.error(self.span.clone(), message, &label, None).of_absence();
        }
        let is_line = matches!(key, "title" | "phenomenon" | "source" | "seed" | "start");
        let shown = if is_line { format!("`{key}`") } else { format!("[{key}]") };
        let help = is_line.then(|| "it belongs above the first [section]".to_string());
        self.file
            .error(0..0, format!("{shown} is missing"), &format!("{shown} must be in this file"), help)
            .of_absence()
    }

    /// The value of a key, or its default.
    pub fn get<V: Value>(&self, key: &Key<V>) -> Read<V::Output>
    where
        V::Output: Clone,
    {
        match (self.find(key)?, &key.absent) {
            (Some(value), _) => Ok(value),
            (None, Absent::Means(value)) => Ok(value.clone()),
            (None, _) => Err(self.missing(key.name)),
        }
    }

    /// The value of a key, if it is given.
    pub fn find<V: Value>(&self, key: &Key<V>) -> Read<Option<V::Output>> {
        self.optional(key.name).map(|field| key.allowed.read(&field)).transpose()
    }

    /// A number that must be given.
    pub fn number(&self, key: &str, limits: Limits) -> Read<f64> {
        self.required(key)?.number(limits)
    }

    /// A whole number with a default.
    pub fn whole_or(&self, key: &str, default: usize, least: usize, most: usize) -> Read<usize> {
        self.optional(key).map_or(Ok(default), |field| field.whole(least, most))
    }

    /// Yes or no, with a default.
    pub fn yes_or_no_or(&self, key: &str, default: bool) -> Read<bool> {
        self.optional(key).map_or(Ok(default), |field| field.yes_or_no())
    }

    /// All keys in the order of the file.
    pub fn fields(&self) -> impl Iterator<Item = (&'a str, Field<'a>)> + '_ {
        let table: &'a DeTable<'a> = self.table;
        table.iter().map(|(key, value)| (key.get_ref().as_ref(), self.field(key, value)))
    }

    pub(super) fn field(&self, key: &'a Spanned<toml::de::DeString<'a>>, value: &'a Spanned<DeValue<'a>>) -> Field<'a> {
        let word: &str = key.get_ref();
        let name = if self.name.is_empty() { word.to_string() } else { format!("{}.{word}", self.name) };
        Field { file: self.file, name, key_span: key.span(), value }
    }
}

/// Reads the tree of a file.
pub(crate) fn parse<'a>(file: &SourceFile, text: &'a str) -> Read<DeTable<'a>> {
    match DeTable::parse(text) {
        Ok(root) => Ok(root.into_inner()),
        Err(error) => {
            let message = format!("this is not valid TOML: {}", clean(error.message()));
            Err(file.error(error.span().unwrap_or(0..0), message, "here", None))
        }
    }
}
