//! The schemas of Foxglove's that we fill, as JSON Schema with all that they require.

use serde_json::{Map, Value, json};

/// One of the schemas, by its name.
pub(super) fn published(name: &str) -> Value {
    let time = json!({
        "type": "object", "title": "time", "required": ["sec", "nsec"],
        "properties": {
            "sec": { "type": "integer", "minimum": 0 },
            "nsec": { "type": "integer", "minimum": 0, "maximum": 999_999_999 }
        }
    });
    let duration = {
        let mut duration = time.clone();
        duration["title"] = json!("duration");
        duration
    };
    let numbers = |title: &str, keys: &[&str]| {
        object(title, keys.iter().map(|key| (*key, json!({ "type": "number" }))))
    };
    let text = || json!({ "type": "string" });
    let list = |items: Value| json!({ "type": "array", "items": items });
    let vector = numbers("foxglove.Vector3", &["x", "y", "z"]);
    let point = numbers("foxglove.Point3", &["x", "y", "z"]);
    let color = numbers("foxglove.Color", &["r", "g", "b", "a"]);
    let rotation = numbers("foxglove.Quaternion", &["x", "y", "z", "w"]);
    let pose = object("foxglove.Pose", [("position", vector.clone()), ("orientation", rotation.clone())]);
    match name {
        "foxglove.FrameTransforms" => {
            let transform = object(
                "foxglove.FrameTransform",
                [
                    ("timestamp", time),
                    ("parent_frame_id", text()),
                    ("child_frame_id", text()),
                    ("translation", vector),
                    ("rotation", rotation),
                ],
            );
            object(name, [("transforms", list(transform))])
        }
        "foxglove.PoseInFrame" => object(name, [("timestamp", time), ("frame_id", text()), ("pose", pose)]),
        "foxglove.PosesInFrame" => {
            object(name, [("timestamp", time), ("frame_id", text()), ("poses", list(pose))])
        }
        "foxglove.Log" => object(
            name,
            [
                ("timestamp", time),
                ("level", levels()),
                ("message", text()),
                ("name", text()),
                ("file", text()),
                ("line", json!({ "type": "integer", "minimum": 0 })),
            ],
        ),
        _ => scene_update(&time, &duration, &point, &vector, &color, &pose),
    }
}

fn scene_update(
    time: &Value,
    duration: &Value,
    point: &Value,
    vector: &Value,
    color: &Value,
    pose: &Value,
) -> Value {
    let (integer, number, truth) = (
        json!({ "type": "integer", "minimum": 0 }),
        json!({ "type": "number" }),
        json!({ "type": "boolean" }),
    );
    let text = json!({ "type": "string" });
    let list = |items: &Value| json!({ "type": "array", "items": items });
    let empty = |title: &str| list(&object(title, []));
    let pair = object("foxglove.KeyValuePair", [("key", text.clone()), ("value", text.clone())]);
    let solid = |title: &str| {
        object(title, [("pose", pose.clone()), ("size", vector.clone()), ("color", color.clone())])
    };
    let line = object(
        "foxglove.LinePrimitive",
        [
            ("type", integer.clone()),
            ("pose", pose.clone()),
            ("thickness", number.clone()),
            ("scale_invariant", truth.clone()),
            ("points", list(point)),
            ("color", color.clone()),
            ("colors", list(color)),
            ("indices", list(&integer)),
        ],
    );
    let words = object(
        "foxglove.TextPrimitive",
        [
            ("pose", pose.clone()),
            ("billboard", truth.clone()),
            ("font_size", number),
            ("scale_invariant", truth.clone()),
            ("color", color.clone()),
            ("text", text.clone()),
        ],
    );
    let entity = object(
        "foxglove.SceneEntity",
        [
            ("timestamp", time.clone()),
            ("frame_id", text.clone()),
            ("id", text.clone()),
            ("lifetime", duration.clone()),
            ("frame_locked", truth),
            ("metadata", list(&pair)),
            ("arrows", empty("foxglove.ArrowPrimitive")),
            ("cubes", list(&solid("foxglove.CubePrimitive"))),
            ("spheres", list(&solid("foxglove.SpherePrimitive"))),
            ("cylinders", empty("foxglove.CylinderPrimitive")),
            ("lines", list(&line)),
            ("triangles", empty("foxglove.TriangleListPrimitive")),
            ("texts", list(&words)),
            ("models", empty("foxglove.ModelPrimitive")),
        ],
    );
    let deletion = object(
        "foxglove.SceneEntityDeletion",
        [("timestamp", time.clone()), ("type", integer), ("id", text)],
    );
    object("foxglove.SceneUpdate", [("deletions", list(&deletion)), ("entities", list(&entity))])
}

fn levels() -> Value {
    let levels = (0..).zip(["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"]);
    let levels: Vec<_> =
        levels.map(|(value, title): (u8, _)| json!({ "title": title, "const": value })).collect();
    json!({ "oneOf": levels })
}

/// An object all of whose fields are there.
fn object<'a>(title: &str, fields: impl IntoIterator<Item = (&'a str, Value)>) -> Value {
    let properties: Map<String, Value> = fields.into_iter().map(|(name, of)| (name.to_owned(), of)).collect();
    let required: Vec<_> = properties.keys().cloned().collect();
    json!({ "title": title, "type": "object", "required": required, "properties": properties })
}
