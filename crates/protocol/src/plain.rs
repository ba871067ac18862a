//! JSON Schemas as viewers of recordings read them: objects, arrays, numbers, texts, truths, one type per field.
//!
//! The parser that Foxglove Studio published, and Lichtblick goes on with, refuses a whole channel for one `$ref`, union or array of
//! arrays. [`plain`] takes those out. What cannot be said so is left out of the schema, and is in the messages all the same.

use serde_json::{Map, Value, json};

/// The schema in plain words: references followed, unions of objects put together, what may be null said as what it is otherwise (and
/// not required), and fields of other kinds left out.
pub(super) fn plain(schema: &Value) -> Value {
    let plain = simple(schema, schema).unwrap_or_else(|| json!({ "type": "object", "properties": {} }));
    match (plain, schema.get("title")) {
        (Value::Object(mut plain), Some(title)) => {
            plain.insert("title".to_owned(), title.clone());
            Value::Object(plain)
        }
        (plain, _) => plain,
    }
}

/// `None` of what cannot be said.
fn simple(schema: &Value, root: &Value) -> Option<Value> {
    if let Some(reference) = schema.get("$ref").and_then(Value::as_str) {
        return simple(root.pointer(reference.strip_prefix('#')?)?, root);
    }
    let one_of = ["oneOf", "anyOf", "allOf"].iter().find_map(|key| schema.get(*key)?.as_array());
    let kind = schema.get("type").and_then(|kind| match kind {
        Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null"),
        kind => kind.as_str(),
    });
    if schema.get("properties").is_none()
        && let Some(variants) = one_of
    {
        return union(variants, root);
    }
    match kind {
        Some("object") | None if kind.is_some() || schema.get("properties").is_some() => {
            let mut object = Map::new();
            for (name, of) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
                if let Some(of) = simple(of, root) {
                    object.insert(name.clone(), of);
                }
            }
            for variant in one_of.into_iter().flatten() {
                if let Some(more) = simple(variant, root) {
                    add_fields(&mut object, &more);
                }
            }
            Some(json!({ "type": "object", "properties": object }))
        }
        Some("array") => {
            let items = simple(schema.get("items").filter(|items| items.is_object())?, root)?;
            // Arrays of arrays are more than viewers read.
            (items["type"] != "array").then(|| json!({ "type": "array", "items": items }))
        }
        Some(kind @ ("number" | "integer" | "string" | "boolean")) => Some(json!({ "type": kind })),
        // Without a type: one of some words.
        _ => schema
            .get("const")
            .or(schema.get("enum").and_then(|words| words.get(0)))?
            .as_str()
            .map(|_| json!({ "type": "string" })),
    }
}

/// Adds those fields of an object in plain words that are not there yet.
fn add_fields(fields: &mut Map<String, Value>, more: &Value) {
    for (name, of) in more.get("properties").and_then(Value::as_object).into_iter().flatten() {
        fields.entry(name).or_insert_with(|| of.clone());
    }
}

/// Variants put together, if all are objects, or all of one simple type.
fn union(variants: &[Value], root: &Value) -> Option<Value> {
    let mut all = variants
        .iter()
        .filter(|variant| variant.get("type").is_none_or(|kind| kind != "null"))
        .map(|variant| simple(variant, root));
    let mut first = all.next()??;
    for other in all {
        let other = other?;
        if other["type"] != first["type"] {
            return None;
        }
        if let Some(Value::Object(fields)) = first.get_mut("properties") {
            add_fields(fields, &other);
        }
    }
    Some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_unions_and_nulls_are_said_plainly() {
        let schema = json!({
            "title": "T",
            "type": "object",
            "properties": {
                "a": { "$ref": "#/$defs/A" },
                "b": { "type": ["number", "null"] },
                "c": { "anyOf": [{ "$ref": "#/$defs/A" }, { "type": "null" }] },
                "d": { "type": "array", "items": { "type": "array", "items": { "type": "number" } } },
                "e": { "oneOf": [{ "const": "x" }, { "type": "string", "enum": ["y"] }] },
                "f": { "anyOf": [{ "type": "string" }, { "type": "number" }] },
                "g": { "type": "object", "additionalProperties": { "type": "number" } }
            },
            "oneOf": [
                { "type": "object", "properties": { "h": { "type": "boolean" } } },
                { "$ref": "#/$defs/A" }
            ],
            "$defs": { "A": { "type": "object", "properties": { "i": { "type": "integer" } } } }
        });
        let a = json!({ "type": "object", "properties": { "i": { "type": "integer" } } });
        let expected = json!({
            "title": "T",
            "type": "object",
            "properties": {
                "a": a, "b": { "type": "number" }, "c": a, "e": { "type": "string" },
                "g": { "type": "object", "properties": {} },
                "h": { "type": "boolean" }, "i": { "type": "integer" }
            }
        });
        assert_eq!(plain(&schema), expected);
    }
}
