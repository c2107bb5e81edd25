//! `[sweep]`: keys of the scenario, and the values that they take in turn.

use crate::kinds::models::Model;
use crate::reader::{Absent, AnyKey, Choice, Described, Field, Form, Key, Limits, Read, Section, Whole};
use crate::scores::kinds::MEMORY;
use crate::scores::{Score, ScoreKind};
use indexmap::IndexMap;
use toml::Value;
use toml::de::DeValue;

/// The most values of a key.
const MOST_VALUES: usize = 100;

/// The most keys.
const MOST_KEYS: usize = 8;

/// Which keys vary.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepSettings {
    /// Number of seeds of each setting, from the scenario's on.
    pub seeds: usize,
    /// Dotted name of the score, where less is better; `None`: the analysis error of the first variable, or a
    /// departure where there is no truth.
    pub score: Option<String>,
    /// The values of each key, by its dotted name, `methods.var.covariance_scale`; a number stands for an element of a list,
    /// from 0.
    pub vary: IndexMap<String, Vec<Value>>,
}

const SEEDS: Key<Whole> = Key::absent(
    "seeds",
    "",
    Whole(1, 1000),
    Absent::Means(1),
    "number of seeds of each setting, from the scenario's on",
);

const SCORE: Key<Described> = Key::absent(
    "score",
    "",
    Described("the name of a score, such as \"rmse_analysis.h\" or \"bias_rmse\"", Form::text),
    Absent::Explained("the analysis error of the first variable, or a departure where there is no truth"),
    "the score by which the best setting is chosen; smaller is better",
);

const VARY: Key<Described> = Key::required(
    "vary",
    "",
    Described(
        "a table of dotted keys of this file, each with a list of values or `{ from, to, count, spacing }`",
        || Form::Named(&[], Box::new(Form::Any(vec![Form::list(Form::Free), Form::Table(RANGE_KEYS)]))),
    ),
    "the keys that vary, and their values",
);

/// The keys of `[sweep]`.
pub(super) const KEYS: &[&dyn AnyKey] = &[&SEEDS, &SCORE, &VARY];

const FROM: Key<Limits> = Key::required("from", "of the key", Limits::Any, "the first value");

const TO: Key<Limits> = Key::required("to", "of the key", Limits::Any, "the last value");

const COUNT: Key<Whole> = Key::required("count", "", Whole(2, MOST_VALUES), "number of values");

const SPACING: Key<Choice<bool>> = Key::absent(
    "spacing",
    "",
    Choice(&[("linear", false), ("logarithmic", true)]),
    Absent::Means(false),
    "whether differences or ratios of neighbouring values are equal",
);

const RANGE_KEYS: &[&dyn AnyKey] = &[&FROM, &TO, &COUNT, &SPACING];

/// Reads `[sweep]`.
pub(super) fn read(
    root: &Section<'_>,
    model: &Model,
    can_have: impl Fn(&ScoreKind) -> bool,
) -> Read<Option<SweepSettings>> {
    let Some(field) = root.optional("sweep") else { return Ok(None) };
    let section = field.section_with(KEYS)?;
    let field = section.required(VARY.name)?;
    let mut vary = IndexMap::new();
    for (key, field) in field.any_section()?.fields() {
        if vary.len() == MOST_KEYS {
            return Err(field.misplaced(format!("more than {MOST_KEYS} keys vary"), "too many"));
        }
        let root = key.split('.').next().unwrap_or_default();
        if ["sweep", "expected", "output", "seed"].contains(&root) || !key.contains('.') {
            let help = "a dotted key of this file in quotes, such as \"methods.fkf.factors\"; `seeds` varies the seed";
            return Err(field.misplaced(format!("`{}` cannot vary", crate::text::clean(key)), help));
        }
        vary.insert(key.to_string(), values(&field)?);
    }
    if vary.is_empty() {
        return Err(field.invalid("no key varies".into(), "keys with lists of values"));
    }
    let seeds = section.get(&SEEDS)?;
    let scores = scores(model, can_have);
    let known: Vec<(&str, &str)> = scores.iter().map(|name| (name.as_str(), name.as_str())).collect();
    let score = section.optional(SCORE.name).map(|field| field.choice(&known)).transpose()?.map(String::from);
    Ok(Some(SweepSettings { seeds, score, vary }))
}

/// The names of all scores that a method may have.
fn scores(model: &Model, can_have: impl Fn(&ScoreKind) -> bool) -> Vec<String> {
    // Of runs at the same time the memory of each is not known.
    Score::all(model.variables(), |kind| kind.name != MEMORY && can_have(kind)).iter().map(Score::key).collect()
}

/// A list, or `{ from, to, count }`.
fn values(field: &Field<'_>) -> Read<Vec<Value>> {
    if !matches!(field.value.get_ref(), DeValue::Table(_)) {
        let values = field.elements(MOST_VALUES)?.iter().map(value).collect::<Read<Vec<_>>>()?;
        if values.is_empty() {
            return Err(field.invalid(format!("`{}` has no values", field.title()), "at least one value"));
        }
        return Ok(values);
    }
    let section = field.section_with(RANGE_KEYS)?;
    let (from, to) = (section.get(&FROM)?, section.get(&TO)?);
    let count = section.get(&COUNT)?;
    let is_logarithmic = section.get(&SPACING)?;
    if let Some(spacing) = section.optional(SPACING.name).filter(|_| is_logarithmic && (from <= 0.0 || to <= 0.0)) {
        let message = format!("values from {from:?} to {to:?} cannot be spaced logarithmically");
        return Err(spacing.invalid(message, "both ends must be greater than 0"));
    }
    let is_whole =
        |key: &str| section.optional(key).is_some_and(|field| matches!(field.value.get_ref(), DeValue::Integer(_)));
    let step = |number: usize| number as f64 / (count - 1) as f64;
    let value = |number: usize| match number {
        // The ends to the digit.
        0 => from,
        last if last == count - 1 => to,
        _ if is_logarithmic => from * (to / from).powf(step(number)),
        _ => from + (to - from) * step(number),
    };
    let all: Vec<f64> = (0..count).map(value).collect();
    // Whole numbers where all are: a key that wants them would refuse 4.0.
    let whole = is_whole(FROM.name) && is_whole(TO.name) && all.iter().all(|value| value.fract() == 0.0);
    Ok(all.into_iter().map(|value| if whole { Value::Integer(value as i64) } else { Value::Float(value) }).collect())
}

/// A value, as it is.
fn value(field: &Field<'_>) -> Read<Value> {
    Ok(match field.value.get_ref() {
        DeValue::String(_) => Value::String(field.text()?),
        DeValue::Integer(_) => Value::Integer(field.integer(i64::MIN, i64::MAX)?),
        DeValue::Float(_) => Value::Float(field.number(Limits::Any)?),
        DeValue::Boolean(_) => Value::Boolean(field.yes_or_no()?),
        DeValue::Array(_) => Value::Array(field.elements(MOST_VALUES)?.iter().map(value).collect::<Read<Vec<_>>>()?),
        DeValue::Table(_) => {
            let section = field.any_section()?;
            let entries = section.fields().map(|(key, field)| Ok((key.to_string(), value(&field)?)));
            Value::Table(entries.collect::<Read<toml::Table>>()?)
        }
        DeValue::Datetime(_) => {
            return Err(field.invalid(format!("`{}` cannot be a time", field.title()), "a number, text or table"));
        }
    })
}
