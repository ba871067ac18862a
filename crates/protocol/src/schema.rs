//! The published contract: JSON Schema and TypeScript types of all messages, generated from the Rust types.
//!
//! Both are committed under `docs/schema/`; a test fails when they change unnoticed (`POSED_BLESS=1` rewrites them).

use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use super::message::{
    Answers, Data, ExerciseEvent, Fault, FieldEvent, Figure, Found, Jobs, KeyPose, Mark, SegmentBody,
    Sensors, Sessions, Status, Timecode, Truths,
};
use super::plain::plain;
use super::{Call, Feed, RequestId, ServerMessage, Topic, typescript};

/// JSON Schema (draft 2020-12) of `ServerMessage` and `ClientMessage`.
pub fn json_schema() -> Value {
    // What the daemon writes always has its nullable keys; what clients write may leave them out.
    let mut written = SchemaSettings::draft2020_12().for_serialize().into_generator();
    let server = written.subschema_for::<ServerMessage>();
    let _ = written.subschema_for::<Answers>();
    let _ = written.subschema_for::<Found>();
    let mut read = SchemaSettings::draft2020_12().into_generator();
    let feed = read.subschema_for::<Feed>();
    let call = read.subschema_for::<Call>();
    let id = read.subschema_for::<RequestId>();
    let mut definitions = written.take_definitions(true);
    definitions.extend(read.take_definitions(true));
    for name in ["Feed", "Call"] {
        if let Some(Value::Array(variants)) =
            definitions.get_mut(name).and_then(|schema| schema.get_mut("oneOf"))
        {
            variants
                .iter_mut()
                .filter_map(Value::as_object_mut)
                .for_each(|variant| add_id(variant, id.as_value()));
        }
    }
    definitions.insert(
        "ClientMessage".into(),
        json!({ "description": "Everything a client can send.", "anyOf": [feed, call] }),
    );
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "posed.v1",
        "description": "Messages of the posed websocket, sub-protocols posed.v1 (JSON) and posed.v1.msgpack.",
        "anyOf": [server, { "$ref": "#/$defs/ClientMessage" }],
        "$defs": definitions,
    })
}

/// JSON Schema of one topic's messages as text, self-contained, for recordings and viewers: of the plain kind that viewers read.
pub fn of_topic(topic: Topic) -> String {
    let mut generator = SchemaSettings::draft2020_12().for_serialize().into_generator();
    let schema = match topic {
        Topic::Status => generator.root_schema_for::<Data<Status>>(),
        Topic::Sensors => generator.root_schema_for::<Data<Sensors>>(),
        Topic::Truth => generator.root_schema_for::<Data<Truths>>(),
        Topic::Jobs => generator.root_schema_for::<Data<Jobs>>(),
        Topic::Session => generator.root_schema_for::<Data<Sessions>>(),
        Topic::Faults => generator.root_schema_for::<Data<Fault>>(),
        Topic::Field => generator.root_schema_for::<Data<FieldEvent>>(),
        Topic::Exercise => generator.root_schema_for::<Data<ExerciseEvent>>(),
        Topic::Keyframes => generator.root_schema_for::<Data<KeyPose>>(),
        Topic::Body => generator.root_schema_for::<Data<Figure>>(),
        Topic::Marks => generator.root_schema_for::<Data<Mark>>(),
        Topic::Segments => generator.root_schema_for::<Data<SegmentBody>>(),
        Topic::Timecode => generator.root_schema_for::<Data<Timecode>>(),
    };
    let mut schema = plain(&schema.to_value());
    schema["properties"]["type"] = json!({ "type": "string" });
    schema.to_string()
}

/// [`of_topic`] for every topic, with its name.
pub fn of_topics() -> Vec<(&'static str, String)> {
    Topic::ALL.into_iter().map(|topic| (topic.name(), of_topic(topic))).collect()
}

/// TypeScript types of the messages of [`json_schema`], as the text of a file.
pub fn typescript() -> String {
    typescript::from_schema(&json_schema())
}

/// A request is flat: every variant carries the `id` beside its own keys.
fn add_id(variant: &mut Map<String, Value>, id: &Value) {
    let mut id = id.clone();
    if let Some(id) = id.as_object_mut() {
        id.insert("description".into(), "The reply carries it.".into());
    }
    if let Some(properties) = variant.entry("properties").or_insert_with(|| json!({})).as_object_mut() {
        properties.insert("id".into(), id);
    }
    if let Some(required) = variant.entry("required").or_insert_with(|| json!([])).as_array_mut() {
        required.push("id".into());
    }
}

/// The schema as committed: indented, with a newline at the end.
pub fn json_schema_text() -> String {
    format!("{:#}\n", json_schema())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn assert_committed(file: &str, generated: &str) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(file);
        if std::env::var_os("POSED_BLESS").is_some() {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, generated).unwrap();
        }
        let committed = std::fs::read_to_string(&path).unwrap();
        assert!(
            committed == generated,
            "the messages changed: clients are written against {file}; if the change is meant, run the \
             test with POSED_BLESS=1 and commit the file"
        );
    }

    #[test]
    fn committed_schema_is_that_of_the_types() {
        assert_committed("docs/schema/posed.v1.schema.json", &json_schema_text());
    }

    #[test]
    fn only_requests_have_answers() {
        let definitions = &json_schema()["$defs"];
        let kinds = |name: &str| definitions[name]["oneOf"].as_array().unwrap().clone();
        let requests: Vec<Value> = [kinds("Call"), kinds("Feed")].concat();
        let is_request = |name: &str| requests.iter().any(|one| one["properties"]["type"]["const"] == name);
        let answers = definitions["Answers"]["properties"].as_object().unwrap();
        let strangers: Vec<&String> = answers.keys().filter(|name| !is_request(name)).collect();
        assert!(strangers.is_empty() && answers.len() > 10, "{strangers:?}");
    }

    #[test]
    fn committed_typescript_is_that_of_the_types() {
        assert_committed("clients/typescript/src/posed.v1.ts", &typescript());
    }
}
