//! What other machines send over zenoh. The module that reads it is taken as a file: its crate links all of zenoh.

#[path = "../../../crates/mesh/src/frame.rs"]
mod frame;
#[path = "../../../crates/mesh/src/wire.rs"]
#[expect(dead_code, reason = "half of it is only written")]
mod wire;

use posed_daemon::server::Item;
use posed_drivers::Timestamp;
use posed_protocol::{Counters, Fields, Publisher, Selection, Stamp, Topic, Wish, unpack};
use posed_recording::{Header, Machine, Replayable, Snapshot};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};
use posed_stage::output::Output;

use crate::stand::{STANDS, Stand};

/// The first byte chooses what it is.
///
/// - An item of the feed: published by a stage's end at the hub.
/// - The answer of a stage that is joined: its stage file, and the events and states before.
/// - A piece of the input log: what the pipeline that fuses at the hub is given.
/// - The beginning of a log: the machine that it makes.
/// - Tokens: keys of stages and runs.
pub(crate) fn message(data: &[u8]) {
    let Some((&choice, payload)) = data.split_first() else { return };
    match choice % 6 {
        0 => fed(&STANDS[0].stage, payload),
        1 => {
            let Ok(joined) = unpack::<wire::Joined>(payload) else { return };
            let Ok(stage) = Stage::parse(&joined.stage_toml) else { return };
            joined.events.iter().chain(&joined.states).for_each(|bytes| fed(&stage, &bytes.0));
        }
        2 => {
            let Ok(chunk) = unpack::<wire::LogChunk>(payload) else { return };
            let mut pipeline = STANDS[3].pipeline.clone();
            for entry in chunk.entries.iter().map_while(|bytes| unpack::<Entry>(&bytes.0).ok()) {
                pipeline.push(&entry, &mut |_| {});
            }
        }
        3 => {
            let Ok(begin) = unpack::<wire::Begin>(payload) else { return };
            let Ok((_, mut machine)) = Machine::as_recorded(&begin.header) else { return };
            machine.push(&Entry { t: Timestamp::ZERO, input: Input::Timer }, &mut |_, _, _| {});
        }
        4 => _ = unpack::<wire::ClockReading>(payload),
        _ => {
            let Ok(token) = std::str::from_utf8(payload) else { return };
            if let Some(keys) = wire::Keys::of_token(token) {
                assert_eq!(keys.token(), token);
            }
            if let Some((keys, run)) = wire::Keys::of_run(token) {
                assert_eq!(keys.run(run), token);
            }
            if let Some(wish) = wire::Keys::wish_of(token) {
                let again = wire::Keys::wish_of(&wire::Keys::new("a").wish("hub", &wish));
                assert_eq!(again, Some(wish), "a wish reads as it is written");
            }
        }
    }
}

/// An item of the feed: what the hub makes of it for its own clients.
fn fed(stage: &Stage, payload: &[u8]) {
    let Ok((head, item, _)) = wire::read_fed(payload) else { return };
    let mut counters = Counters::default();
    counters.follow(&head.stamp);
    let _ = (head.stamp.t_s(), head.stamp.t());
    if let Some(payload) = item.payload() {
        let mut publisher = Publisher::new(stage, Fields::all());
        let (_, message) = publisher.publish(&payload);
        assert!(serde_json::from_slice::<serde_json::Value>(message).is_ok(), "a message that is none");
    }
}

/// What a stage publishes of an output.
pub(crate) fn item(output: &Output<'_>) -> Option<Item> {
    Some(match output {
        Output::Estimate(estimate) => Item::Estimate((*estimate).clone()),
        Output::Body(body) => Item::Body(Box::new((*body).clone())),
        Output::Outcome(outcome) => Item::Outcome(Box::new((*outcome).clone())),
        _ => return None,
    })
}

/// An item as it travels.
pub(crate) fn fed_bytes(stamp: Stamp, item: &Item) -> Vec<u8> {
    wire::write_fed(&wire::Head { run: 1, last_event_id: 1, stamp }, item, &Selection::whole())
        .expect("plain data")
}

/// Seeds of what is no item of the feed.
pub(crate) fn others(stand: &Stand, stage_toml: &str) -> Vec<(String, Vec<u8>)> {
    let pack = |choice: u8, bytes: Result<Vec<u8>, rmp_serde::encode::Error>| {
        [&[choice], &bytes.expect("plain data")[..]].concat()
    };
    let entries: Vec<_> = stand.next[..8]
        .iter()
        .map(|entry| wire::Bytes(rmp_serde::to_vec_named(entry).expect("plain data")))
        .collect();
    let joined = wire::Joined {
        wire: wire::VERSION,
        version: "1".into(),
        run: 1,
        stage_toml: stage_toml.into(),
        topics: vec![Topic::Sensors],
        last_event_id: 0,
        complete: true,
        events: vec![],
        states: vec![],
    };
    let publisher =
        rmp_serde::to_vec(&Publisher::new(&stand.stage, Fields::all()).state()).expect("plain data");
    let header = Header {
        snapshot: Some(Snapshot { pipeline: stand.pipeline.snapshot(), publisher }),
        ..Header::new(&stand.stage, stage_toml, 0)
    };
    let keys = wire::Keys::new("a/b");
    let mut wish = Wish::default();
    wish.add(Topic::Sensors, Some(60.0));
    wish.select(Fields::default(), Some(&[0, 1]));
    vec![
        ("joined".into(), pack(1, rmp_serde::to_vec_named(&joined))),
        ("log".into(), pack(2, rmp_serde::to_vec(&wire::LogChunk { run: 1, first: 0, entries }))),
        ("begin".into(), pack(3, rmp_serde::to_vec_named(&wire::Begin { next: 0, header }))),
        (
            "clock".into(),
            pack(4, rmp_serde::to_vec(&wire::ClockReading { run: 1, t_ns: 5, frames: 7, last_event_id: 1 })),
        ),
        ("token".into(), [&[5], keys.token().as_bytes()].concat()),
        ("run".into(), [&[5], keys.run("77").as_bytes()].concat()),
        ("wish".into(), [&[5], keys.wish("77", &wish).as_bytes()].concat()),
    ]
}
