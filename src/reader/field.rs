//! A key of a table, with its value.

use super::{AnyKey, Read, ScenarioError, Section, SourceFile};
use crate::text::{clean, is_unprintable, listed, nearest};
use isobar_model::Time;
use isobar_obs::times;
use std::ops::Range;
use std::path::PathBuf;
use toml::Spanned;
use toml::de::DeValue;

/// One key of a section, with its value.
#[derive(Clone)]
pub(crate) struct Field<'a> {
    pub file: &'a SourceFile,
    /// Dotted name, `grid.nx`.
    pub name: String,
    pub key_span: Range<usize>,
    pub value: &'a Spanned<DeValue<'a>>,
}

/// What a number may be.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Limits {
    /// Any number up to 1e18 in size.
    Any,
    /// From 1e-18 to 1e18.
    Positive,
    /// 0, or as [`Limits::Positive`].
    NonNegative,
    /// From the first to the second, both included.
    Between(f64, f64),
    /// From 0 to below 1.
    Fraction,
}

impl Limits {
    fn contain(self, number: f64) -> bool {
        match self {
            Limits::Any => number.abs() <= 1e18,
            Limits::Positive => (1e-18..=1e18).contains(&number),
            Limits::NonNegative => number == 0.0 || (1e-18..=1e18).contains(&number),
            Limits::Between(least, most) => (least..=most).contains(&number),
            Limits::Fraction => (0.0..1.0).contains(&number),
        }
    }

    /// What a number must be that is not within the limits: where these say no more than its sign, and it has that, how large.
    fn words_for(self, number: f64) -> String {
        match self {
            Limits::Any if number.is_finite() => "a number from -1e18 to 1e18".into(),
            Limits::Positive if number.is_finite() && number > 0.0 => "a number from 1e-18 to 1e18".into(),
            Limits::NonNegative if number.is_finite() && number > 0.0 => "0 or a number from 1e-18 to 1e18".into(),
            _ => self.words(),
        }
    }

    pub fn words(&self) -> String {
        match *self {
            Limits::Any => "a finite number".into(),
            Limits::Positive => "a number greater than 0".into(),
            Limits::NonNegative => "a number that is 0 or greater".into(),
            Limits::Between(least, most) => format!("a number from {least} to {most}"),
            Limits::Fraction => "a number from 0 to below 1".into(),
        }
    }
}

impl<'a> Field<'a> {
    /// A fault of the value: `message` should say what is wrong, `allowed` what would be right.
    pub fn invalid(&self, message: String, allowed: &str) -> ScenarioError {
        self.file.error(self.value.span(), message, allowed, None)
    }

    /// A fault of the key itself.
    pub fn misplaced(&self, message: String, help: &str) -> ScenarioError {
        self.file.error(self.key_span.clone(), message, "this key", Some(help.to_string()))
    }

    /// The name as messages show it.
    pub fn title(&self) -> String {
        clean(&self.name)
    }

    fn wrong_type(&self, wanted: &str) -> ScenarioError {
        let found = match self.value.get_ref() {
            DeValue::String(_) => "a string",
            DeValue::Integer(_) => "a whole number",
            DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "true or false",
            DeValue::Datetime(_) => "a date or time",
            DeValue::Array(_) => "a list",
            DeValue::Table(_) => "a table",
        };
        self.invalid(format!("`{}` is {found}, but must be {wanted}", self.title()), &format!("must be {wanted}"))
    }

    /// A number within the limits.
    pub fn number(&self, limits: Limits) -> Read<f64> {
        let number = match self.value.get_ref() {
            DeValue::Integer(integer) => {
                i128::from_str_radix(integer.as_str(), integer.radix()).map_or(f64::INFINITY, |whole| whole as f64)
            }
            DeValue::Float(float) => float.as_str().parse().unwrap_or(f64::NAN),
            _ => return Err(self.wrong_type(&limits.words())),
        };
        if !limits.contain(number) {
            let wanted = limits.words_for(number);
            let message = format!("`{}` is {number:?}, but must be {wanted}", self.title());
            return Err(self.invalid(message, &format!("must be {wanted}")));
        }
        Ok(number)
    }

