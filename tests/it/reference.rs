//! Holds `config/README.md` against the types of the stage file.

use std::collections::BTreeMap;
use std::path::Path;

use posed_simulator::scenario::Scenario;
use posed_stage::Stage;
use serde_json::Value;

/// Tables of keys by the name of their place in the file, written from JSON schemas.
struct Reference {
    schema: Value,
    tables: BTreeMap<String, String>,
}

impl Reference {
    /// All tables of the object that a schema describes, which stands at `path` in the file.
    fn tables(title: &str, path: &str, schema: Value) -> BTreeMap<String, String> {
        let mut reference = Self { schema: schema.clone(), tables: BTreeMap::new() };
        reference.table(title, path, &schema);
        reference.tables
    }

    /// Follows `$ref`, which may have other keys beside it, and drops the `null` of an optional value.
    fn resolve(&self, schema: &Value) -> Value {
        let optional =
            schema["anyOf"].as_array().and_then(|list| list.iter().find(|one| one["type"] != "null"));
        let schema = optional.unwrap_or(schema);
        let Some(name) = schema["$ref"].as_str().and_then(|path| path.strip_prefix("#/$defs/")) else {
            return schema.clone();
        };
        let mut merged = self.schema["$defs"][name].clone();
        if let Some(own) = schema["properties"].as_object() {
            merged["properties"].as_object_mut().unwrap().extend(own.clone());
        }
        merged
    }

    /// Writes the table of one object, and those of the objects below it.
    fn table(&mut self, title: &str, path: &str, schema: &Value) {
        let required: Vec<&str> =
            schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let mut text = String::from("\n| key | value | default | meaning |\n|---|---|---|---|\n");
        for (name, property) in schema["properties"].as_object().into_iter().flatten() {
            if property["const"].is_string() {
                continue;
            }
            let below = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
            let inner = self.resolve(property);
            let items = self.resolve(&inner["items"]);
            let (value, has_keys) = if is_table(&items) {
                (format!("`[[{below}]]` tables"), Some((format!("[[{below}]]"), items)))
            } else if is_table(&inner) {
                (format!("`[{below}]` table"), Some((format!("[{below}]"), inner)))
            } else {
                (value_words(&inner), None)
            };
            let default = match &property["default"] {
                _ if required.contains(&name.as_str()) => "required".to_owned(),
                Value::Null | Value::Object(_) => String::new(),
                Value::String(text) if text.is_empty() => "required".to_owned(),
                Value::Array(list) if list.is_empty() => String::new(),
                default => format!("`{default}`"),
            };
            let about = property["description"].as_str().unwrap_or_default().replace('\n', " ");
            assert!(!about.is_empty(), "{below} has no documentation");
            text.push_str(&format!("| `{name}` | {value} | {default} | {about} |\n"));
            if let Some((title, schema)) = has_keys {
                self.table(&title, &below, &schema);
            }
        }
        let alternatives: Vec<Value> = schema["oneOf"].as_array().cloned().unwrap_or_default();
        if alternatives.iter().any(|one| one["properties"]["driver"].is_object()) {
            let words: Vec<String> = alternatives
                .iter()
                .map(|one| format!("`{}`", one["properties"]["driver"]["const"]))
                .collect();
            text.push_str(&format!("| `driver` | {} | required | The driver. |\n", words.join(", ")));
            for one in &alternatives {
                let word = one["properties"]["driver"]["const"].as_str().unwrap();
                self.table(&format!("{title} {word}"), path, one);
            }
        } else if !alternatives.is_empty() {
            text = self.kinds(&alternatives);
        }
        self.tables.insert(title.to_owned(), text + "\n");
    }

