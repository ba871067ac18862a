//! What tests of recordings share.

#![allow(clippy::unwrap_used, missing_docs, reason = "helpers of tests")]

use std::io::{self, Cursor, Write};
use std::sync::{Arc, Mutex};

use posed_drivers::{LineEvent, Timestamp};

use super::{Header, Item, Message, Reader, Snapshot, Writer};
use posed_stage::input::{Entry, Input, Model, Truth, TruthSensor};
use posed_stage::{RecordingContent, Stage};

/// A stage file that is right.
pub const STAGE: &str = r#"
name = "Test stage"

[transmitter.pose_in_room]
position_m = [1.0, 2.0, 3.0]
orientation_wxyz = [0.0, 1.0, 0.0, 0.0]

[[device]]
name = "flock"
driver = "flock-of-birds"
port = "/dev/null"

[[device]]
name = "über/flock"
driver = "flock-of-birds"
port = "/dev/zero"

[[sensor]]
name = "left"
device = "flock"
address = 1

[[sensor]]
name = "right"
device = "über/flock"
address = 2
"#;

/// Header of that stage, begun mid-run.
pub fn header() -> Header {
    let stage = Stage::parse(STAGE).unwrap();
    Header {
        begun: Timestamp::from_nanos(-5),
        models: [model(0.5)].into_iter().collect(),
        snapshot: Some(Snapshot { pipeline: vec![0, 255, 7], publisher: vec![1] }),
        content: RecordingContent::Full,
        ..Header::new(&stage, STAGE, 1_700_000_000_123_456_789)
    }
}

/// The same of a recording that holds no more than its log.
pub fn lean_header() -> Header {
    Header { content: RecordingContent::Log, ..header() }
}

pub fn model(x_m: f64) -> Model {
    Model::Transmitter { position_m: [x_m, 0.1 + 0.2, -0.0], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] }
}

/// A chunk of bytes that hardly compress, different for every `n`.
pub fn chunk(n: i64) -> Entry {
    let mut state = (n as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let next = || {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
        (state >> 56) as u8
    };
    let bytes = std::iter::repeat_with(next).take(78).collect();
    Entry { t: Timestamp::from_nanos(n), input: Input::Bytes { device: (n % 2) as u16, bytes } }
}

/// One item of each kind, and again, with times that go back and forth.
pub fn items() -> Vec<Item> {
    let truth = TruthSensor {
        sensor: 1,
        position_m: [f64::MIN_POSITIVE, 1.0 / 3.0, f64::MAX],
        orientation_wxyz: [0.5; 4],
        class: "clean".to_owned(),
    };
    let entry = |nanos, input| Item::Entry(Entry { t: Timestamp::from_nanos(nanos), input });
    let line = |device, event| Input::Line { device, event };
    let message = |topic: &str, nanos, json: &str| {
        Item::Message(Message {
            topic: topic.into(),
            t: Timestamp::from_nanos(nanos),
            json: json.as_bytes().to_vec(),
        })
    };
    let mut items = Vec::new();
    for round in 0..3 {
        let t = i64::from(round) * 10_000_001;
        items.extend([
            entry(t + 1, line(0, LineEvent::Opened { modem_lines: true })),
            Item::Transmitted { device: 0, t: Timestamp::from_nanos(t + 1), bytes: vec![0x42, 0x00] },
            entry(t + 9, line(1, LineEvent::Closed { reason: "unplugged".to_owned() })),
            entry(t + 3, line(0, LineEvent::Dropped { bytes: u64::MAX })),
            Item::Entry(chunk(t + 4)),
            Item::Entry(chunk(t + 5)),
            entry(t + 5, Input::Bytes { device: 1, bytes: Vec::new() }),
            entry(t + 6, Input::Timer),
            message("sensors", t + 6, &sensors(t)),
            message("status", t + 6, r#"{"type":"status","seq":0,"dropped":0,"t_s":1}"#),
            entry(t + 7, Input::Model(model(f64::from(round)))),
            entry(
                t + 8,
                Input::Truth(Truth { t_valid: Timestamp::from_nanos(t), sensors: vec![truth.clone()] }),
            ),
        ]);
    }
    items.push(entry(i64::MAX, Input::Timer));
    items.push(entry(i64::MIN, Input::Timer));
    items
}

/// A message with a good sensor, a suspect one, and one that is missing.
pub fn sensors(nanos: i64) -> String {
    let t_s = nanos as f64 * 1e-9;
    format!(
        r#"{{"type":"sensors","seq":0,"dropped":0,"t_s":{t_s},"sensors":[{{"name":"left","state":"ok","position_m":[1.5,2.25,3.125],"orientation_wxyz":[1.0,0.0,0.0,0.0],"sigma_m":0.001}},{{"name":"right","state":"suspect","position_m":[1.0,2.0,3.0],"orientation_wxyz":[1.0,0.0,0.0,0.0]}},{{"name":"third","state":"missing","position_m":null,"orientation_wxyz":null}}]}}"#
    )
}

/// Writes an item.
pub fn write<W: Write>(writer: &mut Writer<W>, item: &Item) -> Result<(), super::WriteError> {
    match item {
        Item::Entry(entry) => writer.entry(entry),
        Item::Message(message) => writer.message(&message.topic, message.t, &message.json),
        Item::Transmitted { device, t, bytes } => writer.transmitted(*device, *t, bytes),
    }
}

/// A recording of `items` with a chunk's end after every `flush_every`th.
pub fn record(items: &[Item], flush_every: usize) -> Vec<u8> {
    record_with(header(), items, flush_every)
}

/// The same with another header.
pub fn record_with(header: Header, items: &[Item], flush_every: usize) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), header).unwrap();
    writer.declare("sensors", r#"{"type":"object"}"#);
    for (index, item) in items.iter().enumerate() {
        write(&mut writer, item).unwrap();
        if (index + 1) % flush_every == 0 {
            writer.flush().unwrap();
        }
    }
    writer.finish("test over").unwrap()
}

/// A reader of bytes in memory.
pub fn reader(bytes: &[u8]) -> Result<Reader<Cursor<Vec<u8>>>, super::ReadError> {
    Reader::new(Cursor::new(bytes.to_vec()), bytes.len() as u64)
}

/// A disk that is full after `left` more bytes; what it took can be looked at.
#[derive(Clone, Debug, Default)]
pub struct Full {
    pub left: usize,
    pub taken: Arc<Mutex<Vec<u8>>>,
}

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = bytes.len().min(self.left);
        if taken == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.left -= taken;
        self.taken.lock().unwrap().extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
