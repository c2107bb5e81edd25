//! All faults of a file, and not only the first: independent parts are read whatever is wrong with the others, and parts that
//! depend on a faulty one are at least compared with the forms of their keys.

use super::{AnyKey, Field, Form, KIND, KindForm, Read, ScenarioError, Section};
use toml::de::DeValue;

/// The faults found so far.
#[derive(Default)]
pub(crate) struct Faults(Vec<ScenarioError>);

impl Faults {
    /// The part that was read; or else `None`, with its fault kept.
    pub fn keep<T>(&mut self, read: Read<T>) -> Option<T> {
        read.map_err(|fault| self.0.push(fault)).ok()
    }

    /// Whether all parts could be read.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// All faults and those of `forms`, in the order of their places. Where both have one at the same place, that of the part is
    /// kept.
    ///
    /// # Panics
    /// If there is none.
    pub fn with(self, forms: Vec<ScenarioError>) -> ScenarioError {
        ScenarioError::of_all(self.0.into_iter().chain(forms)).expect("a part could not be read")
    }
}

/// All parts, each read whatever is wrong with the others.
///
/// # Errors
/// All faults of all parts.
pub(crate) fn read_all<T>(parts: impl Iterator<Item = Read<T>>) -> Read<Vec<T>> {
    let mut faults = Faults::default();
    let parts: Vec<T> = parts.filter_map(|part| faults.keep(part)).collect();
    ScenarioError::of_all(faults.0).map_or(Ok(parts), Err)
}

/// The kinds in the list of a name.
type Lists<'a> = &'a dyn Fn(&str) -> Vec<KindForm>;

/// Where a table does not have the form that its keys say: unknown and missing keys, wrong types, values beyond their limits,
/// also in all tables below it. A reader finds more, because it knows the rest of the file.
pub(crate) fn of_keys(section: &Section<'_>, keys: &[&'static dyn AnyKey], lists: Lists<'_>) -> Vec<ScenarioError> {
    let mut faults = Vec::new();
    let names: Vec<&str> = keys.iter().map(|key| key.name()).collect();
    of_table(section, &names, &[], keys, lists, &mut faults);
    faults
}

/// The same for a table that may have keys of these names; `elsewhere` lists those of other kinds of this table.
fn of_table(
    section: &Section<'_>,
    names: &[&str],
    elsewhere: &[(&str, &[&str])],
    keys: &[&'static dyn AnyKey],
    lists: Lists<'_>,
    faults: &mut Vec<ScenarioError>,
) {
    let mut meant = Vec::new();
    for (near, fault) in section.unknown_keys(names, elsewhere) {
        meant.extend(near);
        faults.push(fault);
    }
    of_known(section, keys, &meant, lists, faults);
}

/// The same for the known keys. Those that a misspelt key may mean do not count as missing.
fn of_known(
    section: &Section<'_>,
    keys: &[&'static dyn AnyKey],
    meant: &[&str],
    lists: Lists<'_>,
    faults: &mut Vec<ScenarioError>,
) {
    for key in keys {
        match section.optional(key.name()) {
            Some(field) => of_form(&field, &key.form(), lists, faults),
            None if key.default().is_none() && !meant.contains(&key.name()) => faults.push(section.missing(key.name())),
            None => {}
        }
    }
}

/// Where a value does not have a form.
fn of_form(field: &Field<'_>, form: &Form, lists: Lists<'_>, faults: &mut Vec<ScenarioError>) {
    let fault = match form {
        Form::Number(limits) => field.number(*limits).err(),
        Form::Whole(least, most) => field.integer(*least, *most).err(),
        Form::YesNo => field.yes_or_no().err(),
        Form::Words(words) => field.choice(&words.iter().map(|word| (*word, ())).collect::<Vec<_>>()).err(),
        Form::Text => field.text().err(),
        Form::List(of) => match field.elements(usize::MAX) {
            Ok(elements) => return elements.iter().for_each(|element| of_form(element, of, lists, faults)),
            Err(fault) => Some(fault),
        },
        Form::Table(keys) => match field.any_section() {
            Ok(section) => return faults.extend(of_keys(&section, keys, lists)),
            Err(fault) => Some(fault),
        },
        Form::Kinds(by, kinds) => return of_kinds(field, by, kinds, lists, faults),
        Form::Listed(name) => return of_kinds(field, KIND, &lists(name), lists, faults),
        Form::Named(keys, other) => match field.any_section() {
            Ok(section) => {
                of_known(&section, keys, &[], lists, faults);
                let others = section.fields().filter(|(name, _)| keys.iter().all(|key| key.name() != *name));
                return others.for_each(|(_, field)| of_form(&field, other, lists, faults));
            }
            Err(fault) => Some(fault),
        },
        Form::Entries(entries) => match field.any_section() {
            Ok(section) => {
                let names: Vec<&str> = entries.iter().map(|entry| entry.0).collect();
                faults.extend(section.unknown_keys(&names, &[]).map(|(_, fault)| fault));
                let known = entries.iter().filter_map(|(name, form)| Some((section.optional(name)?, form)));
                return known.for_each(|(field, form)| of_form(&field, form, lists, faults));
            }
            Err(fault) => Some(fault),
        },
        Form::Any(forms) => return of_any(field, forms, lists, faults),
        // Which of these keys there are depends on another table, and a time has its found reader.
        Form::PartOf(_) | Form::Time | Form::Free => None,
    };
    faults.extend(fault);
}

fn of_kinds(field: &Field<'_>, by: &str, kinds: &[KindForm], lists: Lists<'_>, faults: &mut Vec<ScenarioError>) {
    let names = |kind: &KindForm| kind.keys.iter().map(|key| key.name()).collect::<Vec<_>>();
    let choices: Vec<_> = kinds.iter().map(|kind| (kind.name, (), names(kind))).collect();
    let (number, section) = match field.section_of_any(by, &choices) {
        Ok(chosen) => chosen,
        Err(fault) => return faults.push(fault),
    };
    let known: Vec<&str> = std::iter::once(by).chain(choices[number].2.iter().copied()).collect();
    let elsewhere: Vec<(&str, &[&str])> = choices.iter().map(|kind| (kind.0, kind.2.as_slice())).collect();
    of_table(&section, &known, &elsewhere, &kinds[number].keys, lists, faults);
}

/// The faults of a value that has none of the forms: by the only form that is a table if the value is one, or else by the only
/// form that is not; nothing if there are several, since nobody knows which was meant.
fn of_any(field: &Field<'_>, forms: &[Form], lists: Lists<'_>, faults: &mut Vec<ScenarioError>) {
    let of_each = forms.iter().map(|form| {
        let mut found = Vec::new();
        of_form(field, form, lists, &mut found);
        (form, found)
    });
    let mut of_each: Vec<(&Form, Vec<ScenarioError>)> = of_each.collect();
    if of_each.iter().any(|(_, found)| found.is_empty()) {
        return;
    }
    let is_table = |form: &Form| {
        matches!(form, Form::Table(_) | Form::Kinds(..) | Form::Listed(_) | Form::Named(..) | Form::Entries(_))
    };
    let value_is_table = matches!(field.value.get_ref(), DeValue::Table(_));
    of_each.retain(|(form, _)| is_table(form) == value_is_table);
    if let [(_, found)] = &mut of_each[..] {
        faults.append(found);
    }
}
