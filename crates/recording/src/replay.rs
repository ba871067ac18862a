//! Feeding a recording's log into the machine that made its messages, and holding the two against each other.
//!
//! What comes in: a recording, and whatever turns entries into messages. What goes out: the same entries, mapped by
//! name where the stage is another one, and the first message that a replay says differently. No clock: a replay
//! runs as fast as it is pulled.

use std::collections::VecDeque;
use std::io::Read;
use std::sync::Arc;

use posed_drivers::Timestamp;

use super::compare::{Comparison, Difference, is_replayed};
use super::ending::{Ending, ReadError};
use super::header::Header;
use super::reader::{Item, Message, Reader};
use posed_stage::input::{DeviceIndex, Entry, Input, SensorIndex};
use posed_stage::{RecordingContent, Stage};

/// What can be replayed: the pipeline with its publisher.
pub trait Replayable {
    /// Takes the next entry and gives `publish` every message that follows from it, in order: topic, stage time, JSON text.
    fn push(&mut self, entry: &Entry, publish: &mut dyn FnMut(&str, Timestamp, &[u8]));
}

/// From a recording's devices and sensors to those of the stage that replays it, by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mapping {
    devices: Vec<Option<DeviceIndex>>,
    sensors: Vec<Option<SensorIndex>>,
    /// Recorded devices that the stage does not have; their entries are left out.
    pub missing_devices: Vec<String>,
}

impl Mapping {
    /// Maps a recording onto `stage`. Sensors that the stage does not have lose their ground truth, and are not named.
    pub fn new(header: &Header, stage: &Stage) -> Self {
        let index = |at: Option<usize>| at.and_then(|at| u16::try_from(at).ok());
        let device = |name: &String| index(stage.devices.iter().position(|device| device.name == *name));
        let sensor = |name: &String| index(stage.sensors.iter().position(|sensor| sensor.name == *name));
        let missing = header.devices.iter().filter(|name| device(name).is_none());
        Self {
            devices: header.devices.iter().map(device).collect(),
            sensors: header.sensors.iter().map(sensor).collect(),
            missing_devices: missing.cloned().collect(),
        }
    }

    /// The entry as the stage sees it, its device and sensors by the stage's indices; `None` for a device that it does not have.
    pub fn entry(&self, mut entry: Entry) -> Option<Entry> {
        match &mut entry.input {
            Input::Bytes { device, .. } | Input::Line { device, .. } => {
                *device = self.devices.get(usize::from(*device)).copied().flatten()?;
            }
            Input::Truth(truth) => truth.sensors.retain_mut(|of| {
                let mapped = self.sensors.get(usize::from(of.sensor)).copied().flatten();
                of.sensor = mapped.unwrap_or(of.sensor);
                mapped.is_some()
            }),
            Input::Timer
            | Input::Model(_)
            | Input::Request(_)
            | Input::SegmentationNetwork(_)
            | Input::Timecode(_) => {}
        }
        Some(entry)
    }
}

/// What a verification found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Entries replayed.
    pub entries: u64,
    /// Messages that were recorded and said again.
    pub messages: u64,
    /// How the recording ends; always there. A torn one may lack the messages of its last entries.
    pub ending: Option<Ending>,
}

/// Why a verification failed.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    /// The recording cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It holds no messages.
    #[error("the recording holds its log alone, so there are no messages to hold the replay against")]
    LogOnly,
    /// The first message that the replay says differently, or that only one of the two has.
    #[error("the replay differs: {0}")]
    Different(#[from] Box<Difference>),
}

/// Replays a recording into `machine`, which stands as the recording began, and compares what it says with what was recorded,
/// message by message, on all topics that are replayed (see [`is_replayed`]).
///
/// # Errors
/// The recording cannot be read or holds no messages, or a message differs.
pub fn verify<R: Read>(
    reader: &mut Reader<R>,
    machine: &mut impl Replayable,
    comparison: Comparison,
) -> Result<Verdict, VerifyError> {
    if reader.header().content == RecordingContent::Log {
        return Err(VerifyError::LogOnly);
    }
    let mut recorded = VecDeque::new();
    let mut replayed = VecDeque::new();
    let (mut entries, mut messages) = (0, 0);
    for item in reader.by_ref() {
        match item? {
            Item::Entry(entry) => {
                entries += 1;
                machine.push(&entry, &mut |topic, t, json| {
                    if is_replayed(topic) {
                        replayed.push_back(Message { topic: Arc::from(topic), t, json: json.to_vec() });
                    }
                });
            }
            Item::Message(message) if is_replayed(&message.topic) => recorded.push_back(message),
            Item::Message(_) | Item::Transmitted { .. } => {}
        }
        while !recorded.is_empty()
            && let Some(got) = replayed.pop_front()
        {
            let Some(expected) = recorded.pop_front() else { break };
            messages += 1;
            comparison.compare(messages, &expected.json, &got.json)?;
        }
    }
    let ending = reader.ending();
    let left = |line, message: &Message, expected: &str, got: &str| {
        let (topic, path) = (message.topic.to_string(), "message".to_owned());
        Box::new(Difference { line, topic, path, expected: expected.to_owned(), got: got.to_owned() })
    };
    if let Some(message) = recorded.front() {
        let expected = String::from_utf8_lossy(&message.json);
        return Err(left(messages + 1, message, &expected, "no further message").into());
    }
    if let (Some(message), Some(Ending::Complete)) = (replayed.front(), ending) {
        let got = String::from_utf8_lossy(&message.json);
        return Err(left(messages + 1, message, "no further message", &got).into());
    }
    Ok(Verdict { entries, messages, ending })
}