    /// A whole number from `least` to `most`.
    pub fn integer(&self, least: i64, most: i64) -> Read<i64> {
        let wanted = format!("a whole number from {least} to {most}");
        let DeValue::Integer(integer) = self.value.get_ref() else { return Err(self.wrong_type(&wanted)) };
        let number = i128::from_str_radix(integer.as_str(), integer.radix()).unwrap_or(i128::MAX);
        match i64::try_from(number) {
            Ok(number) if (least..=most).contains(&number) => Ok(number),
            _ => {
                let message = format!("`{}` is {}, but must be {wanted}", self.title(), clean(integer.as_str()));
                Err(self.invalid(message, &format!("must be {wanted}")))
            }
        }
    }

    /// A whole number from `least` to `most`, neither negative.
    pub fn whole(&self, least: usize, most: usize) -> Read<usize> {
        Ok(self.integer(least as i64, most as i64)? as usize)
    }

    /// true or false.
    pub fn yes_or_no(&self) -> Read<bool> {
        self.value.get_ref().as_bool().ok_or_else(|| self.wrong_type("true or false"))
    }

    /// A text that can be shown: not empty, at most 500 characters, no control characters.
    pub fn text(&self) -> Read<String> {
        let text = self.value.get_ref().as_str().ok_or_else(|| self.wrong_type("a string"))?;
        let fault = if text.trim().is_empty() {
            "is empty"
        } else if text.chars().count() > 500 {
            "has more than 500 characters"
        } else if text.chars().any(is_unprintable) {
            "contains a control character"
        } else {
            return Ok(text.to_string());
        };
        let message = format!("`{}` {fault}", self.title());
        Err(self.invalid(message, "must be 1 to 500 printable characters"))
    }

    /// A time in whole seconds, as a TOML date-time or a string.
    pub fn time(&self) -> Read<Time> {
        let wanted = "a time such as \"2026-01-15T00:00:00Z\", in whole seconds, from 1900 to 2200";
        let text = match self.value.get_ref() {
            DeValue::String(text) => text.to_string(),
            DeValue::Datetime(time) => time.to_string(),
            _ => return Err(self.invalid(format!("`{}` is not a time", self.title()), wanted)),
        };
        let cannot = format!("`{}` cannot be \"{}\"", self.title(), clean(&text));
        let time = times::parse(&text)
            .map_err(|expected| self.invalid(format!("{cannot}: it must be a time {expected}"), wanted))?;
        if !(-2_208_988_800..7_258_118_400).contains(&time.seconds()) {
            return Err(self.invalid(cannot, wanted));
        }
        Ok(time)
    }

    /// The path of the file that is named here, relative to the scenario's directory.
    pub fn path(&self) -> Read<PathBuf> {
        let name = self.text()?;
        self.file.names(self.value.span(), &name);
        Ok(self.file.beside(&name))
    }

    /// One of the words, as what it stands for.
    pub fn choice<T: Copy>(&self, choices: &[(&str, T)]) -> Read<T> {
        let words = listed(choices.iter().map(|(word, _)| *word));
        let found = self.value.get_ref().as_str().ok_or_else(|| self.wrong_type(&format!("one of {words}")))?;
        if let Some((_, meaning)) = choices.iter().find(|(word, _)| *word == found) {
            return Ok(*meaning);
        }
        let message = format!("`{}` cannot be \"{}\"", self.title(), clean(found));
        let near = nearest(found, choices.iter().map(|(word, _)| *word));
        let mut help = near.map_or(String::new(), |near| format!("did you mean \"{near}\"?\n"));
        help.push_str(&format!("valid values: {words}"));
        Err(self.file.error(self.value.span(), message, "not a valid value", Some(help)))
    }

