//! How bytes become a request.
//!
//! Nothing a client sends may end in a panic: whatever cannot be read is a [`ParseError`] with the request's id, if it
//! had one, a code and a sentence.

use serde::Deserialize;
use serde_json::Value;

use super::{Request, RequestId};
use crate::Encoding;
use crate::packed::DEPTH;

/// Why a client's message is no request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParseError {
    /// The request's id; `None` where not even that could be read.
    pub id: Option<RequestId>,
    /// For programs: `bad_message`, `bad_request` or `unknown_type`.
    pub code: &'static str,
    /// For people: what is wrong, in one sentence.
    pub message: String,
}

const FEEDS: [&str; 3] = ["subscribe", "unsubscribe", "resume"];
const CALLS: [&str; 54] = [
    "record.start",
    "record.stop",
    "mark",
    "replay.list",
    "replay.track",
    "replay.open",
    "replay.seek",
    "replay.speed",
    "replay.look",
    "replay.labels",
    "replay.label",
    "library.list",
    "library.digest",
    "library.rename",
    "library.remove",
    "library.restore",
    "library.empty_bin",
    "library.export",
    "health.history",
    "field.start",
    "field.finish",
    "field.accept",
    "field.rollback",
    "exercise.list",
    "exercise.demonstration",
    "exercise.teach",
    "exercise.select",
    "exercise.reset",
    "body.calibrate",
    "heading.reset",
    "faults.train",
    "faults.name_cell",
    "segments.train",
    "stage.align",
    "imu.calibrate",
    "session.begin",
    "session.end",
    "session.list",
    "session.show",
    "session.report",
    "session.correct",
    "session.people",
    "session.forget",
    "session.plans",
    "session.save_plan",
    "session.delete_plan",
    "setup.read",
    "setup.save",
    "setup.find",
    "phone.invite",
    "phone.list",
    "phone.blink",
    "job.cancel",
    "model.load",
];
const LONGEST_ID: usize = 64;

/// Reads one message of a client: a flat map with `type` and `id`, whole in `bytes`. Whether names and numbers in it make sense
/// on the stage is not looked at.
///
/// # Errors
/// Reports why it is none, with the request's id where there is one: `bad_message` is no JSON or MessagePack or no map,
/// `bad_request` has no `id` or `type` that serves or keys that do not fit its type, `unknown_type` is a request that this
/// version does not have.
pub fn parse(encoding: Encoding, bytes: &[u8]) -> Result<(RequestId, Request), ParseError> {
    let refuse = |id: Option<&RequestId>, code, message| ParseError { id: id.cloned(), code, message };
    let value: Value = match encoding {
        Encoding::Json => serde_json::from_slice(bytes).map_err(|e| format!("this is not JSON: {e}")),
        Encoding::MessagePack => read_message_pack(bytes),
    }
    .map_err(|message| refuse(None, "bad_message", message))?;
    let Value::Object(mut map) = value else {
        return Err(refuse(None, "bad_message", "a message is a map with `type` and `id`".into()));
    };
    let id = match map.remove("id") {
        None => Err("every request needs an `id`, a whole number or a text"),
        Some(id) => match serde_json::from_value(id) {
            Ok(RequestId::Text(text)) if text.len() > LONGEST_ID => Err("an `id` has at most 64 bytes"),
            Ok(id) => Ok(id),
            Err(_) => Err("an `id` is a whole number or a text"),
        },
    }
    .map_err(|message| refuse(None, "bad_request", message.into()))?;
    let Some(kind) = map.get("type").and_then(Value::as_str).map(str::to_owned) else {
        return Err(refuse(Some(&id), "bad_request", "every request needs a `type`".into()));
    };
    let read = if FEEDS.contains(&kind.as_str()) {
        serde_json::from_value(Value::Object(map)).map(Request::Feed)
    } else if CALLS.contains(&kind.as_str()) {
        serde_json::from_value(Value::Object(map)).map(Request::Call)
    } else {
        return Err(refuse(Some(&id), "unknown_type", unknown_type(&kind)));
    };
    match read {
        Ok(request) => Ok((id, request)),
        Err(error) => Err(refuse(Some(&id), "bad_request", format!("{}: {error}", shortened(&kind)))),
    }
}

fn read_message_pack(bytes: &[u8]) -> Result<Value, String> {
    let mut rest = bytes;
    let mut deserializer = rmp_serde::Deserializer::new(&mut rest);
    deserializer.set_max_depth(DEPTH);
    let value = Value::deserialize(&mut deserializer).map_err(|e| format!("this is not MessagePack: {e}"))?;
    if rest.is_empty() { Ok(value) } else { Err("bytes follow the message".into()) }
}

