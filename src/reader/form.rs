//! The forms that the values of keys have, for whoever looks at a scenario without reading it: the reference of keys, and
//! editors by way of a JSON schema.

use super::{AnyKey, Limits};

/// The key by which a table names its kind, of those in a list.
pub(crate) const KIND: &str = "kind";

/// The form of a value. It says less than the reader checks, which knows the rest of the file.
#[derive(Clone)]
pub(crate) enum Form {
    /// A number within limits.
    Number(Limits),
    /// A whole number from the first to the second, both included.
    Whole(i64, i64),
    /// True or false.
    YesNo,
    /// One of these texts.
    Words(Vec<&'static str>),
    /// A text.
    Text,
    /// A date and time, or a text that says one.
    Time,
    /// Any number of values of this form.
    List(Box<Form>),
    /// A table with these keys.
    Table(&'static [&'static dyn AnyKey]),
    /// A table of one of these kinds, which the key says.
    Kinds(&'static str, Vec<KindForm>),
    /// A table of one of the kinds in the list of this name, which its key `kind` says.
    Listed(&'static str),
    /// A table with some keys of any kind in the list of this name, and perhaps with its key `kind`.
    PartOf(&'static str),
    /// A table with these keys, and others whose names the file chooses and whose values have this form.
    Named(&'static [&'static dyn AnyKey], Box<Form>),
    /// A table with some of these keys.
    Entries(Vec<(&'static str, Form)>),
    /// Any of these.
    Any(Vec<Form>),
    /// Whatever the key that it stands for takes.
    Free,
}

/// A kind, by what can be said of it from outside.
#[derive(Clone)]
pub(crate) struct KindForm {
    /// What a scenario calls it.
    pub name: &'static str,
    /// What it is, in a line.
    pub about: &'static str,
    /// Its keys, without the one that names the kind.
    pub keys: Vec<&'static dyn AnyKey>,
}

impl Form {
    /// A text.
    pub fn text() -> Self {
        Form::Text
    }

    /// A list of texts.
    pub fn texts() -> Self {
        Form::list(Form::Text)
    }

    /// A list of numbers.
    pub fn numbers() -> Self {
        Form::list(Form::Number(Limits::Any))
    }

    /// A table of numbers greater than 0 with names that the file chooses.
    pub fn named_numbers() -> Self {
        Form::Named(&[], Box::new(Form::Number(Limits::Positive)))
    }

    /// A list of values of a form.
    pub fn list(of: Form) -> Self {
        Form::List(Box::new(of))
    }
}
