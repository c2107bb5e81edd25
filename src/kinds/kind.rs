//! What every kind of thing that a scenario chooses by name is, and how one is chosen.

pub(crate) use crate::reader::KIND;
use crate::reader::{AnyKey, Field, Form, KindForm, Read, Section};
use crate::text::clean;

/// A kind of thing that a scenario chooses by name: reads a `T` from its section, in a scenario that otherwise is `C`.
pub(crate) struct Kind<T: ?Sized, C: ?Sized> {
    /// What a scenario calls it.
    pub name: &'static str,
    /// What it is, in a line.
    pub about: &'static str,
    /// Its keys, without the one that names the kind: lists, one after another.
    keys: &'static [&'static [&'static dyn AnyKey]],
    /// Whether it can be chosen in this scenario at all.
    fits: fn(&C) -> bool,
    /// Reads a section that has these keys at most.
    pub read: fn(&Section<'_>, &C) -> Read<Box<T>>,
}

impl<T: ?Sized, C: ?Sized> Kind<T, C> {
    /// A kind of this name, in a line, with these lists of keys, and what reads it.
    pub const fn new(
        name: &'static str,
        about: &'static str,
        keys: &'static [&'static [&'static dyn AnyKey]],
        read: fn(&Section<'_>, &C) -> Read<Box<T>>,
    ) -> Self {
        Self { name, about, keys, fits: |_| true, read }
    }

    /// The same, for some scenarios only.
    pub const fn only_if(self, fits: fn(&C) -> bool) -> Self {
        Self { fits, ..self }
    }

    /// Its keys, without the one that names the kind.
    pub fn keys(&self) -> impl Iterator<Item = &'static dyn AnyKey> {
        self.keys.iter().flat_map(|keys| keys.iter().copied())
    }
}

/// A list of kinds, as a scenario may choose from it.
pub(crate) type Kinds<T, C> = [&'static Kind<T, C>];

/// What can be said of kinds from outside.
pub(crate) fn forms<T: ?Sized, C: ?Sized>(kinds: &Kinds<T, C>) -> Vec<KindForm> {
    kinds.iter().map(|kind| KindForm { name: kind.name, about: kind.about, keys: kind.keys().collect() }).collect()
}

/// The form of a table of one of the kinds, which its key `kind` says.
pub(crate) fn form<T: ?Sized, C: ?Sized>(kinds: &Kinds<T, C>) -> Form {
    Form::Kinds(KIND, forms(kinds))
}

/// The kind that a table names by its key `kind`, and the table, checked for keys that the kind does not have.
pub(crate) fn choose<'a, T: ?Sized, C: ?Sized>(
    field: &Field<'a>,
    kinds: &Kinds<T, C>,
    context: &C,
) -> Read<(&'static Kind<T, C>, Section<'a>)> {
    choose_by(KIND, field, kinds, context)
}

/// The same, where another key names the kind.
pub(crate) fn choose_by<'a, T: ?Sized, C: ?Sized>(
    key: &str,
    field: &Field<'a>,
    kinds: &Kinds<T, C>,
    context: &C,
) -> Read<(&'static Kind<T, C>, Section<'a>)> {
    let names = |kind: &Kind<T, C>| kind.keys().map(|key| key.name()).collect::<Vec<_>>();
    let fitting = kinds.iter().filter(|kind| (kind.fits)(context));
    let choices: Vec<_> = fitting.map(|&kind| (kind.name, kind, names(kind))).collect();
    field.section_by(key, &choices)
}

/// Reads a table that chooses one of the kinds.
pub(crate) fn read<T: ?Sized, C: ?Sized>(field: &Field<'_>, kinds: &Kinds<T, C>, context: &C) -> Read<Box<T>> {
    let (kind, section) = choose(field, kinds, context)?;
    (kind.read)(&section, context)
}

/// Refuses a name that could not be part of a file's name or of a parameter's.
pub(crate) fn check_name(name: &str, field: &Field<'_>, what: &str) -> Read<()> {
    plain_name(name, what).map_err(|(message, help)| field.misplaced(message, help))
}

/// As [`check_name`], for a name that stands in no file.
///
/// # Errors
/// What is wrong, and what a name is.
pub(crate) fn plain_name(name: &str, what: &str) -> Result<(), (String, &'static str)> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    if name.is_empty() || name.len() > 40 || !name.chars().all(plain) || name.starts_with('-') {
        let message = format!("\"{}\" cannot be the name of a {what}", clean(name));
        return Err((message, "a name has 1 to 40 letters a-z, A-Z, digits, underscores and hyphens"));
    }
    Ok(())
}

/// Refuses a name that leads to the same names of files as another of its kind: without regard to case, which some file
/// systems do not distinguish, and with an underscore for a hyphen.
///
/// # Errors
/// What is wrong, and what to do.
pub(crate) fn distinct_name<'a>(
    name: &str,
    mut others: impl Iterator<Item = &'a str>,
    what: &str,
) -> Result<(), (String, &'static str)> {
    let of_files = |name: &str| name.to_ascii_lowercase().replace('-', "_");
    let help = "choose another name";
    match others.find(|other| of_files(other) == of_files(name)) {
        None => Ok(()),
        Some(other) if other == name => Err((format!("there are two {what}s `{name}`"), help)),
        Some(other) if other.eq_ignore_ascii_case(name) => {
            Err((format!("the {what}s `{other}` and `{name}` differ in case only"), help))
        }
        Some(other) => Err((
            format!("the {what}s `{other}` and `{name}` differ only in hyphens and underscores, or in case"),
            help,
        )),
    }
}
