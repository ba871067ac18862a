//! Holds `config/README.md` against the types of the stage file.

use std::collections::BTreeMap;
use std::path::Path;

use posed::stage::Stage;
use serde_json::Value;

/// Tables of keys by the name of their place in the file, written from the JSON schema.
struct Reference {
    schema: Value,
    tables: BTreeMap<String, String>,
}

impl Reference {
    fn new() -> Self {
        let schema = schemars::schema_for!(Stage).to_value();
        let mut reference = Self { schema: schema.clone(), tables: BTreeMap::new() };
        reference.table("the file", "", &schema);
        reference
    }

    fn resolve<'a>(&'a self, schema: &'a Value) -> &'a Value {
        let optional =
            schema["anyOf"].as_array().and_then(|list| list.iter().find(|one| one["type"] != "null"));
        let schema = optional.unwrap_or(schema);
        match schema["$ref"].as_str().and_then(|path| path.strip_prefix("#/$defs/")) {
            Some(name) => &self.schema["$defs"][name],
            None => schema,
        }
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
            let inner = self.resolve(property).clone();
            let items = self.resolve(&inner["items"]).clone();
            let (value, has_keys) = if items["properties"].is_object() {
                (format!("`[[{below}]]` tables"), Some((format!("[[{below}]]"), items)))
            } else if inner["properties"].is_object() {
                (format!("`[{below}]` table"), Some((format!("[{below}]"), inner)))
            } else {
                (value_words(&inner), None)
            };
            let default = match &property["default"] {
                _ if required.contains(&name.as_str()) => "required".to_owned(),
                Value::Null | Value::Object(_) => String::new(),
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
        let alternatives = schema["oneOf"].as_array().into_iter().flatten();
        let tags: Vec<String> =
            alternatives.clone().map(|one| format!("`{}`", one["properties"]["driver"]["const"])).collect();
        if !tags.is_empty() {
            text.push_str(&format!("| `driver` | {} | required | The driver. |\n", tags.join(", ")));
        }
        for alternative in alternatives {
            let tag = alternative["properties"]["driver"]["const"].as_str().unwrap();
            self.table(&format!("{title} {tag}"), path, alternative);
        }
        self.tables.insert(title.to_owned(), text + "\n");
    }
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
            Some(count) => format!("[{count} numbers]"),
            None => "[list of text]".to_owned(),
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

/// Every key is in the reference, the reference has no key that is not, and each says what its type says.
#[test]
fn the_reference_of_every_key_agrees_with_the_types() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/README.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut tables = Reference::new().tables;
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
            Stage::load(&path).unwrap_or_else(|error| panic!("{error}"));
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(posed::stage::check_in(&text, &folder).warnings, [], "{}", path.display());
            let name = path.file_name().unwrap().to_str().unwrap();
            assert!(readme.contains(&format!("`{name}`")), "config/README.md does not name {name}");
            count += 1;
        }
    }
    assert!(count >= 2, "only {count} files in config/");
}
