//! A recording with its messages, wherever they come from.
//!
//! What comes in: a recording. What goes out: its items in order, every entry followed by its messages: as they were recorded
//! or, where it holds no more than its log, made anew from that. Who reads messages reads them here.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use super::ending::ReadError;
use super::header::Header;
use super::machine::Machine;
use super::reader::{Item, Message, Reader};
use super::replay::Replayable;
use posed_stage::RecordingContent;

/// Iterates the items of a recording, messages among them, in order. After an error it ends.
pub struct Take<R> {
    reader: Reader<R>,
    /// Of a recording without messages.
    machine: Option<Machine>,
    /// Messages of the newest entry.
    messages: VecDeque<Message>,
}

impl Take<BufReader<File>> {
    /// Opens a recording.
    ///
    /// # Errors
    /// The file cannot be opened or read, or is no recording; it has no messages, and cannot be replayed by this version.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        Self::new(Reader::open(path)?)
    }
}

impl<R: Read> Take<R> {
    /// Goes on from a reader that stands at its beginning.
    ///
    /// # Errors
    /// The recording has no messages, and cannot be replayed by this version.
    pub fn new(reader: Reader<R>) -> Result<Self, ReadError> {
        let machine = match reader.header().content {
            RecordingContent::Full => None,
            RecordingContent::Log => Some(Machine::as_recorded(reader.header())?.1),
        };
        Ok(Self { reader, machine, messages: VecDeque::new() })
    }

    /// What stands in front.
    pub fn header(&self) -> &Header {
        self.reader.header()
    }

    /// Bytes of the file that have been read: how far it is.
    pub fn bytes_read(&self) -> u64 {
        self.reader.bytes_read()
    }
}

impl<R: Read> Iterator for Take<R> {
    type Item = Result<Item, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(message) = self.messages.pop_front() {
            return Some(Ok(Item::Message(message)));
        }
        let item = self.reader.next()?;
        if let (Some(machine), Ok(Item::Entry(entry))) = (&mut self.machine, &item) {
            let messages = &mut self.messages;
            machine.push(entry, &mut |topic, t, json| {
                messages.push_back(Message { topic: topic.into(), t, json: json.to_vec() });
            });
        }
        Some(item)
    }
}
