//! The recording in progress: a thread that writes, behind a queue that never blocks the fusion thread.
//!
//! What comes in: entries, messages and transmitted bytes, in order. What goes out: a file that grows under its
//! final name and survives `kill -9` up to the last half second. A log with a hole cannot be replayed: where the disk
//! does not keep up, the recording ends with a reason, and tracking goes on. The same when the disk is full. The thread makes the
//! file, too: a disk may hang at that, and what comes meanwhile waits in the queue.

use std::fs::OpenOptions;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use posed_drivers::Timestamp;

use super::fault_points;
use posed_protocol::foxglove::Channel;
use posed_protocol::{Payload, Stamp};
use posed_recording::{Block, Columns, Digester, Header, WriteError, Writer, sync_folder_of};
use posed_stage::Stage;
use posed_stage::input::{DeviceIndex, Entry, Input};
use posed_stage::output::Output;

/// How often everything so far is brought to the disk: half of what may be lost.
const FLUSH_EVERY: Duration = Duration::from_millis(500);
/// How long a flush waits for the messages of the last entry.
const ENTRY_GRACE: Duration = Duration::from_millis(20);
/// Things that may wait for the disk: minutes of a large stage.
const QUEUE_ITEMS: usize = 1 << 16;
/// Bytes that may wait for the disk.
const QUEUE_BYTES: usize = 128 << 20;

/// What may wait for the disk.
#[derive(Clone, Copy, Debug)]
struct Room {
    items: usize,
    bytes: usize,
}

/// How a recording stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum RecorderState {
    /// It is being written.
    Recording,
    /// It was ended in order, or is about to be; the sentence states by whom.
    Stopped {
        /// Why.
        reason: String,
    },
    /// It ended before its time; what was written so far can be read.
    Failed {
        /// What happened and what to do, in one sentence.
        reason: String,
    },
    /// It never began, as was reported to who asked for it.
    Refused {
        /// What stands against it, in one sentence.
        reason: String,
    },
}

/// A recording in progress; belongs to the fusion thread.
#[derive(Debug)]
pub(super) struct Recorder {
    /// Gone once nothing more is taken.
    sender: Option<Sender<Job>>,
    /// Bytes that may wait.
    most_bytes: usize,
    /// Gone once nothing more is taken.
    gathering: Option<Gathering>,
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<RecorderState>,
    /// Bytes in the queue.
    queued: AtomicUsize,
    /// Bytes written, once it has begun.
    bytes: OnceLock<Arc<AtomicU64>>,
    /// Of one that was ended in order: what goes behind its last entry.
    gathering: Mutex<Option<Gathering>>,
}

/// What is gathered while it is recorded.
#[derive(Clone, Debug)]
pub(super) struct Gathering {
    /// What happens in it.
    pub(super) digester: Digester,
    /// What follows from its log, for readers without a pipeline, where the stage wants it.
    pub(super) columns: Option<Columns>,
}

impl Gathering {
    /// Of recordings of a stage.
    pub(super) fn new(stage: &Stage) -> Self {
        let columns = stage.recording.columns.then(|| Columns::new(stage));
        Self { digester: Digester::new(stage, Timestamp::ZERO), columns }
    }

    /// One that has gathered nothing, of a recording of the same stage that begins then.
    pub(super) fn begun_at(&self, begun: Timestamp) -> Self {
        Self { digester: self.digester.begun_at(begun), columns: self.columns.clone() }
    }
}