fn unknown_type(kind: &str) -> String {
    let nearest = FEEDS
        .iter()
        .chain(&CALLS)
        .map(|known| (strsim::damerau_levenshtein(known, &shortened(kind)), *known))
        .min_by_key(|(distance, _)| *distance);
    match nearest {
        Some((distance, known)) if distance <= 3 => {
            format!("there is no request `{}`; did you mean `{known}`?", shortened(kind))
        }
        _ => format!("there is no request `{}` in this version", shortened(kind)),
    }
}

fn shortened(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Requests of every kind, for tests and as seeds of the fuzz target.
#[doc(hidden)]
pub const REQUEST_EXAMPLES: [&str; 57] = [
    r#"{"type":"subscribe","id":1,"topics":["sensors"],"max_rate_hz":30,"sensors":["a"],"fields":["raw"],"drop":"queue"}"#,
    r#"{"type":"unsubscribe","id":"x","topics":["status","body"]}"#,
    r#"{"type":"resume","id":1,"after":7}"#,
    r#"{"type":"record.start","id":1}"#,
    r#"{"type":"record.stop","id":1}"#,
    r#"{"type":"mark","id":1,"label":"pain here"}"#,
    r#"{"type":"replay.list","id":1}"#,
    r#"{"type":"replay.track","id":1,"name":"a.mcap","columns":["a.x"]}"#,
    r#"{"type":"replay.open","id":1,"name":"a.mcap"}"#,
    r#"{"type":"replay.seek","id":1,"t_s":3}"#,
    r#"{"type":"replay.speed","id":1,"speed":"max"}"#,
    r#"{"type":"replay.speed","id":1,"speed":0.5}"#,
    r#"{"type":"replay.look","id":1,"t_s":2.5}"#,
    r#"{"type":"replay.labels","id":1,"name":"a.mcap"}"#,
    r#"{"type":"replay.label","id":1,"name":"a.mcap","from_s":1,"to_s":2.5,"label":"walk"}"#,
    r#"{"type":"library.list","id":1,"bin":true}"#,
    r#"{"type":"library.digest","id":1,"name":"a.mcap","make":true}"#,
    r#"{"type":"library.rename","id":1,"name":"a.mcap","to":"b"}"#,
    r#"{"type":"library.remove","id":1,"name":"a.mcap"}"#,
    r#"{"type":"library.restore","id":1,"name":"a.mcap"}"#,
    r#"{"type":"library.empty_bin","id":1}"#,
    r#"{"type":"library.export","id":1,"name":"a.mcap","format":"bvh","bones":"mixamo","body":"anna"}"#,
    r#"{"type":"health.history","id":1}"#,
    r#"{"type":"field.start","id":1,"sensors":["a","b","c"],"spacing_m":0.3}"#,
    r#"{"type":"field.finish","id":1,"anchors":[{"name":"p","sensor":"a","t_start":1,"t_end":2,"position_m":[1,0,0]}]}"#,
    r#"{"type":"field.accept","id":1}"#,
    r#"{"type":"field.rollback","id":1}"#,
    r#"{"type":"job.cancel","id":1,"job":3}"#,
    r#"{"type":"heading.reset","id":1,"sensor":"a","heading_deg":90}"#,
    r#"{"type":"stage.align","id":1,"sensor":"a","anchors":[{"name":"door","position_m":[1,0,0]}]}"#,
    r#"{"type":"imu.calibrate","id":1,"sensor":"a"}"#,
    r#"{"type":"exercise.list","id":1}"#,
    r#"{"type":"exercise.demonstration","id":1,"exercise":"curl"}"#,
    r#"{"type":"exercise.teach","id":1,"name":"curl","repetitions":5,"last_s":30,"sensors":["a"]}"#,
    r#"{"type":"exercise.select","id":1,"exercises":["curl"],"repetitions":10,"sets":3,"rest_s":60}"#,
    r#"{"type":"exercise.reset","id":1,"subject":"a"}"#,
    r#"{"type":"faults.train","id":1,"last_s":120}"#,
    r#"{"type":"faults.train","id":1,"recording":"a.mcap"}"#,
    r#"{"type":"faults.name_cell","id":1,"row":0,"column":3,"class":"clean"}"#,
    r#"{"type":"session.begin","id":1,"person":"P-17","plan":"week 3","subject":"a"}"#,
    r#"{"type":"session.end","id":1}"#,
    r#"{"type":"session.list","id":1,"person":"P-17","limit":10}"#,
    r#"{"type":"session.show","id":1,"session":12}"#,
    r#"{"type":"session.report","id":1,"person":"P-17","language":"german","time_zone":"Europe/Berlin"}"#,
    r#"{"type":"session.correct","id":1,"session":12,"set":1,"counted":10}"#,
    r#"{"type":"session.people","id":1}"#,
    r#"{"type":"session.forget","id":1,"person":"P-17","recordings":true}"#,
    r#"{"type":"session.plans","id":1}"#,
    r#"{"type":"session.save_plan","id":1,"plan":{"name":"week 3","steps":[{"exercise":"curl","sets":3,"repetitions":8,"rest_s":60}]}}"#,
    r#"{"type":"session.delete_plan","id":1,"name":"week 3"}"#,
    r#"{"type":"setup.read","id":1,"changes":[{"change":"set","table":"sensor","name":"a","key":"segment","value":"head"}]}"#,
    r#"{"type":"setup.save","id":1,"changes":[{"change":"name_stage","name":"hall"}],"revision":"a1"}"#,
    r#"{"type":"setup.find","id":1,"port":"tcp://10.0.0.7:7000"}"#,
    r#"{"type":"phone.invite","id":1}"#,
    r#"{"type":"phone.list","id":1}"#,
    r#"{"type":"phone.blink","id":1,"phone_id":"phone-3f9a01c2"}"#,
    r#"{"type":"model.load","id":1,"model":{"kind":"transmitter","position_m":[0,0,1],"orientation_wxyz":[1,0,0,0]}}"#,
];

/// Body of the fuzz target: bytes of a client in either encoding, and what can be read is written and read again.
///
/// # Panics
/// What was read does not come back as the same request.
pub fn fuzz_client_message(data: &[u8]) {
    for encoding in [Encoding::Json, Encoding::MessagePack] {
        let Ok((id, request)) = parse(encoding, data) else { continue };
        let again = match &request {
            Request::Feed(feed) => serde_json::to_value(feed),
            Request::Call(call) => serde_json::to_value(call),
        };
        let Ok(Value::Object(mut map)) = again else { panic!("a request is a map") };
        map.insert("id".into(), serde_json::json!(id));
        let text = Value::Object(map).to_string();
        assert_eq!(parse(Encoding::Json, text.as_bytes()), Ok((id, request)), "{text}");
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn json(text: &str) -> Result<(RequestId, Request), ParseError> {
        parse(Encoding::Json, text.as_bytes())
    }

    #[test]
    fn reads_every_request() {
        for text in REQUEST_EXAMPLES {
            let request = json(text).unwrap_or_else(|error| panic!("{text}: {error:?}"));
            let value: Value = serde_json::from_str(text).unwrap();
            let packed = rmp_serde::to_vec(&value).unwrap();
            assert_eq!(parse(Encoding::MessagePack, &packed).unwrap(), request, "{text}");
            fuzz_client_message(text.as_bytes());
            fuzz_client_message(&packed);
        }
    }

    #[test]
    fn says_what_is_wrong_and_with_which_request() {
        let errors = [
            "{",
            "[]",
            r#"{"type":"subscribe","topics":[]}"#,
            r#"{"type":"subscribe","id":1.5,"topics":[]}"#,
            r#"{"id":1}"#,
            r#"{"id":2,"type":"subscrib"}"#,
            r#"{"id":3,"type":"teleport.home"}"#,
            r#"{"id":4,"type":"subscribe","topics":["sensor"]}"#,
            r#"{"id":5,"type":"subscribe","topics":["sensors"],"rate":3}"#,
            r#"{"id":"six","type":"resume"}"#,
        ]
        .map(|text| {
            let error = json(text).expect_err(text);
            format!("{text}\n  -> {:?} {}: {}", error.id, error.code, error.message)
        });
        insta::assert_snapshot!(errors.join("\n"));
    }

    #[test]
    fn deep_nesting_is_an_error() {
        let text = format!("{}{}", "[".repeat(30_000), "]".repeat(30_000));
        assert_eq!(json(&text).unwrap_err().code, "bad_message");
        let packed = vec![0x91; 60_000];
        assert_eq!(parse(Encoding::MessagePack, &packed).unwrap_err().code, "bad_message");
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_request_or_an_error(data in proptest::collection::vec(any::<u8>(), 0..200)) {
            fuzz_client_message(&data);
        }
    }
}
