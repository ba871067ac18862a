//! Frames of the Foxglove websocket protocol, version 1: text both ways, binary to the viewer, little-endian.
//!
//! In: what a viewer wrote; channels, times, payloads. Out: requests or a sentence why it is none; frames. It knows no socket.

use serde::Serialize;
use serde_json::{Value, json};

use super::Channel;

/// Names of the websocket sub-protocol, the newer one first; the frames are the same.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Longest piece of a viewer's words that is said back, bytes.
const QUOTED: usize = 80;

/// What a viewer can ask for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Send these channels.
    Subscribe(Vec<Subscription>),
    /// End these subscriptions, by the viewer's numbers.
    Unsubscribe(Vec<u32>),
}

/// A channel under a number that the viewer has chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription {
    /// The viewer's number: message data carries it.
    pub id: u32,
    /// The channel's number, as advertised.
    pub channel_id: u64,
}

/// How grave a status is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Something to know.
    Info = 0,
    /// Something to look after.
    Warning = 1,
    /// Something was refused.
    Error = 2,
}

/// Who speaks.
#[derive(Clone, Copy, Debug)]
pub struct ServerInfo<'a> {
    /// The stage's name.
    pub stage: &'a str,
    /// When its time 0 was, RFC 3339.
    pub epoch_utc: &'a str,
    /// Another one after every start of the daemon.
    pub session: &'a str,
    /// Whether the viewer's clock is to follow [`time`] frames, as in a replay.
    pub time: bool,
}

/// The first message to a viewer, JSON text.
pub fn server_info(info: &ServerInfo<'_>) -> String {
    let capabilities: &[&str] = if info.time { &["time"] } else { &[] };
    json!({
        "op": "serverInfo",
        "name": format!("posed: {}", info.stage),
        "capabilities": capabilities,
        "supportedEncodings": [],
        "metadata": { "version": env!("CARGO_PKG_VERSION"), "stage": info.stage, "epoch_utc": info.epoch_utc },
        "sessionId": info.session,
    })
    .to_string()
}

/// What there is, JSON text; a channel's number is its place in the list, from 1.
pub fn advertise(channels: &[Channel]) -> String {
    #[derive(Serialize)]
    #[serde(rename_all = "camelCase")]
    struct Advertised<'a> {
        id: usize,
        topic: &'a str,
        encoding: &'a str,
        schema_name: &'a str,
        schema_encoding: &'a str,
        schema: &'a str,
    }
    let channels: Vec<_> = (1..)
        .zip(channels)
        .map(|(id, channel)| Advertised {
            id,
            topic: &channel.topic,
            encoding: "json",
            schema_name: &channel.schema_name,
            schema_encoding: "jsonschema",
            schema: &channel.schema,
        })
        .collect();
    json!({ "op": "advertise", "channels": channels }).to_string()
}

/// The place, from 0, of a channel's number in a list of `channels` channels; `None` for a number that was not advertised.
pub fn place(channel_id: u64, channels: usize) -> Option<usize> {
    let place = usize::try_from(channel_id).ok()?.checked_sub(1)?;
    (place < channels).then_some(place)
}

/// A sentence that the viewer shows, as JSON text; with an `id` until another one or [`remove_status`] takes its place.
pub fn status(level: Level, message: &str, id: Option<&str>) -> String {
    let mut status = json!({ "op": "status", "level": level as u8, "message": message });
    if let Some(id) = id {
        status["id"] = json!(id);
    }
    status.to_string()
}

/// Takes the sentences of these ids back, JSON text.
pub fn remove_status(ids: &[&str]) -> String {
    json!({ "op": "removeStatus", "statusIds": ids }).to_string()
}

/// Appends a message of a channel to `out` as a binary frame: `subscription` is the viewer's number, `utc_ns` the message's time,
/// ns since 1970, `payload` its JSON text.
pub fn message_data(subscription: u32, utc_ns: u64, payload: &[u8], out: &mut Vec<u8>) {
    out.reserve(13 + payload.len());
    out.push(1);
    out.extend_from_slice(&subscription.to_le_bytes());
    out.extend_from_slice(&utc_ns.to_le_bytes());
    out.extend_from_slice(payload);
}

/// Appends the time that the viewer's clock is to show, UTC, ns since 1970, as a binary frame.
pub fn time(utc_ns: u64, out: &mut Vec<u8>) {
    out.push(2);
    out.extend_from_slice(&utc_ns.to_le_bytes());
}

