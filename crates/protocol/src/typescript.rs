//! TypeScript types from our own JSON Schema: the subset of it that schemars writes for our messages.

use std::fmt::Write;

use serde_json::{Map, Value};

/// One exported type per definition, in alphabetical order.
pub(super) fn from_schema(schema: &Value) -> String {
    let mut out = String::from(
        "// Messages of the posed websocket. Generated from the Rust types by `posed schema --typescript`; do not edit.\n",
    );
    for (name, definition) in schema["$defs"].as_object().into_iter().flatten() {
        out.push('\n');
        push_comment(definition, "", &mut out);
        let _ = writeln!(out, "export type {name} = {};", type_of(definition, ""));
    }
    out
}

/// The type that a schema describes; `indent` is that of the line it stands in.
fn type_of(schema: &Value, indent: &str) -> String {
    let Some(schema) = schema.as_object() else { return "unknown".into() };
    let mut parts = Vec::new();
    if let Some(target) = schema.get("$ref").and_then(Value::as_str) {
        parts.push(target.rsplit('/').next().unwrap_or(target).to_owned());
    }
    for key in ["oneOf", "anyOf"] {
        if let Some(Value::Array(options)) = schema.get(key) {
            parts.push(union(options.iter().map(|option| type_of(option, indent))));
        }
    }
    if let Some(value) = schema.get("const") {
        parts.push(value.to_string());
    } else if let Some(Value::Array(values)) = schema.get("enum") {
        parts.push(union(values.iter().map(Value::to_string)));
    } else if let Some(properties) = schema.get("properties").and_then(Value::as_object) {
        parts.push(object(schema, properties, indent));
    } else if parts.is_empty() {
        parts.push(match schema.get("type") {
            Some(Value::String(kind)) => plain(kind, schema, indent),
            Some(Value::Array(kinds)) => {
                union(kinds.iter().filter_map(Value::as_str).map(|kind| plain(kind, schema, indent)))
            }
            _ => "unknown".into(),
        });
    }
    // A tagged variant is an object beside a reference or a union: both hold.
    if parts.len() > 1 {
        for part in &mut parts {
            if is_union(part) {
                *part = format!("({part})");
            }
        }
    }
    parts.join(" & ")
}

/// Whether a type is a union at its outermost level, where `&` would bind closer.
fn is_union(text: &str) -> bool {
    let mut depth = 0;
    let comment = |line: &&str| line.trim_start().starts_with("/**");
    text.lines().filter(|line| !comment(line)).flat_map(str::chars).any(|c| {
        depth += i32::from(matches!(c, '{' | '(' | '[')) - i32::from(matches!(c, '}' | ')' | ']'));
        c == '|' && depth == 0
    })
}

fn plain(kind: &str, schema: &Map<String, Value>, indent: &str) -> String {
    match kind {
        "integer" | "number" => "number".into(),
        "array" => array(schema, indent),
        "object" => match schema.get("additionalProperties") {
            Some(values @ Value::Object(_)) => format!("Record<string, {}>", type_of(values, indent)),
            _ => "Record<string, unknown>".into(),
        },
        "string" | "boolean" | "null" => kind.into(),
        _ => "unknown".into(),
    }
}

/// A tuple where the length is fixed, else an array.
fn array(schema: &Map<String, Value>, indent: &str) -> String {
    let item = schema.get("items").map_or_else(|| "unknown".into(), |items| type_of(items, indent));
    let bound = |key| schema.get(key).and_then(Value::as_u64);
    match (bound("minItems"), bound("maxItems")) {
        (Some(min), Some(max)) if min == max => format!("[{}]", vec![item; max as usize].join(", ")),
        _ if item.contains([' ', '|', '&']) => format!("({item})[]"),
        _ => format!("{item}[]"),
    }
}

fn object(schema: &Map<String, Value>, properties: &Map<String, Value>, indent: &str) -> String {
    let inner = format!("{indent}  ");
    let required = |name: &str| {
        schema.get("required").and_then(Value::as_array).is_some_and(|names| names.iter().any(|n| n == name))
    };
    let mut out = String::from("{\n");
    for (name, property) in properties {
        push_comment(property, &inner, &mut out);
        let mark = if required(name) { "" } else { "?" };
        let plain = name.chars().all(|c| c.is_alphanumeric() || c == '_');
        let key = if plain { name.clone() } else { format!("{name:?}") };
        let _ = writeln!(out, "{inner}{key}{mark}: {};", type_of(property, &inner));
    }
    out + indent + "}"
}

fn union(options: impl Iterator<Item = String>) -> String {
    options.collect::<Vec<_>>().join(" | ")
}

fn push_comment(schema: &Value, indent: &str, out: &mut String) {
    if let Some(text) = schema.get("description").and_then(Value::as_str) {
        let _ = writeln!(out, "{indent}/** {} */", text.split_whitespace().collect::<Vec<_>>().join(" "));
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_union_beside_an_object_is_taken_as_one() {
        let option = |name: &str| json!({"properties": {"event": {"const": name}}, "required": ["event"]});
        let schema = json!({
            "oneOf": [option("a"), option("b")],
            "properties": {"t_s": {"type": "number"}},
            "required": ["t_s"]
        });
        let text: String = type_of(&schema, "").split_whitespace().collect();
        assert_eq!(text, r#"({event:"a";}|{event:"b";})&{t_s:number;}"#);
    }
}
