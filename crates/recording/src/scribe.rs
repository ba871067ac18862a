//! Writing a recording from its log alone: what follows from an entry is made here.
//!
//! What comes in: a header and entries. What goes out: the recording that a live stage would have written, with as much beside
//! the log as the header says. The daemon does not need it, since it has made everything already.

use std::io::Write;

use posed_drivers::Timestamp;

use super::columns::Columns;
use super::digest::Digester;
use super::header::Header;
use super::machine::Machine;
use super::writer::{WriteError, Writer};
use posed_pipeline::Pipeline;
use posed_protocol::foxglove::Views;
use posed_protocol::{Payload, schema};
use posed_stage::RecordingContent;
use posed_stage::input::{DeviceIndex, Entry};

/// Writes entries, and what follows from them.
pub struct Scribe<W: Write> {
    machine: Machine,
    views: Views,
    content: RecordingContent,
    digester: Digester,
    columns: Option<Columns>,
    writer: Writer<W>,
}

impl<W: Write> Scribe<W> {
    /// Begins a recording, with the state that its header holds and columns where its stage file asks for them.
    ///
    /// # Errors
    /// The header's stage file or snapshot is of another version, the sink refuses, or a part of the header is too large.
    pub fn new(sink: W, header: Header) -> Result<Self, WriteError> {
        Self::begin(sink, header, false)
    }

    /// As [`Scribe::new`], with columns in any case.
    ///
    /// # Errors
    /// As for [`Scribe::new`].
    pub(super) fn with_columns(sink: W, header: Header) -> Result<Self, WriteError> {
        Self::begin(sink, header, true)
    }

    fn begin(sink: W, header: Header, has_columns: bool) -> Result<Self, WriteError> {
        let (stage, machine) = Machine::as_recorded(&header)?;
        let columns = (has_columns || stage.recording.columns).then(|| Columns::new(&stage));
        let content = header.content;
        let mut views = Views::new(&stage, header.epoch_utc_ns, content);
        header.models.iter().for_each(|model| views.swap(model));
        let digester = Digester::new(&stage, header.begun);
        let mut writer = Writer::new(sink, header)?;
        schema::of_topics().iter().for_each(|(topic, schema)| writer.declare(topic, schema));
        Ok(Self { machine, views, content, digester, columns, writer })
    }

    /// The pipeline as it stands.
    pub fn pipeline(&self) -> &Pipeline {
        &self.machine.pipeline
    }

    /// Appends an entry and what follows from it; returns how many messages that were, whether or not they are written.
    ///
    /// # Errors
    /// As for [`Writer::entry`].
    pub fn entry(&mut self, entry: &Entry) -> Result<u64, WriteError> {
        self.writer.entry(entry)?;
        let mut written = Ok(0);
        let Self { machine: Machine { pipeline, publisher }, views, content, digester, columns, writer } =
            self;
        digester.entry(entry.t);
        pipeline.push(entry, &mut |output| {
            digester.output(&output);
            let Some(payload) = Payload::of(&output) else { return };
            let Ok(messages) = written else { return };
            written = Ok(messages + 1);
            let stamp = match content {
                RecordingContent::Log => publisher.skip(&payload),
                RecordingContent::Full => {
                    let (stamp, json) = publisher.publish(&payload);
                    if let Err(error) = writer.message(stamp.topic.name(), stamp.t(), json) {
                        written = Err(error);
                    }
                    stamp
                }
            };
            views.publish(&payload, &stamp, |channel, json| {
                if let (Ok(_), Err(error)) = (&written, writer.view(channel, stamp.t(), json)) {
                    written = Err(error);
                }
            });
            let block = columns.as_mut().and_then(|columns| columns.publish(&payload, &stamp));
            if let (Ok(_), Some(Err(error))) = (&written, block.map(|block| writer.columns(&block))) {
                written = Err(error);
            }
        });
        written
    }

    /// Appends what was transmitted to a device at stage time `t`.
    ///
    /// # Errors
    /// As for [`Writer::transmitted`].
    pub fn transmitted(&mut self, device: DeviceIndex, t: Timestamp, bytes: &[u8]) -> Result<(), WriteError> {
        self.writer.transmitted(device, t, bytes)
    }

    /// Ends the chunk and hands everything to the sink, as a recorder does twice a second.
    ///
    /// # Errors
    /// The sink refuses.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.writer.flush()
    }

    /// Ends the recording with the last of its columns and its digest; `reason`, one sentence, states why it ended.
    ///
    /// # Errors
    /// The sink refuses.
    pub fn finish(self, reason: &str) -> Result<W, WriteError> {
        let Self { mut writer, columns, digester, .. } = self;
        if let Some(columns) = columns {
            writer.columns(&columns.finish())?;
        }
        writer.digest(&digester.finish())?;
        writer.finish(reason)
    }
}
