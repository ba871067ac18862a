//! The recorder: a thread that writes what the fusion thread saw and said.
//!
//! In: entries, messages and transmitted bytes over a bounded channel, in order. Out: a file, flushed and synced once
//! per second, so that `kill -9` or a power cut lose at most the last second. Never: a wait in the fusion thread. When the
//! disk cannot keep up, the recording ends with a reason: an input log with a hole would replay to something else.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use posed_drivers::Timestamp;

use crate::input::{DeviceIndex, Entry};
use crate::protocol::{Topic, schema};
use crate::recording::{Header, WriteError, Writer};

/// Items that wait for the disk: some seconds of a busy stage.
const CAPACITY: usize = 16 * 1024;
/// How much a crash may cost.
const FLUSH_INTERVAL: Duration = Duration::from_millis(900);

/// A recording in progress.
pub struct Recorder {
    path: PathBuf,
    name: String,
    started: Timestamp,
    bytes: Arc<AtomicU64>,
    items: Sender<Item>,
    failure: Arc<Mutex<Option<String>>>,
    thread: Option<JoinHandle<()>>,
}

enum Item {
    Entry(Entry),
    Message(Topic, Timestamp, Vec<u8>),
    Transmitted(DeviceIndex, Timestamp, Vec<u8>),
    Finish,
}

impl Recorder {
    /// Begins a recording in a new file at `path`, with the thread that writes it.
    ///
    /// # Errors
    /// One sentence: the file exists already, the folder is missing or may not be written to, the disk is full.
    pub fn start(path: &Path, header: Header) -> Result<Self, String> {
        let started = header.begun;
        let file = OpenOptions::new().write(true).create_new(true).open(path).map_err(|error| refused(path, &error))?;
        let writer = begin(file, header).map_err(|error| {
            // An empty file helps nobody.
            let _ = std::fs::remove_file(path);
            format!("cannot record to {}: {error}", path.display())
        })?;
        let bytes = writer.byte_counter();
        let (items, received) = bounded(CAPACITY);
        let failure = Arc::new(Mutex::new(None));
        let failed = Arc::clone(&failure);
        #[expect(clippy::disallowed_methods, reason = "the daemon owns the recorder's thread")]
        let thread = std::thread::Builder::new().name("recorder".into()).spawn(move || {
            if let Err(error) = write(writer, &received) {
                *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
            }
        });
        let thread = thread.map_err(|error| format!("the system gives no thread for the recording: {error}"))?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { path: path.to_owned(), name, started, bytes, items, failure, thread: Some(thread) })
    }

    /// Appends an entry of the input log.
    pub fn entry(&mut self, entry: &Entry) {
        self.send(Item::Entry(entry.clone()));
    }

    /// Appends a message as it was published.
    pub fn message(&mut self, topic: Topic, t: Timestamp, json: &[u8]) {
        self.send(Item::Message(topic, t, json.to_vec()));
    }

    /// Appends what was transmitted to a device.
    pub fn transmitted(&mut self, device: DeviceIndex, t: Timestamp, bytes: &[u8]) {
        self.send(Item::Transmitted(device, t, bytes.to_vec()));
    }

    /// Why the recording has ended by itself, if it has.
    pub fn failure(&self) -> Option<String> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Ends the recording; its index is written and everything is on the disk when this returns.
    ///
    /// # Errors
    /// One sentence, when it could not be written to its end.
    pub fn finish(mut self) -> Result<(), String> {
        let _ = self.items.send(Item::Finish);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            return Err("the recorder ended with a panic; please report this".into());
        }
        self.failure().map_or(Ok(()), Err)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Stage time at which it began.
    pub fn started(&self) -> Timestamp {
        self.started
    }

    fn send(&mut self, item: Item) {
        match self.items.try_send(item) {
            // A thread that is gone has left its reason.
            Ok(()) | Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => {
                let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
                failure.get_or_insert_with(|| {
                    "the disk is too slow for the data; record to a faster one".to_owned()
                });
            }
        }
    }
}

fn refused(path: &Path, error: &io::Error) -> String {
    let advice = match error.kind() {
        io::ErrorKind::AlreadyExists => "it exists already; choose another name",
        io::ErrorKind::NotFound => "its folder does not exist; make it first",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "this user may not write there; choose another folder"
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "the disk is full; delete old recordings",
        _ => "check the folder",
    };
    format!("cannot record to {}: {advice} ({error})", path.display())
}

fn begin(file: File, header: Header) -> Result<Writer<File>, WriteError> {
    let mut writer = Writer::new(file, header)?;
    for topic in Topic::ALL {
        if let Some(text) = schema::of_topic(topic) {
            writer.declare(topic.name(), &text);
        }
    }
    Ok(writer)
}

/// Writes until [`Item::Finish`], or until the fusion thread is gone.
#[expect(clippy::disallowed_methods, reason = "flushing once per second is the recorder's own clock")]
fn write(mut writer: Writer<File>, items: &Receiver<Item>) -> Result<(), WriteError> {
    let mut next_flush = Instant::now() + FLUSH_INTERVAL;
    loop {
        match items.recv_deadline(next_flush) {
            Ok(Item::Entry(entry)) => writer.entry(&entry)?,
            Ok(Item::Message(topic, t, json)) => writer.message(topic.name(), t, &json)?,
            Ok(Item::Transmitted(device, t, bytes)) => writer.transmitted(device, t, &bytes)?,
            Ok(Item::Finish) | Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
        }
        if Instant::now() >= next_flush {
            next_flush = Instant::now() + FLUSH_INTERVAL;
            writer.flush()?;
            writer.sink().sync_data()?;
        }
    }
    let file = writer.finish("stopped")?;
    file.sync_all()?;
    Ok(())
}