    /// Writes the table of a choice: one row per `kind`, with its keys.
    fn kinds(&self, alternatives: &[Value]) -> String {
        let mut text = String::from("\n| `kind` | meaning | further keys |\n|---|---|---|\n");
        for one in alternatives {
            let about = one["description"].as_str().unwrap().replace('\n', " ");
            let full = self.resolve(one);
            let required: Vec<Value> = [one, &full]
                .iter()
                .flat_map(|schema| schema["required"].as_array().cloned().unwrap_or_default())
                .collect();
            let properties = full["properties"].as_object().unwrap();
            let keys = properties.iter().filter(|(_, property)| !property["const"].is_string());
            let keys: Vec<String> = keys
                .map(|(name, property)| {
                    let meaning = property["description"].as_str().unwrap().trim_end_matches('.');
                    let default = match &property["default"] {
                        _ if required.contains(&Value::from(name.as_str())) => ", required".to_owned(),
                        Value::Null => String::new(),
                        default => format!(", default `{default}`"),
                    };
                    format!("`{name}`: {meaning} ({}{default})", value_words(&self.resolve(property)))
                })
                .collect();
            text.push_str(&format!(
                "| `{}` | {about} | {} |\n",
                one["properties"]["kind"]["const"],
                keys.join("<br>")
            ));
        }
        text
    }
}

/// Whether a value is a table with keys of its own.
fn is_table(schema: &Value) -> bool {
    let is_choice = |list: &Vec<Value>| list.iter().any(|one| one["properties"]["kind"].is_object());
    schema["properties"].is_object() || schema["oneOf"].as_array().is_some_and(is_choice)
}

/// What a value looks like, in a word or two.
fn value_words(schema: &Value) -> String {
    let words: Vec<String> = schema["oneOf"]
        .as_array()
        .into_iter()
        .flatten()
        .flat_map(|one| one["enum"].as_array().cloned().unwrap_or_else(|| vec![one["const"].clone()]))
        .chain(schema["enum"].as_array().into_iter().flatten().cloned())
        .map(|word| format!("`{word}`"))
        .collect();
    if !words.is_empty() {
        return words.join(", ");
    }
    let kind = match &schema["type"] {
        Value::Array(kinds) => kinds.iter().find(|kind| *kind != "null").unwrap(),
        kind => kind,
    };
    match kind.as_str() {
        Some("string") => "text".to_owned(),
        Some("boolean") => "`true`, `false`".to_owned(),
        Some("object") => "table".to_owned(),
        Some("array") => match schema["minItems"].as_u64() {
            Some(count) => format!("\\[{count} numbers\\]"),
            None => "list of texts".to_owned(),
        },
        Some(kind) => {
            let noun = if kind == "integer" { "whole number" } else { "number" };
            match (schema["minimum"].as_f64(), schema["maximum"].as_f64()) {
                (Some(least), Some(most)) => format!("{noun}, {least} to {most}"),
                (Some(least), None) => format!("{noun}, from {least}"),
                _ => noun.to_owned(),
            }
        }
        None => panic!("no words for {schema}"),
    }
}

/// Every key is in the reference, the reference has no key that is not, and each states what its type says.
#[test]
fn the_reference_of_every_key_agrees_with_the_types() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/README.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut tables = Reference::tables("the file", "", schemars::schema_for!(Stage).to_value());
    let scenario = schemars::schema_for!(Scenario).to_value();
    tables.extend(Reference::tables("[simulation]", "simulation", scenario));
    let mut parts = text.split("<!-- keys: ");
    let mut written = parts.next().unwrap().to_owned();
    for part in parts {
        let (title, rest) = part.split_once(" -->\n").unwrap();
        let (_, rest) = rest.split_once("<!-- end -->").unwrap();
        let table = tables.remove(title).unwrap_or_else(|| panic!("there is no {title} in the stage file"));
        written.push_str(&format!("<!-- keys: {title} -->\n{table}<!-- end -->{rest}"));
    }
    assert!(tables.is_empty(), "not in the reference: {:?}", tables.keys());
    if std::env::var_os("POSED_BLESS").is_some() {
        std::fs::write(&path, written).unwrap();
    } else {
        assert!(
            text == written,
            "config/README.md is not what the types say; see there how to write it anew"
        );
    }
}

/// Every example file is right, and the reference names it.
#[test]
fn every_file_in_config_loads_and_is_named_in_the_reference() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let readme = std::fs::read_to_string(folder.join("README.md")).unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            let stage = Stage::load(&path).unwrap_or_else(|error| panic!("{error}"));
            posed_pipeline::Pipeline::new(&stage)
                .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(posed_stage::check_in(&text, &folder).warnings, [], "{}", path.display());
            let name = path.file_name().unwrap().to_str().unwrap();
            assert!(readme.contains(&format!("`{name}`")), "config/README.md does not name {name}");
            count += 1;
        }
    }
    assert!(count >= 2, "only {count} files in config/");
}
