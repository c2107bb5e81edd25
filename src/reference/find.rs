//! What a dotted name means: `grid.dx_km`, `methods.letkf`, `networks.radiosonde.bias`.

use super::{AnyKey, Form, KeyReference, KindForm, grouped, inner, keys, list, row};
use crate::text::{clean, listed, nearest};
use std::fmt;

/// What a dotted name means.
#[derive(Debug)]
pub struct Explanation {
    /// The name.
    pub name: String,
    /// What it is, in a sentence without its point.
    pub about: String,
    /// The keys that it may be, with the kinds to which each belongs; one if it is the same in all; none if it is a kind.
    pub keys: Vec<(KeyReference, Vec<&'static str>)>,
    /// The kinds that are chosen there, with a line about each.
    pub kinds: Vec<(&'static str, &'static str)>,
    /// The keys in it.
    pub inner: Vec<KeyReference>,
}

/// A name that means nothing.
#[derive(Debug)]
pub struct Unknown {
    /// What it is.
    pub message: String,
    /// What could be meant.
    pub help: String,
}

impl fmt::Display for Unknown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

/// All keys at the top of a scenario file.
pub fn sections() -> Vec<KeyReference> {
    keys::ALL.iter().map(|key| row(key.name().into(), *key)).collect()
}

/// A step on the way along a name.
enum Step {
    /// A key, and the kind to which it belongs, if it belongs to one.
    Key(&'static dyn AnyKey, Option<&'static str>),
    /// A kind.
    Kind(KindForm),
    /// Something else of this form.
    Entry(Form),
}

impl Step {
    fn form(self) -> Form {
        match self {
            Step::Key(key, _) => key.form(),
            // Its own name leads nowhere.
            Step::Kind(kind) => Form::Kinds("", vec![kind]),
            Step::Entry(form) => form,
        }
    }
}

/// Finds out what a dotted name means. A name that a scenario chooses, as of a method, may stand in it, and the number of an
/// element of a list.
///
/// # Errors
/// If it means nothing.
pub fn explain(name: &str) -> Result<Explanation, Unknown> {
    let mut steps = vec![Step::Entry(Form::Table(keys::ALL))];
    let words: Vec<&str> = name.split('.').collect();
    for (number, word) in words.iter().enumerate() {
        let forms: Vec<Form> = steps.into_iter().map(Step::form).collect();
        steps = forms.iter().flat_map(|form| step(form, word)).collect();
        // A name that the file chooses leads on, but means nothing by itself.
        if steps.is_empty() && number + 1 < words.len() {
            steps = forms.into_iter().filter_map(chosen).map(Step::Entry).collect();
        }
        if steps.is_empty() {
            return Err(unknown(&words[..=number]));
        }
    }
    Ok(explanation(name, steps))
}

/// Where a word leads from a value of a form.
fn step(form: &Form, word: &str) -> Vec<Step> {
    let key = |keys: &[&'static dyn AnyKey], kind: Option<&'static str>| -> Option<Step> {
        keys.iter().find(|key| key.name() == word).map(|&key| Step::Key(key, kind))
    };
    match form {
        Form::Table(keys) => key(keys, None).into_iter().collect(),
        Form::Listed(option) => step(&Form::Kinds(super::KIND, list(option)), word),
        Form::PartOf(option) if word == super::KIND => step(&Form::Listed(option), word),
        Form::PartOf(option) => list(option).iter().filter_map(|kind| key(&kind.keys, Some(kind.name))).collect(),
        Form::Kinds(by, kinds) => {
            if *by == word {
                let names = kinds.iter().map(|kind| kind.name).collect();
                return vec![Step::Entry(Form::Words(names))];
            }
            let own = || kinds.iter().filter(|kind| kind.name == word && !by.is_empty());
            if own().next().is_some() {
                return own().cloned().map(Step::Kind).collect();
            }
            kinds.iter().filter_map(|kind| key(&kind.keys, Some(kind.name))).collect()
        }
        Form::Named(keys, other) => match key(keys, None) {
            Some(step) => vec![step],
            None => step(other, word),
        },
        Form::List(of) => step(of, word),
        Form::Any(forms) => forms.iter().flat_map(|form| step(form, word)).collect(),
        Form::Entries(entries) => {
            let named = entries.iter().filter(|(name, _)| *name == word);
            named.map(|(_, form)| Step::Entry(form.clone())).collect()
        }
        _ => Vec::new(),
    }
}

/// The form behind a name that the file chooses, or behind the number of an element.
fn chosen(form: Form) -> Option<Form> {
    match form {
        Form::Named(_, other) => Some(*other),
        Form::List(of) => Some(*of),
        Form::Any(forms) => forms.into_iter().find_map(chosen),
        _ => None,
    }
}

fn explanation(name: &str, steps: Vec<Step>) -> Explanation {
    let mut found =
        Explanation { name: clean(name), about: String::new(), keys: Vec::new(), kinds: Vec::new(), inner: Vec::new() };
    let mut of_keys = Vec::new();
    for step in steps {
        match step {
            Step::Key(key, kind) => of_keys.push((key, kind.unwrap_or_default())),
            Step::Kind(kind) => {
                found.about = kind.about.into();
                found.inner = kind.keys.iter().flat_map(|&key| super::rows("", key)).collect();
            }
            Step::Entry(form) => found.about = words(&form),
        }
    }
    for (key, kinds) in grouped(of_keys.into_iter()) {
        let form = key.form();
        found.kinds.extend(kinds_in(&form));
        found.inner.extend(inner("", &form));
        if let Form::Entries(entries) = &form {
            found.inner.extend(entries.iter().map(|(name, form)| KeyReference {
                name: name.to_string(),
                unit: "",
                allowed: words(form),
                default: String::new(),
                meaning: String::new(),
            }));
        }
        found.keys.push((row(key.name().into(), key), kinds.into_iter().filter(|kind| !kind.is_empty()).collect()));
    }
    found
}

/// The kinds of a list that are chosen in a value of a form.
fn kinds_in(form: &Form) -> Vec<(&'static str, &'static str)> {
    match form {
        Form::Listed(option) | Form::PartOf(option) => {
            list(option).iter().map(|kind| (kind.name, kind.about)).collect()
        }
        Form::Named(_, of) | Form::List(of) => kinds_in(of),
        _ => Vec::new(),
    }
}

/// What a value of a form is, where no key says more.
fn words(form: &Form) -> String {
    match form {
        Form::YesNo => "true or false".into(),
        Form::Words(words) => format!("one of {}", listed(words.iter().copied())),
        Form::Number(limits) => limits.words(),
        _ => "a table".into(),
    }
}

fn unknown(words: &[&str]) -> Unknown {
    let (word, before) = (words[words.len() - 1], words[..words.len() - 1].join("."));
    let all = paths();
    let below: Vec<&str> = {
        let prefix = if before.is_empty() { String::new() } else { format!("{before}.") };
        let names = all.iter().filter_map(|path| path.strip_prefix(&prefix)).filter(|rest| !rest.contains('.'));
        names.collect()
    };
    let last = |path: &str| path.rsplit('.').next().unwrap_or_default().to_string();
    let elsewhere: Vec<&str> = all.iter().filter(|path| last(path) == word).map(String::as_str).take(8).collect();
    let near = nearest(word, below.iter().copied());
    let mut help = match (near, elsewhere.as_slice()) {
        (Some(near), _) => {
            let dotted = if before.is_empty() { near.to_string() } else { format!("{}.{near}", clean(&before)) };
            format!("did you mean `{dotted}`?\n")
        }
        (None, []) => {
            let lasts: Vec<String> = all.iter().map(|path| last(path)).collect();
            let near = nearest(word, lasts.iter().map(String::as_str));
            let path = near.and_then(|near| all.iter().find(|path| last(path) == near));
            path.map_or(String::new(), |path| format!("did you mean `{path}`?\n"))
        }
        (None, elsewhere) => format!("elsewhere: {}\n", listed(elsewhere.iter().copied())),
    };
    let place = if before.is_empty() { "at the top level".to_string() } else { format!("in {}", clean(&before)) };
    if below.is_empty() {
        help.push_str("nothing is known below it");
    } else {
        help.push_str(&format!("known {place}: {}", listed(below)));
    }
    Unknown { message: format!("there is no key `{}` {place}", clean(word)), help }
}

/// The dotted names of all keys and kinds.
fn paths() -> Vec<String> {
    fn below(before: &str, form: &Form, all: &mut Vec<String>) {
        match form {
            Form::Table(keys) => keys.iter().for_each(|&key| of_key(before, key, all)),
            Form::Listed(option) => below(before, &Form::Kinds(super::KIND, list(option)), all),
            Form::PartOf(option) => {
                list(option).iter().flat_map(|kind| kind.keys.clone()).for_each(|key| of_key(before, key, all));
            }
            Form::Kinds(_, kinds) => {
                for kind in kinds {
                    let path = format!("{before}{}", kind.name);
                    kind.keys.iter().for_each(|&key| of_key(&format!("{path}."), key, all));
                    all.push(path);
                }
            }
            Form::Named(keys, other) => {
                keys.iter().for_each(|&key| of_key(before, key, all));
                below(before, other, all);
            }
            Form::List(of) => below(before, of, all),
            Form::Any(forms) => forms.iter().for_each(|form| below(before, form, all)),
            Form::Entries(entries) => all.extend(entries.iter().map(|(name, _)| format!("{before}{name}"))),
            _ => {}
        }
    }
    fn of_key(before: &str, key: &'static dyn AnyKey, all: &mut Vec<String>) {
        let path = format!("{before}{}", key.name());
        if !all.contains(&path) {
            below(&format!("{path}."), &key.form(), all);
            all.push(path);
        }
    }
    let mut all = Vec::new();
    below("", &Form::Table(keys::ALL), &mut all);
    all
}