    /// A table with these keys at most.
    pub fn section(&self, keys: &[&str]) -> Read<Section<'a>> {
        let section = self.any_section()?;
        section.check_keys(keys, &[])?;
        Ok(section)
    }

    /// A table with the names of these keys at most.
    pub fn section_with(&self, keys: &[&dyn AnyKey]) -> Read<Section<'a>> {
        self.section(&keys.iter().map(|key| key.name()).collect::<Vec<_>>())
    }

    /// A table whose keys are names that the file chooses.
    pub fn any_section(&self) -> Read<Section<'a>> {
        match self.value.get_ref() {
            DeValue::Table(table) => {
                // The table of a header spans the header; one that only its children imply has nothing but its key.
                let span = if self.value.span().is_empty() { self.key_span.clone() } else { self.value.span() };
                Ok(Section { file: self.file, name: self.name.clone(), table, span })
            }
            _ => Err(self.wrong_type("a table")),
        }
    }

    /// A table of one of several kinds, which a key of it says, with the keys of that kind at most. Each kind has its name, what
    /// it is, and the names of its keys.
    pub fn section_by<T: Copy>(
        &self,
        key: &str,
        kinds: &[(&'static str, T, Vec<&'static str>)],
    ) -> Read<(T, Section<'a>)> {
        let (number, section) = self.section_of_any(key, kinds)?;
        let (_, meaning, keys) = &kinds[number];
        let keys: Vec<&str> = std::iter::once(key).chain(keys.iter().copied()).collect();
        let elsewhere: Vec<(&str, &[&str])> = kinds.iter().map(|kind| (kind.0, kind.2.as_slice())).collect();
        section.check_keys(&keys, &elsewhere)?;
        Ok((*meaning, section))
    }

    /// The same with whatever keys; the kind by its number.
    pub(super) fn section_of_any<T>(
        &self,
        key: &str,
        kinds: &[(&'static str, T, Vec<&'static str>)],
    ) -> Read<(usize, Section<'a>)> {
        let section = self.any_section()?;
        let names: Vec<(&str, usize)> = kinds.iter().enumerate().map(|(number, kind)| (kind.0, number)).collect();
        let Some(kind) = section.optional(key) else {
            let union: Vec<&str> =
                std::iter::once(key).chain(kinds.iter().flat_map(|kind| kind.2.iter().copied())).collect();
            section.check_keys(&union, &[])?;
            let help = format!(
                "{key} = {}",
                names.iter().map(|(name, _)| format!("\"{name}\"")).collect::<Vec<_>>().join(" or ")
            );
            let message = format!("`{key}` is missing in [{}]", section.title());
            return Err(self.file.error(
                section.span.clone(),
                message,
                &format!("`{key}` must be given here"),
                Some(help),
            ));
        };
        Ok((kind.choice(&names)?, section))
    }

    /// The elements of a list of at most `most`.
    pub fn elements(&self, most: usize) -> Read<Vec<Field<'a>>> {
        let DeValue::Array(array) = self.value.get_ref() else { return Err(self.wrong_type("a list")) };
        if array.len() > most {
            let message = format!("`{}` has {} elements, more than the {most} allowed", self.title(), array.len());
            return Err(self.invalid(message, "too many elements"));
        }
        let element = |(number, value): (usize, &'a Spanned<DeValue<'a>>)| Field {
            file: self.file,
            name: format!("{}[{number}]", self.name),
            key_span: self.key_span.clone(),
            value,
        };
        Ok(array.iter().enumerate().map(element).collect())
    }

    /// A list of different texts.
    pub fn texts(&self, most: usize) -> Read<Vec<String>> {
        let mut texts = Vec::new();
        for element in self.elements(most)? {
            let text = element.text()?;
            if texts.contains(&text) {
                return Err(
                    element.invalid(format!("`{}` names \"{text}\" twice", self.title()), "already in the list")
                );
            }
            texts.push(text);
        }
        Ok(texts)
    }
}
