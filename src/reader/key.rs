//! What a key of a section means, what it may be, and what holds without it: each stands once.

use super::{Field, Form, Limits, Read};
use crate::text::{clean, listed, nearest};
use toml::de::DeValue;

/// A key of a section, as the reader checks it and the reference of keys describes it.
pub(crate) struct Key<V: Allowed> {
    /// Its name in the file.
    pub name: &'static str,
    /// The unit of its value; empty if it has none.
    pub unit: &'static str,
    /// What its value may be.
    pub allowed: V,
    /// What holds without it.
    pub absent: Absent<V::Output>,
    /// What it means, in a phrase.
    pub meaning: &'static str,
}

/// What holds where a key is not given.
pub(crate) enum Absent<T> {
    /// The key must be given.
    Refused,
    /// It has this value.
    Means(T),
    /// In words: something that follows from the rest of the file.
    Explained(&'static str),
}

/// What the value of a key may be.
pub(crate) trait Allowed: Sync {
    /// The value that is read.
    type Output: Send + Sync;

    /// What is allowed, as it stands after "must be".
    fn words(&self) -> String;

    /// A default, as the file would give it.
    fn show(&self, value: &Self::Output) -> String;

    /// The form of the value.
    fn form(&self) -> Form;
}

/// A value that can be read without any knowledge of the rest of the file.
pub(crate) trait Value: Allowed {
    /// Reads and checks it.
    fn read(&self, field: &Field<'_>) -> Read<Self::Output>;
}

/// A whole number from the first to the second, both included.
pub(crate) struct Whole(pub usize, pub usize);

/// A whole number from the first to the second, both included, negative or not.
pub(crate) struct Integer(pub i64, pub i64);

/// True or false.
pub(crate) struct YesNo;

/// One of the words, as what it stands for.
pub(crate) struct Choice<T: 'static>(pub &'static [(&'static str, T)]);

/// This word, which is read as `None`, or something else.
pub(crate) struct OrWord<V>(pub &'static str, pub V);

/// A plain value, or a table with these keys.
pub(crate) struct OrTable<V>(pub V, pub &'static [&'static dyn AnyKey]);

/// A list, table or anything else that has its own reader: in words, and its form.
pub(crate) struct Described(pub &'static str, pub fn() -> Form);

/// A table with these keys.
pub(crate) struct Table(pub &'static [&'static dyn AnyKey]);

impl<V: Allowed> Key<V> {
    /// A key that must be given.
    pub const fn required(name: &'static str, unit: &'static str, allowed: V, meaning: &'static str) -> Self {
        Self { name, unit, allowed, absent: Absent::Refused, meaning }
    }

    /// The same key where something else holds in its absence.
    pub const fn absent(
        name: &'static str,
        unit: &'static str,
        allowed: V,
        absent: Absent<V::Output>,
        meaning: &'static str,
    ) -> Self {
        Self { name, unit, allowed, absent, meaning }
    }
}

/// Any key, as the reference of keys shows it.
pub(crate) trait AnyKey: Sync {
    /// Its name in the file.
    fn name(&self) -> &'static str;
    /// The unit of its value; empty if it has none.
    fn unit(&self) -> &'static str;
    /// What its value may be.
    fn allowed(&self) -> String;
    /// What holds without it; `None` if it must be given.
    fn default(&self) -> Option<String>;
    /// What it means, in a phrase.
    fn meaning(&self) -> &'static str;
    /// The form of its value.
    fn form(&self) -> Form;
}

impl<V: Allowed> AnyKey for Key<V> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn unit(&self) -> &'static str {
        self.unit
    }

    fn allowed(&self) -> String {
        self.allowed.words()
    }

    fn default(&self) -> Option<String> {
        match &self.absent {
            Absent::Refused => None,
            Absent::Means(value) => Some(self.allowed.show(value)),
            Absent::Explained(words) => Some(words.to_string()),
        }
    }

    fn meaning(&self) -> &'static str {
        self.meaning
    }

    fn form(&self) -> Form {
        self.allowed.form()
    }
}

impl Allowed for Limits {
    type Output = f64;

    fn words(&self) -> String {
        Limits::words(self)
    }

    fn show(&self, value: &f64) -> String {
        value.to_string()
    }

    fn form(&self) -> Form {
        Form::Number(*self)
    }
}

impl Value for Limits {
    fn read(&self, field: &Field<'_>) -> Read<f64> {
        field.number(*self)
    }
}

impl Allowed for Whole {
    type Output = usize;