/// Reads a viewer's text message.
///
/// # Errors
/// A sentence for the viewer: it is no request, or one that is not served here.
pub fn parse(text: &[u8]) -> Result<Request, String> {
    #[derive(serde::Deserialize)]
    struct Subscribe {
        subscriptions: Vec<Subscription>,
    }
    #[derive(serde::Deserialize)]
    #[serde(rename_all = "camelCase")]
    struct Unsubscribe {
        subscription_ids: Vec<u32>,
    }
    let value: Value = serde_json::from_slice(text)
        .map_err(|error| format!("this is no JSON: {}", quoted(&error.to_string())))?;
    let Some(op) = value.get("op").and_then(Value::as_str).map(quoted) else {
        return Err("a message is an object with a text `op`".to_owned());
    };
    let wrong = |error: serde_json::Error| format!("`{op}` cannot be read: {}", quoted(&error.to_string()));
    match op.as_str() {
        "subscribe" => serde_json::from_value(value)
            .map_err(wrong)
            .map(|Subscribe { subscriptions }| Request::Subscribe(subscriptions)),
        "unsubscribe" => serde_json::from_value(value)
            .map_err(wrong)
            .map(|Unsubscribe { subscription_ids }| Request::Unsubscribe(subscription_ids)),
        "advertise"
        | "unadvertise"
        | "getParameters"
        | "setParameters"
        | "subscribeParameterUpdates"
        | "unsubscribeParameterUpdates"
        | "subscribeConnectionGraph"
        | "unsubscribeConnectionGraph"
        | "fetchAsset" => {
            Err(format!("`{op}` is not served here: this stage is watched, and operated on its own page"))
        }
        _ => Err(format!("`{op}` is no request of this protocol")),
    }
}

/// The beginning of foreign words.
fn quoted(text: &str) -> String {
    text[..text.floor_char_boundary(QUOTED)].to_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn frames_are_those_of_the_protocol() {
        let mut frame = Vec::new();
        message_data(7, 1_700_000_000_250_000_000, br#"{"a":1}"#, &mut frame);
        let expected = [
            0x01, 0x07, 0, 0, 0, 0x80, 0xb2, 0x10, 0x45, 0xfe, 0x9c, 0x97, 0x17, 0x7b, 0x22, 0x61, 0x22,
            0x3a, 0x31, 0x7d,
        ];
        assert_eq!(frame, expected);
        let mut frame = Vec::new();
        time(1_700_000_000_250_000_000, &mut frame);
        assert_eq!(frame, [2, 0x80, 0xb2, 0x10, 0x45, 0xfe, 0x9c, 0x97, 0x17]);
        assert_eq!(
            status(Level::Warning, "port away", Some("fob")),
            r#"{"id":"fob","level":1,"message":"port away","op":"status"}"#
        );
        assert_eq!(remove_status(&["fob"]), r#"{"op":"removeStatus","statusIds":["fob"]}"#);
    }

    #[test]
    fn requests_are_read_and_others_get_a_sentence() {
        let subscription = |id, channel_id| Subscription { id, channel_id };
        assert_eq!(
            parse(br#"{"op":"subscribe","subscriptions":[{"id":0,"channelId":3},{"id":9,"channelId":1,"x":2}]}"#),
            Ok(Request::Subscribe(vec![subscription(0, 3), subscription(9, 1)]))
        );
        assert_eq!(
            parse(br#"{"op":"unsubscribe","subscriptionIds":[4]}"#),
            Ok(Request::Unsubscribe(vec![4]))
        );
        for (bad, word) in [
            (&b"{"[..], "JSON"),
            (b"[]", "op"),
            (br#"{"op":3}"#, "op"),
            (br#"{"op":"subscribe"}"#, "subscriptions"),
            (br#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}"#, "subscribe"),
            (br#"{"op":"unsubscribe","subscriptionIds":"all"}"#, "unsubscribe"),
            (br#"{"op":"setParameters","parameters":[]}"#, "not served"),
            (br#"{"op":"dance"}"#, "dance"),
        ] {
            let sentence = parse(bad).unwrap_err();
            assert!(sentence.contains(word), "{sentence}");
        }
        assert_eq!((place(0, 3), place(1, 3), place(3, 3), place(4, 3)), (None, Some(0), Some(2), None));
        assert_eq!(place(u64::MAX, 3), None);
    }

    proptest! {
        #[test]
        fn no_message_of_a_viewer_is_too_much(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            op in "(subscribe|unsubscribe|advertise|[a-zé]{0,300})",
            list in prop::collection::vec(any::<i64>(), 0..50),
        ) {
            crate::foxglove::fuzz_viewer(&bytes);
            let shaped = json!({"op": op, "subscriptions": list, "subscriptionIds": list}).to_string();
            crate::foxglove::fuzz_viewer(shaped.as_bytes());
            // And half of it.
            crate::foxglove::fuzz_viewer(&shaped.as_bytes()[..shaped.len() / 2]);
        }
    }
}
