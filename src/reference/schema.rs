//! A JSON schema of scenario files, for editors: keys, their types, ranges and meanings. What depends on the rest of the file
//! is left to the reader.

use super::{AnyKey, Form, KIND, KindForm, LISTS, grouped, keys, list};
use crate::reader::Limits;
use serde_json::{Map, Value, json};

/// The schema, of draft 2020-12.
pub fn schema() -> Value {
    let mut schema = object(keys::ALL);
    schema.insert("$schema".into(), "https://json-schema.org/draft/2020-12/schema".into());
    schema.insert("title".into(), format!("Scenario of isobar {}", crate::VERSION).into());
    let lists = LISTS.iter().map(|(option, ..)| (option.to_string(), of_kinds(KIND, &list(option))));
    schema.insert("$defs".into(), Value::Object(lists.collect()));
    Value::Object(schema)
}

/// A table with these keys and no others.
fn object(keys: &[&'static dyn AnyKey]) -> Map<String, Value> {
    let required: Vec<&str> = keys.iter().filter(|key| key.default().is_none()).map(|key| key.name()).collect();
    let properties: Map<String, Value> = keys.iter().map(|key| (key.name().into(), property(*key))).collect();
    let object =
        json!({ "type": "object", "properties": properties, "additionalProperties": false, "required": required });
    into_map(object)
}

/// A key: the form of its value, and what it means.
fn property(key: &dyn AnyKey) -> Value {
    let mut value = into_map(of(&key.form()));
    let unit = if key.unit().is_empty() { String::new() } else { format!(" [{}]", key.unit()) };
    let mut words = format!("{}{unit}: {}", key.meaning(), key.allowed());
    if let Some(default) = key.default() {
        words += &format!(". Default: {default}");
        // What is a value of the file is one of JSON, too.
        if let Ok(default) = serde_json::from_str::<Value>(&default) {
            value.insert("default".into(), default);
        }
    }
    value.insert("description".into(), words.into());
    Value::Object(value)
}

/// The schema of a form.
fn of(form: &Form) -> Value {
    match form {
        Form::Number(limits) => number(*limits),
        Form::Whole(least, most) => json!({ "type": "integer", "minimum": least, "maximum": most }),
        Form::YesNo => json!({ "type": "boolean" }),
        Form::Words(words) => json!({ "enum": words }),
        Form::Text => json!({ "type": "string", "minLength": 1, "maxLength": 500 }),
        Form::Time => json!({ "type": "string", "minLength": 10 }),
        Form::List(form) => json!({ "type": "array", "items": of(form) }),
        Form::Table(keys) => Value::Object(object(keys)),
        Form::Kinds(by, kinds) => of_kinds(by, kinds),
        Form::Listed(option) => json!({ "$ref": format!("#/$defs/{option}") }),
        Form::PartOf(option) => part_of(&list(option)),
        Form::Named(keys, other) => {
            let mut table = object(keys);
            table.insert("additionalProperties".into(), of(other));
            Value::Object(table)
        }
        Form::Entries(entries) => {
            let properties: Map<String, Value> =
                entries.iter().map(|(name, form)| (name.to_string(), of(form))).collect();
            json!({ "type": "object", "properties": properties, "additionalProperties": false })
        }
        Form::Any(forms) => json!({ "anyOf": forms.iter().map(of).collect::<Vec<_>>() }),
        Form::Free => json!({}),
    }
}

fn number(limits: Limits) -> Value {
    match limits {
        Limits::Any => json!({ "type": "number", "minimum": -1e18, "maximum": 1e18 }),
        Limits::Positive => json!({ "type": "number", "exclusiveMinimum": 0, "maximum": 1e18 }),
        Limits::NonNegative => json!({ "type": "number", "minimum": 0, "maximum": 1e18 }),
        Limits::Between(least, most) => json!({ "type": "number", "minimum": least, "maximum": most }),
        Limits::Fraction => json!({ "type": "number", "minimum": 0, "exclusiveMaximum": 1 }),
    }
}

/// A table of one of the kinds.
fn of_kinds(by: &str, kinds: &[KindForm]) -> Value {
    let kind = |kind: &KindForm| {
        let mut table = object(&kind.keys);
        let named = json!({ "const": kind.name, "description": kind.about });
        table["properties"].as_object_mut().expect("an object").insert(by.into(), named);
        table["required"].as_array_mut().expect("a list").push(by.into());
        table.insert("title".into(), kind.name.into());
        Value::Object(table)
    };
    json!({ "type": "object", "required": [by], "oneOf": kinds.iter().map(kind).collect::<Vec<_>>() })
}

/// A table with some of the keys of some of the kinds, and perhaps with the name of one.
fn part_of(kinds: &[KindForm]) -> Value {
    let names = kinds.iter().map(|kind| kind.name).collect();
    let mut properties = Map::from_iter([(KIND.to_string(), of(&Form::Words(names)))]);
    for (key, _) in grouped(kinds.iter().flat_map(|kind| kind.keys.iter().map(|&key| (key, kind.name)))) {
        let property = property(key);
        match properties.get_mut(key.name()) {
            // A key that is another one in another kind.
            Some(other) => *other = json!({ "anyOf": [other.take(), property] }),
            None => drop(properties.insert(key.name().into(), property)),
        }
    }
    json!({ "type": "object", "properties": properties, "additionalProperties": false })
}

fn into_map(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        other => unreachable!("{other} is no object"),
    }
}