    fn words(&self) -> String {
        format!("a whole number from {} to {}", self.0, self.1)
    }

    fn show(&self, value: &usize) -> String {
        value.to_string()
    }

    fn form(&self) -> Form {
        Form::Whole(self.0 as i64, self.1 as i64)
    }
}

impl Value for Whole {
    fn read(&self, field: &Field<'_>) -> Read<usize> {
        field.whole(self.0, self.1)
    }
}

impl Allowed for Integer {
    type Output = i64;

    fn words(&self) -> String {
        format!("a whole number from {} to {}", self.0, self.1)
    }

    fn show(&self, value: &i64) -> String {
        value.to_string()
    }

    fn form(&self) -> Form {
        Form::Whole(self.0, self.1)
    }
}

impl Value for Integer {
    fn read(&self, field: &Field<'_>) -> Read<i64> {
        field.integer(self.0, self.1)
    }
}

impl Allowed for YesNo {
    type Output = bool;

    fn words(&self) -> String {
        "true or false".into()
    }

    fn show(&self, value: &bool) -> String {
        value.to_string()
    }

    fn form(&self) -> Form {
        Form::YesNo
    }
}

impl Value for YesNo {
    fn read(&self, field: &Field<'_>) -> Read<bool> {
        field.yes_or_no()
    }
}

impl<T: Copy + PartialEq + Send + Sync> Allowed for Choice<T> {
    type Output = T;

    fn words(&self) -> String {
        match self.0 {
            [(only, _)] => format!("\"{only}\""),
            words => format!("one of {}", listed(words.iter().map(|(word, _)| *word))),
        }
    }

    fn show(&self, value: &T) -> String {
        self.0.iter().find(|(_, meaning)| meaning == value).map_or(String::new(), |(word, _)| format!("\"{word}\""))
    }

    fn form(&self) -> Form {
        Form::Words(self.0.iter().map(|(word, _)| *word).collect())
    }
}

impl<T: Copy + PartialEq + Send + Sync> Value for Choice<T> {
    fn read(&self, field: &Field<'_>) -> Read<T> {
        field.choice(self.0)
    }
}

impl Allowed for Described {
    type Output = &'static str;

    fn words(&self) -> String {
        self.0.into()
    }

    fn show(&self, value: &&'static str) -> String {
        value.to_string()
    }

    fn form(&self) -> Form {
        (self.1)()
    }
}

impl Allowed for Table {
    type Output = &'static str;

    fn words(&self) -> String {
        "a table".into()
    }

    fn show(&self, value: &&'static str) -> String {
        value.to_string()
    }

    fn form(&self) -> Form {
        Form::Table(self.0)
    }
}

impl<V: Allowed> Allowed for OrWord<V> {
    type Output = Option<V::Output>;

    fn words(&self) -> String {
        format!("\"{}\" or {}", self.0, self.1.words())
    }

    fn show(&self, value: &Option<V::Output>) -> String {
        value.as_ref().map_or_else(|| format!("\"{}\"", self.0), |value| self.1.show(value))
    }

    fn form(&self) -> Form {
        Form::Any(vec![Form::Words(vec![self.0]), self.1.form()])
    }
}

impl<V: Value> Value for OrWord<V> {
    fn read(&self, field: &Field<'_>) -> Read<Option<V::Output>> {
        match field.value.get_ref() {
            DeValue::String(found) if *found == self.0 => Ok(None),
            DeValue::String(found) => {
                let message = format!("`{}` cannot be \"{}\"", field.title(), clean(found));
                let near = nearest(found, [self.0]).map(|near| format!("did you mean \"{near}\"?"));
                Err(field.file.error(field.value.span(), message, &format!("must be {}", self.words()), near))
            }
            _ => self.1.read(field).map(Some),
        }
    }
}

impl<V: Allowed> Allowed for OrTable<V> {
    type Output = V::Output;

    fn words(&self) -> String {
        format!("{}, or a table", self.0.words())
    }

    fn show(&self, value: &V::Output) -> String {
        self.0.show(value)
    }

    fn form(&self) -> Form {
        Form::Any(vec![self.0.form(), Form::Table(self.1)])
    }
}

impl<V: Value> OrTable<V> {
    /// Reads a value that is no table.
    pub fn read_plain(&self, field: &Field<'_>) -> Read<V::Output> {
        self.0.read(field)
    }
}
