//! What is inside a recording: counts, times, names, and whether it is whole.

use std::collections::BTreeMap;
use std::path::Path;

use posed_drivers::Timestamp;
use serde::Serialize;

use super::digest::read_digest;
use super::ending::{Ending, ReadError};
use super::reader::{Item, Reader};
use super::timecode::{TimecodeInfo, TimecodeTrack};
use posed_protocol::DigestCounts;
use posed_stage::RecordingContent;
use posed_stage::input::Input;

/// Summary of a recording, made by reading all of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    /// Whole: index in place, no damage, no hole.
    pub complete: bool,
    /// What is wrong with it and what to do; null when complete.
    pub problem: Option<String>,
    /// Why it was ended; null where nobody ended it.
    pub ended: Option<String>,
    /// The stage's name.
    pub stage: String,
    /// Version of the software that wrote it.
    pub version: String,
    /// UTC of the stage's epoch, RFC 3339 with nanoseconds.
    pub epoch_utc: String,
    /// Stage time at which it begins, s.
    pub begun_s: f64,
    /// From its beginning to the last entry or message, s.
    pub duration_s: f64,
    /// What it holds beside its log: nothing but a few views, or everything.
    pub content: RecordingContent,
    /// Whether it begins with a snapshot, that is in the middle of a run.
    pub mid_run: bool,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// The stage's devices, in the stage file's order.
    pub devices: Vec<DeviceInfo>,
    /// Names of the stage's sensors, in the stage file's order.
    pub sensors: Vec<String>,
    /// Number of entries and messages by MCAP topic, up to the first damage; channels for viewers are not counted.
    pub topics: BTreeMap<String, u64>,
    /// How much happens in it, by its digest; null where it has none.
    pub digest: Option<DigestCounts>,
    /// Its time code; null where none was read.
    pub timecode: Option<TimecodeInfo>,
}

/// A device in a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DeviceInfo {
    /// Its name.
    pub name: String,
    /// Bytes read from it.
    pub bytes_in: u64,
    /// Bytes sent to it.
    pub bytes_out: u64,
}

impl Info {
    /// Reads a recording through; `progress` receives the bytes read so far.
    ///
    /// # Errors
    /// It cannot be opened or read, or is no recording. Damage further on is not an error: [`Info::problem`] says it.
    pub fn read(path: &Path, mut progress: impl FnMut(u64)) -> Result<Self, ReadError> {
        let mut reader = Reader::open(path)?;
        let header = reader.header().clone();
        let device = |name: &String| DeviceInfo { name: name.clone(), ..DeviceInfo::default() };
        let mut devices: Vec<_> = header.devices.iter().map(device).collect();
        let mut topics = BTreeMap::<String, u64>::new();
        let mut last = header.begun;
        let mut timecode = TimecodeTrack::new(&header);
        let mut problem = None;
        while let Some(item) = reader.next() {
            progress(reader.bytes_read());
            let item = match item {
                Ok(item) => item,
                Err(error @ ReadError::Io(_)) => return Err(error),
                Err(error) => {
                    problem = Some(error.to_string());
                    break;
                }
            };
            last = last.max(time(&item));
            if let Item::Entry(entry) = &item {
                timecode.entry(entry);
            }
            if let Item::Entry(entry) = &item
                && let Input::Bytes { device, bytes } = &entry.input
            {
                devices[usize::from(*device)].bytes_in += bytes.len() as u64;
            }
            if let Item::Transmitted { device, bytes, .. } = &item {
                devices[usize::from(*device)].bytes_out += bytes.len() as u64;
            }
            *topics.entry(topic(&item, &header.devices)).or_default() += 1;
        }
        if reader.ending() == Some(Ending::Torn) {
            problem = Some(
                "the recording breaks off: the program or the computer was stopped; `posed info --repair` completes it"
                    .to_owned(),
            );
        }
        Ok(Self {
            complete: problem.is_none(),
            problem,
            ended: reader.end_reason().map(str::to_owned),
            epoch_utc: rfc3339(header.epoch_utc_ns),
            begun_s: header.begun.as_secs_f64(),
            duration_s: last.seconds_since(header.begun),
            content: header.content,
            mid_run: header.snapshot.is_some(),
            bytes: std::fs::metadata(path)?.len(),
            stage: header.stage,
            version: header.version,
            sensors: header.sensors,
            devices,
            topics,
            digest: read_digest(path)?.map(|digest| digest.counts),
            timecode: timecode.info(last),
        })
    }
}

fn time(item: &Item) -> Timestamp {
    match item {
        Item::Entry(entry) => entry.t,
        Item::Message(message) => message.t,
        Item::Transmitted { t, .. } => *t,
    }
}

/// The MCAP topic of an item.
fn topic(item: &Item, devices: &[String]) -> String {
    let name = |device: u16| &devices[usize::from(device)];
    match item {
        Item::Message(message) => format!("/posed/{}", message.topic),
        Item::Transmitted { device, .. } => format!("/output/{}/bytes", name(*device)),
        Item::Entry(entry) => match &entry.input {
            Input::Bytes { device, .. } => format!("/input/{}/bytes", name(*device)),
            Input::Line { device, .. } => format!("/input/{}/line", name(*device)),
            Input::Timer => "/input/timer".to_owned(),
            Input::Model(_) => "/input/model".to_owned(),
            Input::Request(_) => "/input/request".to_owned(),
            Input::SegmentationNetwork(_) => "/input/segmentation_network".to_owned(),
            Input::Truth(_) => "/input/truth".to_owned(),
            Input::Timecode(_) => "/input/timecode".to_owned(),
        },
    }
}

/// A UTC time as RFC 3339 with nanoseconds.
pub(crate) fn rfc3339(utc_ns: i64) -> String {
    jiff::Timestamp::from_nanosecond(i128::from(utc_ns))
        .map_or_else(|_| format!("{utc_ns} ns"), |utc| format!("{utc:.9}"))
}
