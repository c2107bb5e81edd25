//! As much of JSON schema, draft 2020-12, as the schema of scenarios uses. Any other keyword is an error.

use serde_json::Value;

/// Where and why a value does not fit a schema.
pub fn faults(schema: &Value, value: &Value) -> Vec<String> {
    let mut faults = Vec::new();
    check(schema, schema, value, "", &mut faults);
    faults
}

fn check(root: &Value, schema: &Value, value: &Value, place: &str, faults: &mut Vec<String>) {
    let fits = |schema: &Value| {
        let mut faults = Vec::new();
        check(root, schema, value, place, &mut faults);
        faults.is_empty()
    };
    let number = |limit: &Value| value.as_f64().zip(limit.as_f64());
    for (keyword, rule) in schema.as_object().expect("a schema is an object") {
        let is_right = match keyword.as_str() {
            "$schema" | "$defs" | "title" | "description" | "default" => true,
            "$ref" => {
                let target = root
                    .pointer(rule.as_str().unwrap().strip_prefix('#').unwrap())
                    .expect("a reference leads somewhere");
                check(root, target, value, place, faults);
                true
            }
            "type" => match rule.as_str().unwrap() {
                "object" => value.is_object(),
                "array" => value.is_array(),
                "string" => value.is_string(),
                "boolean" => value.is_boolean(),
                "integer" => value.is_i64() || value.is_u64(),
                "number" => value.is_number(),
                other => panic!("type {other}"),
            },
            "enum" => rule.as_array().unwrap().contains(value),
            "const" => rule == value,
            "minimum" => number(rule).is_none_or(|(value, limit)| value >= limit),
            "maximum" => number(rule).is_none_or(|(value, limit)| value <= limit),
            "exclusiveMinimum" => number(rule).is_none_or(|(value, limit)| value > limit),
            "exclusiveMaximum" => number(rule).is_none_or(|(value, limit)| value < limit),
            "minLength" => value.as_str().is_none_or(|text| text.chars().count() as u64 >= rule.as_u64().unwrap()),
            "maxLength" => value.as_str().is_none_or(|text| text.chars().count() as u64 <= rule.as_u64().unwrap()),
            "required" => {
                let has = |key: &Value| value.get(key.as_str().unwrap()).is_some();
                !value.is_object() || rule.as_array().unwrap().iter().all(has)
            }
            "items" => {
                for (number, element) in value.as_array().into_iter().flatten().enumerate() {
                    check(root, rule, element, &format!("{place}/{number}"), faults);
                }
                true
            }
            "properties" => {
                for (key, schema) in rule.as_object().unwrap() {
                    if let Some(own) = value.get(key) {
                        check(root, schema, own, &format!("{place}/{key}"), faults);
                    }
                }
                true
            }
            "additionalProperties" => {
                let known = schema["properties"].as_object().unwrap();
                let others = value.as_object().into_iter().flatten().filter(|(key, _)| !known.contains_key(*key));
                for (key, own) in others {
                    match rule {
                        Value::Bool(false) => faults.push(format!("{place}/{key}: not known")),
                        schema => check(root, schema, own, &format!("{place}/{key}"), faults),
                    }
                }
                true
            }
            "anyOf" => rule.as_array().unwrap().iter().any(fits),
            "oneOf" => rule.as_array().unwrap().iter().filter(|schema| fits(schema)).count() == 1,
            other => panic!("keyword {other}"),
        };
        if !is_right {
            faults.push(format!("{place}: {keyword}"));
        }
    }
}
