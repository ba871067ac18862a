//! What stands in front of a recording, and how it is arranged in MCAP's terms.

use std::collections::BTreeMap;

use mcap::records::Metadata;
use posed_drivers::Timestamp;
use serde::{Deserialize, Serialize};

use posed_stage::{LoadedModels, RecordingContent, Stage, without_secrets};

/// Name of the metadata record that ends the front part.
pub(super) const METADATA: &str = "posed";
/// Name of the metadata record that ends the recording.
pub(super) const METADATA_END: &str = "posed.end";
/// Version of the layout described in [`super`].
const FORMAT: &str = "3";
/// The layout before, whose entries were never bundled and whose messages were always there.
const FORMAT_BEFORE: &str = "2";

const STAGE: &str = "stage.toml";
const MODELS: &str = "models.msgpack";
const PIPELINE: &str = "snapshot/pipeline";
const PUBLISHER: &str = "snapshot/publisher";

/// What a recording needs beside its log in order to be replayed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the software that wrote it.
    pub version: String,
    /// UTC of the stage's epoch, nanoseconds since 1970.
    pub epoch_utc_ns: i64,
    /// Stage time at which the recording began.
    pub begun: Timestamp,
    /// The stage's name.
    pub stage: String,
    /// The stage file's text, without its secrets.
    pub stage_toml: String,
    /// Names of the devices, in the order of `DeviceIndex`.
    pub devices: Vec<String>,
    /// Names of the sensors, in the order of `SensorIndex`.
    pub sensors: Vec<String>,
    /// Models that were in use when the recording began.
    pub models: LoadedModels,
    /// State at the beginning, for a recording begun mid-run; `None` for one that begins with the run.
    pub snapshot: Option<Snapshot>,
    /// What it holds beside its log.
    pub content: RecordingContent,
}

/// State from which a replay goes on; opaque here.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Snapshot {
    /// The pipeline's.
    #[serde(with = "posed_geometry::bytes")]
    pub pipeline: Vec<u8>,
    /// The publisher's: numbers given to messages so far.
    #[serde(with = "posed_geometry::bytes")]
    pub publisher: Vec<u8>,
}

/// An attachment of the front part.
pub(super) struct Part {
    pub(super) name: &'static str,
    pub(super) media_type: &'static str,
    pub(super) data: Vec<u8>,
}