/// Names of topics with the JSON Schemas of their messages.
pub(super) type Schemas = Vec<(&'static str, String)>;

#[derive(Debug)]
enum Job {
    Entry(Entry),
    Message { topic: &'static str, t: Timestamp, json: Vec<u8> },
    View { channel: Arc<Channel>, t: Timestamp, json: Vec<u8> },
    Columns(Box<Block>),
    Transmitted { device: DeviceIndex, t: Timestamp, bytes: Vec<u8> },
}

impl Recorder {
    /// Begins a new file at `path`, in a folder that is made where `make_folder` says so; `schemas` gives the JSON Schemas of the
    /// published topics, by topic. `begun` hears on the recorder's thread whether it could be made: not where the file exists, the
    /// folder is missing or may not be written to, the disk is full.
    ///
    /// # Errors
    /// The system gives no thread.
    pub(super) fn start(
        path: PathBuf,
        make_folder: bool,
        (header, gathering): (Header, Gathering),
        schemas: fn() -> Schemas,
        begun: impl FnOnce(Result<(), WriteError>) + Send + 'static,
    ) -> io::Result<Self> {
        let begin = move || {
            if let Some(folder) = path.parent().filter(|_| make_folder) {
                std::fs::create_dir_all(folder)?;
            }
            let file = OpenOptions::new().write(true).create_new(true).open(&path)?;
            // For the repair, which must not take the name from a file in use. Without locks it has to trust people.
            let _ = file.try_lock();
            let front = file.try_clone().map_err(WriteError::from).and_then(|synced| {
                let (mut writer, sync) =
                    front(BufWriter::new(file), move || synced.sync_data(), header, &schemas())?;
                if let Some(folder) = path.parent() {
                    writer.keep_index_in(folder);
                }
                Ok((writer, sync))
            });
            // So that its name survives a power cut too. Not every file system can do this.
            let _ = sync_folder_of(&path);
            front.inspect_err(|_| {
                // A file without its front part helps nobody.
                let _ = std::fs::remove_file(&path);
            })
        };
        let room = Room { items: QUEUE_ITEMS, bytes: QUEUE_BYTES };
        Self::start_with(begin, room, gathering, begun)
    }

    /// Begins a recording into what `begin` makes: the file, and what brings to the disk what was flushed into it.
    fn start_with<W: Write, S: FnMut() -> io::Result<()> + Send>(
        begin: impl FnOnce() -> Result<(Writer<W>, S), WriteError> + Send + 'static,
        room: Room,
        gathering: Gathering,
        begun: impl FnOnce(Result<(), WriteError>) + Send + 'static,
    ) -> io::Result<Self> {
        let shared = Arc::new(Shared {
            state: Mutex::new(RecorderState::Recording),
            queued: AtomicUsize::new(0),
            bytes: OnceLock::new(),
            gathering: Mutex::default(),
        });
        let (sender, receiver) = bounded(room.items);
        let thread = {
            let shared = Arc::clone(&shared);
            #[expect(clippy::disallowed_methods, reason = "the daemon owns the recorder's thread")]
            std::thread::Builder::new().name("recorder".to_owned()).spawn(move || {
                let (writer, mut sync) = match begin() {
                    Ok(begun) => begun,
                    Err(error) => {
                        *shared.state() = RecorderState::Refused { reason: error.to_string() };
                        return begun(Err(error));
                    }
                };
                let _ = shared.bytes.set(writer.byte_counter());
                begun(Ok(()));
                if let Err(error) = run(writer, &mut sync, &receiver, &shared) {
                    tracing::error!("the recording has ended: {error}");
                    *shared.state() = RecorderState::Failed { reason: error.to_string() };
                }
            })?
        };
        let gathering = Some(gathering);
        Ok(Self { sender: Some(sender), most_bytes: room.bytes, gathering, shared, thread })
    }

    /// Appends an entry, before the messages that follow from it.
    pub(super) fn entry(&mut self, entry: &Entry) {
        if self.sender.is_some() {
            self.send(Job::Entry(entry.clone()));
        }
        if let Some(gathering) = &mut self.gathering {
            gathering.digester.entry(entry.t);
        }
    }

    /// Looks at what follows from an entry, for the digest.
    pub(super) fn output(&mut self, output: &Output<'_>) {
        if let Some(gathering) = &mut self.gathering {
            gathering.digester.output(output);
        }
    }

    /// Looks at what is published, for the columns.
    pub(super) fn published(&mut self, payload: &Payload<'_>, stamp: &Stamp) {
        let columns = self.gathering.as_mut().and_then(|gathering| gathering.columns.as_mut());
        if let Some(block) = columns.and_then(|columns| columns.publish(payload, stamp)) {
            self.send(Job::Columns(Box::new(block)));
        }
    }

    /// Appends a message as it is published.
    pub(super) fn message(&mut self, topic: &'static str, t: Timestamp, json: &[u8]) {
        if self.sender.is_some() {
            self.send(Job::Message { topic, t, json: json.to_vec() });
        }
    }

    /// Appends a message for viewers.
    pub(super) fn view(&mut self, channel: &Arc<Channel>, t: Timestamp, json: &[u8]) {
        if self.sender.is_some() {
            self.send(Job::View { channel: Arc::clone(channel), t, json: json.to_vec() });
        }
    }

    /// Appends what is transmitted to a device.
    pub(super) fn transmitted(&mut self, device: DeviceIndex, t: Timestamp, bytes: &[u8]) {
        if self.sender.is_some() {
            self.send(Job::Transmitted { device, t, bytes: bytes.to_vec() });
        }
    }

    /// How it stands.
    pub(super) fn state(&self) -> RecorderState {
        self.shared.state().clone()
    }

    /// Bytes written so far.
    pub(super) fn bytes_written(&self) -> u64 {
        self.shared.bytes.get().map_or(0, |bytes| bytes.load(Ordering::Relaxed))
    }

    /// Ends the recording; the thread writes what is queued and the index. Does not wait for it.
    pub(super) fn stop(&mut self, reason: &str) {
        if self.sender.is_some() {
            *self.shared.gathering() = self.gathering.take();
            self.end(RecorderState::Stopped { reason: reason.to_owned() });
        }
    }

    /// Whether nothing more is being written.
    pub(super) fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// Stops it if nobody has, waits until the file is closed, and reports how it ended.
    pub(super) fn wait(mut self) -> RecorderState {
        self.stop("stopped");
        if self.thread.join().is_err() {
            return RecorderState::Failed {
                reason: "the recorder has crashed; please report this".to_owned(),
            };
        }
        self.shared.state().clone()
    }

    fn send(&mut self, job: Job) {
        let Some(sender) = &self.sender else { return };
        let size = job.size();
        let queued = self.shared.queued.fetch_add(size, Ordering::Relaxed) + size;
        let is_full = queued > self.most_bytes;
        let sent = if is_full { Err(TrySendError::Full(job)) } else { sender.try_send(job) };
        match sent {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => {
                let reason = "the disk does not keep up; the recording ends here, record to a faster disk";
                tracing::error!("{reason}");
                self.end(RecorderState::Failed { reason: reason.to_owned() });
            }
            // The thread has said why.
            Err(TrySendError::Disconnected(_)) => (self.sender, self.gathering) = (None, None),
        }
    }

    /// Takes nothing more; what is queued is still written.
    fn end(&mut self, state: RecorderState) {
        let mut current = self.shared.state();
        if *current == RecorderState::Recording {
            *current = state;
        }
        drop(current);
        // What may lack the end of an entry has no digest and no end of its columns: they can be made.
        (self.sender, self.gathering) = (None, None);
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, RecorderState> {
        // A panic elsewhere cannot leave it half-changed: every change is one assignment.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn gathering(&self) -> MutexGuard<'_, Option<Gathering>> {
        // The same.
        self.gathering.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Job {
    /// Bytes that it keeps in memory, roughly.
    fn size(&self) -> usize {
        size_of::<Self>()
            + match self {
                Self::Entry(Entry { input: Input::Bytes { bytes, .. }, .. })
                | Self::Message { json: bytes, .. }
                | Self::View { json: bytes, .. }
                | Self::Transmitted { bytes, .. } => bytes.len(),
                Self::Columns(block) => block.size(),
                Self::Entry(_) => 0,
            }
    }
}

/// The front part of a recording, brought to the disk.
fn front<W: Write, S: FnMut() -> io::Result<()>>(
    sink: W,
    mut sync: S,
    header: Header,
    schemas: &Schemas,
) -> Result<(Writer<W>, S), WriteError> {
    let mut writer = Writer::new(sink, header)?;
    schemas.iter().for_each(|(topic, schema)| writer.declare(topic, schema));
    sync()?;
    Ok((writer, sync))
}

/// The thread: writes until the queue is closed, then finishes the file. Another one brings to the disk what was written: that may
/// take longer than may be lost, and what has been handed to the system survives the end of this program.
fn run<S: FnMut() -> io::Result<()> + Send>(
    mut writer: Writer<impl Write>,
    sync: &mut S,
    receiver: &Receiver<Job>,
    shared: &Shared,
) -> Result<(), WriteError> {
    let (ask, asked) = bounded(1);
    let (failed, failure) = bounded(1);
    let sync_once = &mut *sync;
    std::thread::scope(|scope| {
        // It owns its ends of the queues: they close with it, however it ends.
        scope.spawn(move || {
            let mut sync = || fault_points::pass("sync").and_then(|()| sync_once());
            if let Some(error) = asked.iter().find_map(|()| sync().err()) {
                let _ = failed.send(error);
            }
        });
        let written = write(&mut writer, receiver, shared, || {
            // Where it is still at the time before, it is asked again at the next.
            let asked = ask.try_send(());
            if let Ok(error) = failure.try_recv() {
                return Err(error);
            }
            match asked {
                Err(TrySendError::Disconnected(())) => Err(io::Error::other("what syncs it has crashed")),
                Ok(()) | Err(TrySendError::Full(())) => Ok(()),
            }
        });
        // The other thread ends with it.
        drop(ask);
        written
    })?;
    let reason = match &*shared.state() {
        RecorderState::Stopped { reason } | RecorderState::Failed { reason } => reason.clone(),
        // The fusion thread is gone without a word.
        RecorderState::Recording | RecorderState::Refused { .. } => "the daemon broke off".to_owned(),
    };
    let gathering = shared.gathering().take();
    if let Some(Gathering { digester, columns }) = gathering {
        if let Some(columns) = columns {
            writer.columns(&columns.finish())?;
        }
        writer.digest(&digester.finish())?;
    }
    writer.finish(&reason)?;
    Ok(sync()?)
}

/// Writes what is queued, and hands it to the system and `synced` twice a second.
#[expect(clippy::disallowed_methods, reason = "the thread keeps the flush interval")]
fn write(
    writer: &mut Writer<impl Write>,
    receiver: &Receiver<Job>,
    shared: &Shared,
    synced: impl Fn() -> io::Result<()>,
) -> Result<(), WriteError> {
    // What came while the file was made has waited already.
    let mut next_flush = Instant::now();
    // Whether messages of the last entry may still come: what a crash leaves should not end between the two.
    let mut open = false;
    loop {
        match receiver.recv_deadline(next_flush) {
            Ok(job) => {
                shared.queued.fetch_sub(job.size(), Ordering::Relaxed);
                let begins = matches!(job, Job::Entry(_));
                if begins && Instant::now() >= next_flush {
                    next_flush = Instant::now() + FLUSH_EVERY;
                    fault_points::pass("recorder")?;
                    writer.flush()?;
                    synced()?;
                }
                open = begins;
                match job {
                    Job::Entry(entry) => writer.entry(&entry)?,
                    Job::Message { topic, t, json } => writer.message(topic, t, &json)?,
                    Job::View { channel, t, json } => writer.view(&channel, t, &json)?,
                    Job::Columns(block) => writer.columns(&block)?,
                    Job::Transmitted { device, t, bytes } => writer.transmitted(device, t, &bytes)?,
                }
            }
            Err(RecvTimeoutError::Timeout) if open => {
                open = false;
                next_flush = Instant::now() + ENTRY_GRACE;
            }
            Err(RecvTimeoutError::Timeout) => {
                next_flush = Instant::now() + FLUSH_EVERY;
                writer.flush()?;
                synced()?;
            }
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::path::Path;

    use super::*;
    use posed_recording::testing::{Full, STAGE, chunk, header};
    use posed_recording::{Ending, Item, Reader, RepairError, read_digest};

    /// More than these tests let wait.
    const AMPLE: Room = Room { items: 10_000, bytes: QUEUE_BYTES };

    fn gathering() -> Gathering {
        Gathering::new(&Stage::parse(STAGE).unwrap())
    }

    /// Begins a file.
    fn start(path: &Path, schemas: fn() -> Schemas) -> Result<Recorder, WriteError> {
        let (to, begun) = bounded(1);
        let recorder =
            Recorder::start(path.to_owned(), false, (header(), gathering()), schemas, move |begun| {
                to.send(begun).unwrap();
            });
        begun.recv().unwrap().map(|()| recorder.unwrap())
    }

    /// Begins a recording into `sink`, which `sync` brings to the disk; and what is sent once it has begun.
    fn start_with<W: Write>(
        sink: impl FnOnce() -> W + Send + 'static,
        sync: impl FnMut() -> io::Result<()> + Send + 'static,
        room: Room,
    ) -> (Recorder, Receiver<()>) {
        let (to, begun) = bounded(1);
        let begin = move || front(sink(), sync, header(), &Vec::new());
        let tell = move |begun: Result<(), WriteError>| {
            begun.unwrap();
            // Not every test waits for it.
            let _ = to.send(());
        };
        (Recorder::start_with(begin, room, gathering(), tell).unwrap(), begun)
    }

    fn read(path: &Path) -> (Vec<Item>, Option<Ending>, Option<String>) {
        let mut reader = Reader::open(path).unwrap();
        let items = reader.by_ref().map(Result::unwrap).collect();
        (items, reader.ending(), reader.end_reason().map(str::to_owned))
    }

    #[test]
    fn given_entries_and_a_stop_the_file_holds_them_and_says_why_it_ended() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut recorder = start(&path, || vec![("sensors", "{}".to_owned())]).unwrap();
        for n in 0..100 {
            recorder.entry(&chunk(n));
            recorder.message("sensors", Timestamp::from_nanos(n), b"{}");
            recorder.transmitted(0, Timestamp::from_nanos(n), b"B");
        }
        assert_eq!(recorder.state(), RecorderState::Recording);
        recorder.stop("asked to");
        assert_eq!(recorder.wait(), RecorderState::Stopped { reason: "asked to".to_owned() });
        let (items, ending, reason) = read(&path);
        assert_eq!((items.len(), ending, reason.as_deref()), (300, Some(Ending::Complete), Some("asked to")));
        assert!(read_digest(&path).unwrap().is_some());
        assert_eq!(items[0], Item::Entry(chunk(0)));
    }

    #[test]
    fn given_a_running_recording_all_but_the_last_flush_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut recorder = start(&path, Vec::new).unwrap();
        let front = recorder.bytes_written();
        recorder.entry(&chunk(1));
        // Until the flush comes by itself; nothing here depends on when.
        while recorder.bytes_written() == front {
            std::thread::yield_now();
        }
        let copy = folder.path().join("copy.mcap");
        let torn = loop {
            std::fs::copy(&path, &copy).unwrap();
            let torn = read(&copy);
            if !torn.0.is_empty() {
                break torn;
            }
        };
        assert_eq!(torn, (vec![Item::Entry(chunk(1))], Some(Ending::Torn), None));
        assert!(
            matches!(posed_recording::repair(&path, |_| ()), Err(RepairError::InUse)),
            "it is being written"
        );
        recorder.wait();
    }

    #[test]
    fn given_a_file_a_missing_folder_or_a_read_only_one_it_is_refused_with_a_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, "precious").unwrap();
        let error = start(&path, Vec::new).unwrap_err();
        assert!(error.to_string().contains("choose another name"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
        let error = start(&folder.path().join("gone/a.mcap"), Vec::new).unwrap_err();
        assert!(error.to_string().contains("the folder does not exist"), "{error}");
        // Not even root may create a file here.
        assert!(start(Path::new("/proc/a.mcap"), Vec::new).is_err());
        let read_only = WriteError::from(io::Error::from(io::ErrorKind::ReadOnlyFilesystem));
        assert!(read_only.to_string().contains("no right to write"), "{read_only}");
    }

    #[test]
    fn given_a_full_disk_the_recording_fails_and_who_records_goes_on() {
        let sink = Full { left: 20_000, ..Full::default() };
        let (mut recorder, _) = start_with(|| sink, || Ok(()), AMPLE);
        let mut n = 0;
        while !recorder.is_finished() {
            // Bytes that do not compress, so that the disk fills.
            recorder.entry(&chunk(n));
            n += 1;
            std::thread::yield_now();
        }
        recorder.entry(&chunk(n));
        let RecorderState::Failed { reason } = recorder.wait() else { panic!("it did not fail") };
        assert!(reason.contains("disk"), "{reason}");
    }

    /// Records onto a disk that hangs until nothing more is taken; how many entries were handed in, and how many the file holds then.
    fn recorded_onto_a_disk_that_hangs(room: Room) -> (usize, usize) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let (release, held) = bounded::<()>(0);
        let sink = Hanging { held, file: File::create(&path).unwrap(), free_bytes: 2000 };
        let (mut recorder, _) = start_with(|| sink, || Ok(()), room);
        let mut n = 0;
        while recorder.state() == RecorderState::Recording {
            recorder.entry(&chunk(n));
            n += 1;
        }
        // Who records goes on meanwhile, and so does a recording on another disk.
        recorder.entry(&chunk(n));
        let other_path = folder.path().join("b.mcap");
        let mut other = start(&other_path, Vec::new).unwrap();
        (0..100).for_each(|n| other.entry(&chunk(n)));
        assert_eq!(other.wait(), RecorderState::Stopped { reason: "stopped".to_owned() });
        assert_eq!(read(&other_path).0.len(), 100);
        drop(release);
        let RecorderState::Failed { reason } = recorder.wait() else { panic!("it did not fail") };
        assert!(reason.contains("does not keep up"), "{reason}");
        let (items, ending, end_reason) = read(&path);
        assert_eq!((ending, end_reason), (Some(Ending::Complete), Some(reason)));
        let expected: Vec<_> = (0..items.len() as i64).map(|n| Item::Entry(chunk(n))).collect();
        assert!(items == expected, "there is a hole");
        (n as usize, items.len())
    }

    #[test]
    fn more_pieces_than_may_wait_for_a_disk_that_hangs_end_the_recording_without_a_hole() {
        let room = Room { items: 64, ..AMPLE };
        let (handed_in, kept) = recorded_onto_a_disk_that_hangs(room);
        assert!(kept >= 64 && kept < handed_in, "{kept} of {handed_in}");
    }

    #[test]
    fn more_bytes_than_may_wait_for_a_disk_that_hangs_end_the_recording_without_a_hole() {
        let room = Room { bytes: 64 << 10, ..AMPLE };
        let (handed_in, kept) = recorded_onto_a_disk_that_hangs(room);
        let size = Job::Entry(chunk(0)).size();
        assert!(kept >= room.bytes / size && kept < handed_in, "{kept} of {handed_in}");
        assert!(handed_in < room.items, "it was the bytes");
    }

    #[test]
    fn given_a_disk_that_takes_its_time_what_is_written_meanwhile_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let (release, held) = bounded::<()>(0);
        let mut begun = false;
        // Not at the front part, but ever after.
        let sync = move || {
            if std::mem::replace(&mut begun, true) {
                let _ = held.recv();
            }
            Ok(())
        };
        let file = File::create(&path).unwrap();
        let (mut recorder, begun) = start_with(|| file, sync, AMPLE);
        begun.recv().unwrap();
        for n in 0..3 {
            recorder.entry(&chunk(n));
            while read(&path).0.len() < n as usize + 1 {
                std::thread::yield_now();
            }
        }
        drop(release);
        assert_eq!(recorder.wait(), RecorderState::Stopped { reason: "stopped".to_owned() });
    }

    #[test]
    fn given_a_disk_that_hangs_at_the_beginning_what_comes_meanwhile_is_written_then() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let (release, held) = bounded::<()>(0);
        let file = File::create(&path).unwrap();
        let sink = move || {
            let _ = held.recv();
            file
        };
        let (mut recorder, begun) = start_with(sink, || Ok(()), AMPLE);
        (0..100).for_each(|n| recorder.entry(&chunk(n)));
        assert_eq!((recorder.bytes_written(), begun.is_empty()), (0, true));
        drop(release);
        begun.recv().unwrap();
        assert_eq!(recorder.wait(), RecorderState::Stopped { reason: "stopped".to_owned() });
        assert_eq!(read(&path).0.len(), 100);
    }

    /// Writes the front part of a recording, then waits until it is released.
    struct Hanging {
        held: Receiver<()>,
        file: File,
        free_bytes: usize,
    }

    impl Write for Hanging {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.free_bytes < bytes.len() {
                let _ = self.held.recv();
            }
            self.free_bytes = self.free_bytes.saturating_sub(bytes.len());
            self.file.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            self.file.flush()
        }
    }
}