impl Header {
    /// Header of a recording that begins with the run of `stage`, read from `stage_toml`, whose secrets are left out;
    /// `epoch_utc_ns` is the UTC of its epoch, ns since 1970. No models, no snapshot; the content is the stage's.
    pub fn new(stage: &Stage, stage_toml: &str, epoch_utc_ns: i64) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            epoch_utc_ns,
            begun: Timestamp::ZERO,
            stage: stage.name.clone(),
            stage_toml: without_secrets(stage_toml),
            devices: stage.devices.iter().map(|device| device.name.clone()).collect(),
            sensors: stage.sensors.iter().map(|sensor| sensor.name.clone()).collect(),
            models: LoadedModels::default(),
            snapshot: None,
            content: stage.recording.content,
        }
    }

    /// MCAP time of a stage time, ns since 1970. Wraps rather than saturates, so that it can be undone exactly.
    pub(super) fn log_time(&self, t: Timestamp) -> u64 {
        self.epoch_utc_ns.wrapping_add(t.as_nanos()) as u64
    }

    /// Stage time of an MCAP time.
    pub(super) fn stage_time(&self, log_time: u64) -> Timestamp {
        Timestamp::from_nanos((log_time as i64).wrapping_sub(self.epoch_utc_ns))
    }

    /// The attachments.
    pub(super) fn attachments(&self) -> Result<Vec<Part>, String> {
        let part = |name, media_type, data| Part { name, media_type, data };
        let mut attachments = vec![part(STAGE, "application/toml", self.stage_toml.clone().into_bytes())];
        if !self.models.is_empty() {
            let models = rmp_serde::to_vec_named(&self.models).map_err(|error| error.to_string())?;
            attachments.push(part(MODELS, "application/msgpack", models));
        }
        if let Some(Snapshot { pipeline, publisher }) = &self.snapshot {
            attachments.push(part(PIPELINE, "application/octet-stream", pipeline.clone()));
            attachments.push(part(PUBLISHER, "application/octet-stream", publisher.clone()));
        }
        Ok(attachments)
    }

    /// The metadata record.
    pub(super) fn metadata(&self) -> Result<Metadata, String> {
        let list = |names: &[String]| serde_json::to_string(names).map_err(|error| error.to_string());
        let metadata = [
            ("format", FORMAT.to_owned()),
            ("version", self.version.clone()),
            ("epoch_utc_ns", self.epoch_utc_ns.to_string()),
            ("begun_ns", self.begun.as_nanos().to_string()),
            ("stage", self.stage.clone()),
            ("devices", list(&self.devices)?),
            ("sensors", list(&self.sensors)?),
            ("content", content_name(self.content).to_owned()),
        ];
        let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        Ok(Metadata { name: METADATA.to_owned(), metadata })
    }

    /// Puts the header together again; the sentence states what is missing or wrong.
    pub(super) fn assemble(
        metadata: &BTreeMap<String, String>,
        attachments: &BTreeMap<String, Vec<u8>>,
    ) -> Result<Self, String> {
        let text = |key: &str| metadata.get(key).ok_or_else(|| format!("its metadata lacks `{key}`"));
        let wrong =
            |key: &str, error: &dyn std::fmt::Display| format!("its metadata `{key}` is wrong: {error}");
        let number = |key: &str| text(key)?.parse::<i64>().map_err(|error| wrong(key, &error));
        let names =
            |key: &str| serde_json::from_str::<Vec<String>>(text(key)?).map_err(|error| wrong(key, &error));
        let format = text("format")?;
        if format != FORMAT && format != FORMAT_BEFORE {
            return Err(format!(
                "its layout has version {format}; this program reads {FORMAT_BEFORE} and {FORMAT}"
            ));
        }
        let content = match metadata.get("content").map(String::as_str) {
            Some("log") => RecordingContent::Log,
            Some("full") => RecordingContent::Full,
            None if format == FORMAT_BEFORE => RecordingContent::Full,
            other => return Err(wrong("content", &format!("{other:?} is neither `log` nor `full`"))),
        };
        let stage_toml = attachments.get(STAGE).ok_or_else(|| format!("it holds no {STAGE}"))?;
        let stage_toml = String::from_utf8(stage_toml.clone())
            .map_err(|error| format!("its {STAGE} is wrong: {error}"))?;
        let models = match attachments.get(MODELS) {
            None => LoadedModels::default(),
            Some(bytes) => {
                posed_protocol::unpack(bytes).map_err(|error| format!("its {MODELS} is wrong: {error}"))?
            }
        };
        let snapshot = match (attachments.get(PIPELINE), attachments.get(PUBLISHER)) {
            (None, None) => None,
            (Some(pipeline), Some(publisher)) => {
                Some(Snapshot { pipeline: pipeline.clone(), publisher: publisher.clone() })
            }
            _ => return Err(format!("it holds only one of {PIPELINE} and {PUBLISHER}")),
        };
        Ok(Self {
            version: text("version")?.clone(),
            epoch_utc_ns: number("epoch_utc_ns")?,
            begun: Timestamp::from_nanos(number("begun_ns")?),
            stage: text("stage")?.clone(),
            stage_toml,
            devices: names("devices")?,
            sensors: names("sensors")?,
            models,
            snapshot,
            content,
        })
    }
}

/// As the metadata and the stage file spell it.
fn content_name(content: RecordingContent) -> &'static str {
    match content {
        RecordingContent::Log => "log",
        RecordingContent::Full => "full",
    }
}
